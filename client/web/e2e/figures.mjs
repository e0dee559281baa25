// Measures the page: first paint, first map, weight over the wire, slider to picture, frames while playing, memory.
//
//   node e2e/figures.mjs TIDEMAPD TIDEMAP FOLDER [CELL_M]
//
// Figures depend on the machine and are printed, not judged. FOLDER is used again if the daemon's data are there.

import { existsSync, mkdirSync } from 'node:fs';
import { join } from 'node:path';

import { Daemon, launch, open, slideTo } from './stage.mjs';

const [program, cli, folder, cell = '0.05'] = process.argv.slice(2);
const PLAY_SECS = Number(process.env.TIDEMAP_PLAY_SECS ?? 30);
mkdirSync(folder, { recursive: true });
const daemon = await Daemon.start(program, cli, folder, ['--http-write']);
const browser = await launch();
const quantile = (values, share) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(share * values.length))];
const figure = (name, value, unit) => console.log(`${name}\t${typeof value === 'number' ? value.toFixed(1) : value}\t${unit}`);

try {
    if (!existsSync(join(folder, 'office'))) await daemon.furnish({ cell: Number(cell), days: 14, scansPerDay: 24 });
    const { map } = await daemon.call('MapService/GetMap', { name: 'office' });
    const { minX, minY, maxX, maxY } = map.gridSummary.bounds;
    figure('cells', ((maxX ?? 0) - (minX ?? 0)) * ((maxY ?? 0) - (minY ?? 0)), 'cells');

    const url = `${daemon.http}/maps/office?at=2025-03-18T03:00:00Z`;
    const isAt = (iso) => document.querySelector('[data-testid=map-canvas]')?.dataset.at === iso;
    const [paints, maps, assets, pictures] = [[], [], [], []];
    for (let round = 0; round < 7; round++) {
        const page = await open(browser, 'about:blank');
        const wire = await page.context().newCDPSession(page);
        await wire.send('Network.enable');
        const asked = new Map();
        let [loaded, grid] = [0, 0];
        wire.on('Network.requestWillBeSent', ({ requestId, request }) => asked.set(requestId, request.url));
        wire.on('Network.loadingFinished', ({ requestId, encodedDataLength }) => {
            const path = new URL(asked.get(requestId) ?? daemon.http).pathname;
            if (path.includes('PredictGrid')) grid ||= encodedDataLength;
            else if (!path.startsWith('/tidemap.v1')) loaded += encodedDataLength;
        });
        await page.goto(url);
        await page.waitForFunction(isAt, '2025-03-18T03:00:00.000Z');
        maps.push(await page.evaluate(() => performance.now()));
        paints.push(await page.evaluate(() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? Number.NaN));
        await page.waitForTimeout(200);
        assets.push(loaded);
        pictures.push(grid);
        await page.context().close();
    }
    figure('first paint, median', quantile(paints, 0.5), 'ms');
    figure('first map, median', quantile(maps, 0.5), 'ms');
    figure('first map, worst', Math.max(...maps), 'ms');
    figure('assets over the wire', assets[0] / 1024, 'KiB');
    figure('a picture over the wire', pictures[0] / 1024, 'KiB');

    const page = await open(browser, url);
    await page.waitForFunction(isAt, '2025-03-18T03:00:00.000Z');
    const measure = (times, restMs) =>
        page.evaluate(
            async ([times, restMs]) => {
                const slider = document.querySelector('[data-testid=time]');
                const canvas = document.querySelector('[data-testid=map-canvas]');
                const taken = [];
                for (const minutes of times) {
                    const iso = new Date(Date.UTC(2025, 2, 18) + minutes * 60_000).toISOString();
                    const begun = performance.now();
                    slider.value = String(minutes);
                    slider.dispatchEvent(new Event('input', { bubbles: true }));
                    while (canvas.dataset.at !== iso) await new Promise((next) => setTimeout(next, 0));
                    taken.push(performance.now() - begun);
                    await new Promise((next) => setTimeout(next, restMs));
                }
                return taken;
            },
            [times, restMs],
        );
    const steps = Array.from({ length: 80 }, (_, index) => 200 + 5 * index);
    const along = await measure(steps, 250);
    figure('slider to picture, step by step, p50', quantile(along, 0.5), 'ms');
    figure('slider to picture, step by step, p95', quantile(along, 0.95), 'ms');
    const jumps = Array.from({ length: 80 }, (_, index) => 5 * ((index * 107 + 13) % 283));
    const far = await measure(jumps, 400);
    figure('slider to picture, jumps, p50', quantile(far, 0.5), 'ms');
    figure('slider to picture, jumps, p95', quantile(far, 0.95), 'ms');

    await slideTo(page, 0, '2025-03-18T00:00:00.000Z');
    const memory = () => page.evaluate(() => (globalThis.gc?.(), performance.memory.usedJSHeapSize / 2 ** 20));
    const painted = () => page.getByTestId('map-canvas').evaluate((canvas) => Number(canvas.dataset.painted));
    await page.getByTestId('play').click();
    await page.waitForTimeout(3000);
    const [heap, frames, begun] = [await memory(), await painted(), Date.now()];
    await page.waitForTimeout(PLAY_SECS * 1000);
    figure('frames a second while playing', ((await painted()) - frames) / ((Date.now() - begun) / 1000), '1/s');
    const shown = await page.getByTestId('map-canvas').getAttribute('data-at');
    figure('time played', (Date.parse(shown) - Date.UTC(2025, 2, 18)) / 3_600_000, 'h');
    figure('heap after 3 s of playing', heap, 'MiB');
    figure(`heap ${PLAY_SECS} s later`, await memory(), 'MiB');
} finally {
    await browser.close();
    await daemon.stop();
}
