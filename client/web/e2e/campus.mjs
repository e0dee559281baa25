// Measures the page on a campus: a hundred copies of the office in one grid, more cells than a page may load.
//
//   node e2e/campus.mjs TIDEMAPD TIDEMAP FOLDER [CELL_M]
//
// Figures depend on the machine and are printed, not judged. FOLDER is used again if the daemon's data are there.

import { existsSync, mkdirSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';

import { Daemon, launch, open } from './stage.mjs';

const [program, cli, folder, cell = '0.05'] = process.argv.slice(2);
const SIDE = 10;
// A tile has 64 cells of a flat grid; the default is 200,000 tiles.
process.env.TIDEMAP_MAX_TILES_PER_MAP = '1000000';
const daemon = await Daemon.start(program, cli, folder, ['--http-write']);
const browser = await launch();
const quantile = (values, share) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(share * values.length))];
const figure = (name, value, unit) => console.log(`${name}\t${typeof value === 'number' ? value.toFixed(1) : value}\t${unit}`);

/** Observes and learns two days, with four scans a day of each building. */
function furnish() {
    const plans = daemon.building(join(folder, 'plans'), { cell, days: 2, scansPerDay: 4 });
    const placed = join(folder, 'campus');
    mkdirSync(placed, { recursive: true });
    daemon.run('map', 'create', 'campus', '--time-zone', 'Europe/London', '--grid', `resolution=${cell},flat`);
    for (let building = 0; building < SIDE * SIDE; building++) {
        const [x, y] = [(building % SIDE) * 32, Math.floor(building / SIDE) * 16.8];
        const names = plans.map((_, scan) => join(placed, `scan-${building}-${scan}.yaml`));
        names.forEach((name, scan) => {
            const image = plans[scan].replace(/yaml$/, 'pgm');
            const text = [`image: ${image}`, `resolution: ${cell}`, `origin: [${x.toFixed(1)}, ${y.toFixed(1)}, 0.0]`];
            writeFileSync(name, `${[...text, 'negate: 0', 'occupied_thresh: 0.65', 'free_thresh: 0.196'].join('\n')}\n`);
        });
        daemon.run('grid', 'observe', 'campus', ...names, '--at', '2025-03-03T00:00:00Z', '--every', '6h', '--producer', `scanner-${building}`);
    }
    daemon.run('update', 'campus');
}

try {
    if (!existsSync(join(folder, 'campus'))) furnish();
    const { map } = await daemon.call('MapService/GetMap', { name: 'campus' });
    const { minX, minY, maxX, maxY } = map.gridSummary.bounds;
    figure('cells', ((maxX ?? 0) - (minX ?? 0)) * ((maxY ?? 0) - (minY ?? 0)), 'cells');

    const page = await open(browser, `${daemon.http}/maps/campus?at=2025-03-18T10:00:00Z`);
    const canvas = page.getByTestId('map-canvas');
    const fetched = () =>
        page.evaluate(() => {
            const asked = performance.getEntriesByType('resource').filter((one) => one.name.includes('PredictGrid'));
            performance.clearResourceTimings();
            return asked.map(({ duration, transferSize }) => ({ duration, transferSize }));
        });
    const memory = () => page.evaluate(() => (globalThis.gc?.(), performance.memory.usedJSHeapSize / 2 ** 20));
    await page.waitForFunction(() => Number(document.querySelector('[data-testid=map-canvas]')?.dataset.painted) > 0);
    figure('first paint', await page.evaluate(() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime), 'ms');

    // Nearer, until the cells are there, and as far again.
    await canvas.focus();
    for (let step = 0; step < 6; step++) {
        await canvas.press('+');
        await page.waitForTimeout(600);
    }
    const zoomed = await fetched();
    figure('windows while zooming', zoomed.length, '');
    figure('the slowest of them', Math.max(...zoomed.map((one) => one.duration)), 'ms');
    figure('the largest of them over the wire', Math.max(...zoomed.map((one) => one.transferSize)) / 1024, 'KiB');

    const rates = [];
    const panned = [];
    for (const [dx, dy] of [[-1, 0], [-1, 0], [0, -1], [1, 0], [1, 0], [0, 1], [-1, 0], [0, 1], [1, 0], [1, 0], [0, -1], [-1, 0]]) {
        rates.push(
            await page.evaluate(
                async ([dx, dy]) => {
                    const target = document.querySelector('[data-testid=map-canvas]');
                    const frames = () => Number(target.dataset.painted);
                    const send = (type, x, y) =>
                        target.dispatchEvent(new PointerEvent(type, { bubbles: true, pointerId: 1, button: 0, clientX: x, clientY: y }));
                    target.setPointerCapture = () => {};
                    send('pointerdown', 640, 400);
                    const [from, begun] = [frames(), performance.now()];
                    for (let step = 1; step <= 60; step++) {
                        send('pointermove', 640 + dx * step * 10, 400 + dy * step * 6);
                        await new Promise((next) => requestAnimationFrame(next));
                    }
                    const rate = ((frames() - from) / (performance.now() - begun)) * 1000;
                    send('pointerup', 640 + dx * 600, 400 + dy * 360);
                    return rate;
                },
                [dx, dy],
            ),
        );
        await page.waitForTimeout(600);
        panned.push(...(await fetched()));
    }
    figure('frames a second while panning, median', quantile(rates, 0.5), '1/s');
    figure('frames a second while panning, worst', Math.min(...rates), '1/s');
    figure('windows while panning', panned.length, '');
    figure('a window, p50', quantile(panned.map((one) => one.duration), 0.5), 'ms');
    figure('a window, p95', quantile(panned.map((one) => one.duration), 0.95), 'ms');
    figure('a window over the wire, p50', quantile(panned.map((one) => one.transferSize), 0.5) / 1024, 'KiB');
    figure('heap at the end', await memory(), 'MiB');
    if (page.problems.length) throw new Error(page.problems.join('\n'));
} finally {
    await browser.close();
    await daemon.stop();
}
