// Tests of the page in a real browser against a real daemon.
//
//   node e2e/page.mjs TIDEMAPD TIDEMAP FOLDER
//
// Says what it checks, one line each, and ends with an error at the first that fails. Pictures for the guide are
// written into FOLDER.

import assert from 'node:assert/strict';
import { mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';

import { contacts, doors, halls, works } from './maps.mjs';
import { Daemon, dropped, launch, open, pixels, slideTo } from './stage.mjs';
import { lookAtViews, violations } from './views.mjs';

const [program, cli, folder] = process.argv.slice(2);
const HOSTILE = '<img src=x onerror="window.broken = 1"> <script>window.broken = 1';

const daemon = await Daemon.start(program, cli, folder, ['--http-write']);
let browser;
let page;

async function check(what, body) {
    try {
        await body();
    } catch (error) {
        await page?.screenshot({ path: join(folder, 'failed.png') }).catch(() => {});
        throw new Error(`${what}: ${error.message}`, { cause: error });
    }
    console.log(`ok  ${what}`);
}

try {
    await daemon.furnish();
    await daemon.call('MapService/AddState', { map: 'office', state: HOSTILE });
    browser = await launch();
    page = await open(browser, daemon.http);
    const at = (hour) => `2025-03-18T${String(hour).padStart(2, '0')}:00:00.000Z`;
    const tuesday = `${daemon.http}/maps/office?at=2025-03-18T03:00:00Z&list=0`;

    await check('the maps are listed, and one opens', async () => {
        await page.getByTestId('maps').getByRole('link').first().click();
        await page.getByTestId('map-canvas').waitFor();
        assert.equal(new URL(page.url()).pathname, '/maps/office');
    });

    await check('a map opens at its newest data, and says so', async () => {
        await page.getByTestId('newest').waitFor();
        assert.match(await page.getByTestId('time-text').innerText(), /^Sun 16 Mar 2025, 23:5/);
        assert.match(await page.getByTestId('newest').getAttribute('title'), /^Newest data: Sun 16 Mar 2025/);
    });

    await check('a map without a grid opens on its states: the unusual one, and what changes soon', async () => {
        doors(daemon, folder);
        await page.goto(`${daemon.http}/maps/doors`);
        const rows = page.getByTestId('overview-rows');
        await rows.getByText('door-07', { exact: true }).waitFor();
        assert.match(await page.getByTestId('unusual').getByRole('listitem').first().innerText(), /^door-13 was 1 on Tue 11 Mar 00:00 – 04:30, predicted 0/);
        await page.getByTestId('sort').selectOption('unusual');
        await page.waitForFunction(() => document.querySelector('[data-testid=overview-rows] li button')?.textContent === 'door-13');
        await page.getByTestId('sort').selectOption('soon');
        const first = rows.getByRole('listitem').first();
        // At 23:00 on Friday: the first door of Saturday opens at 05:00.
        await first.getByText('likely 1 from 05:').waitFor();
        assert.match(await first.innerText(), /^door-00/);
        // Every row that is seen has its course.
        await page.waitForFunction(() => [...document.querySelectorAll('[data-testid=overview-rows] li')].every((row) => row.querySelector('polyline')));
        await page.screenshot({ path: join(folder, 'overview.png') });
        await page.getByLabel('Search states').fill('door-2');
        await page.getByLabel('Search states').press('Enter');
        await page.getByTestId('today').waitFor();
        await page.waitForURL(/select=door-2/);
    });

    await check('rows of hours are saved as they are shown', async () => {
        const saved = async (format) => {
            await page.getByTitle('Save the rows as a file').click();
            const coming = page.waitForEvent('download');
            await page.getByTestId('overview').getByRole('button', { name: format, exact: true }).click();
            return readFileSync(await (await coming).path());
        };
        await page.getByLabel('Search states').fill('door-13');
        const csv = (await saved('CSV')).toString();
        assert.match(csv, /^time,state,predicted\r\n2025-03-14T00:30:00\+00:00,door-13,0\.\d+\r\n/);
        assert.equal(csv.trim().split('\r\n').length, 25);
        assert.match((await saved('SVG')).toString(), /^<svg .*door-13/s);
        assert.equal((await saved('PNG')).subarray(1, 4).toString(), 'PNG');
    });

    await check('a name that does not exist is told once, with those that do', async () => {
        await page.goto(`${daemon.http}/maps/ofice`);
        await page.getByTestId('unknown').getByRole('link', { name: 'office' }).waitFor();
        assert.equal(await page.getByRole('alert').count(), 1);
        await page.goto(`${daemon.http}/maps/office?select=kitchn`);
        await page.getByTestId('unknown').getByRole('link', { name: 'kitchen', exact: true }).click();
        await page.getByTestId('state-week').waitFor();
        assert.equal(await page.getByRole('alert').count(), 0);
    });

    await check('the keys are listed', async () => {
        await page.keyboard.press('?');
        await page.getByTestId('keys').getByText('plays or pauses').waitFor();
        await page.keyboard.press('Escape');
        await page.getByTestId('keys').waitFor({ state: 'detached' });
    });

    await check('the slider from 03:00 to 10:00 changes the pixels of the map, and back again', async () => {
        await page.goto(tuesday);
        await page.waitForFunction((iso) => document.querySelector('[data-testid=map-canvas]')?.dataset.at === iso, at(3));
        const night = await pixels(page);
        await slideTo(page, 600, at(10));
        const morning = await pixels(page);
        assert.notEqual(night, morning);
        // The forecasts of edges and presence follow the slider a moment later.
        await page.waitForTimeout(500);
        await page.screenshot({ path: join(folder, 'map.png') });
        await slideTo(page, 180, at(3));
        assert.equal(await pixels(page), night);
    });

    await check('the address carries the time and the layer', async () => {
        await page.getByTestId('layer').selectOption('entropy');
        await slideTo(page, 600, at(10));
        await page.waitForFunction(() => window.location.search.includes('layer=entropy') && window.location.search.includes('T10'));
        const shown = await pixels(page);
        await page.reload();
        await page.waitForFunction((iso) => document.querySelector('[data-testid=map-canvas]')?.dataset.at === iso, at(10));
        assert.equal(await pixels(page), shown);
        await page.getByTestId('layer').selectOption('probability');
    });

    await check('each layer has its own picture', async () => {
        const seen = new Set();
        for (const layer of ['probability', 'entropy', 'difference', 'seen']) {
            await page.getByTestId('layer').selectOption(layer);
            const before = new Set(seen);
            for (let tries = 0; ; tries++) {
                seen.add(await pixels(page));
                if (seen.size > before.size) break;
                assert.ok(tries < 100, `${layer} looks like another layer`);
                await page.waitForTimeout(50);
            }
        }
        await page.getByTestId('layer').selectOption('probability');
    });

    await check('a clicked cell shows its week', async () => {
        await page.getByTestId('map-canvas').click({ position: { x: 640, y: 150 } });
        await page.getByTestId('state-week').locator('canvas').waitFor();
        const title = await page.getByRole('heading', { level: 2 }).innerText();
        assert.match(title, /^cell\/\d+\/\d+\/0$/);
        const said = Number(await page.getByTestId('state-value').innerText());
        const rows = JSON.parse(daemon.run('predict', 'office', title, '--at', at(10), '--output', 'json'));
        assert.ok(Math.abs(said - Number(rows[0].probability)) < 0.006, `${said} is not ${rows[0].probability}`);
        await page.keyboard.press('Escape');
        await page.getByTestId('state-week').waitFor({ state: 'detached' });
    });

    await check('playing moves time and the picture', async () => {
        const before = await pixels(page);
        await page.getByTestId('play').click();
        await page.waitForFunction((iso) => (document.querySelector('[data-testid=map-canvas]')?.dataset.at ?? '') > iso, at(11));
        await page.getByTestId('play').click();
        assert.notEqual(await pixels(page), before);
        assert.ok(new Date(await page.getByTestId('map-canvas').getAttribute('data-at')) > new Date(at(11)));
    });

    await check("a route's probability is that of the command line", async () => {
        await page.goto(`${daemon.http}/maps/office?at=2025-03-18T10:00:00Z&list=0&tool=route`);
        await page.getByTestId('route-from').selectOption('entrance');
        await page.getByTestId('route-to').selectOption('kitchen');
        const shown = page.getByTestId('route-probability');
        const said = Number(await shown.getAttribute('data-value'));
        const rows = JSON.parse(daemon.run('route', 'office', 'entrance', 'kitchen', '--at', at(10), '--output', 'json'));
        const product = rows.reduce((all, row) => all * Number(row.probability), 1);
        assert.ok(Math.abs(said - product) < 1e-9, `${said} is not ${product}`);
        assert.equal(await shown.innerText(), `${(said * 100).toFixed(1)} %`);
        await page.screenshot({ path: join(folder, 'route.png') });
    });

    await check('a node shows the landmarks that are likely at that time', async () => {
        const known = join(folder, 'landmarks.csv');
        writeFileSync(known, 'place,name,u_px,v_px,descriptor\nkitchen,window,10,20,00ff\nkitchen,lamp,30,20,ff00\n');
        const looks = ['time,place,seen'];
        for (let hour = 0; hour < 14 * 24; hour++) {
            const time = new Date(Date.UTC(2025, 2, 4, hour)).toISOString();
            looks.push(`${time},kitchen,${hour % 24 >= 8 && hour % 24 < 17 ? 'window' : 'lamp'}`);
        }
        const seen = join(folder, 'sightings.csv');
        writeFileSync(seen, `${looks.join('\n')}\n`);
        daemon.run('landmark', 'add', 'office', known, '--descriptors', 'test');
        daemon.run('landmark', 'observe', 'office', seen, '--producer', 'robot-1');
        daemon.run('update', 'office');
        await page.goto(`${daemon.http}/maps/office?at=2025-03-18T10:00:00Z&list=0&select=kitchen`);
        const first = page.getByTestId('landmarks').getByRole('row').nth(1);
        await first.waitFor();
        const rows = JSON.parse(daemon.run('landmark', 'predict', 'office', 'kitchen', '--at', at(10), '--output', 'json'));
        assert.equal(rows[0].landmark, 'window');
        assert.equal(await first.getByRole('cell').nth(1).getAttribute('data-value'), String(rows[0].probability));
        await first.getByRole('button').click();
        await page.waitForURL((url) => url.searchParams.get('select') === 'landmark/kitchen/window');
    });

    await check('a tour is planned where looking pays', async () => {
        await page.getByTestId('explore').click();
        await page.getByTestId('information').getByRole('button').first().waitFor();
        await page.getByTestId('map-canvas').click({ position: { x: 450, y: 330 } });
        await page.getByTestId('plan-tour').click();
        await page.getByTestId('tour').getByRole('row').nth(1).waitFor();
        await page.screenshot({ path: join(folder, 'explore.png') });
        // As many bits as the command line says. The address follows a little later.
        await page.waitForURL((url) => url.searchParams.has('start'));
        const start = new URL(page.url()).searchParams.get('start');
        const rows = JSON.parse(daemon.run('tour', 'office', '--at', at(10), `--start=${start}`, '--output', 'json'));
        const said = await page.getByTestId('tour').getByRole('row').nth(1).getByRole('cell').nth(2).innerText();
        assert.ok(Math.abs(parseFloat(said) - Number(rows[0].information_bits)) < 0.01, `${said} is not ${rows[0].information_bits}`);
        await page.getByTestId('layer').selectOption('look');
        await page.getByTestId('legend').getByText('Information of one view around (4 m)').waitFor();
        await page.getByTestId('legend').getByText(/^\d+\.\d bits$/).waitFor();
    });

    await check('a tour says what it was planned for, and when that is old', async () => {
        const said = page.getByTestId('tour-of');
        assert.match(await said.innerText(), /^Planned for Tue 18 Mar 2025, 10:00, from .* m\.$/);
        await slideTo(page, 180, at(3));
        await page.waitForFunction(() => /^Planned for Tue 18 Mar 2025, 10:00.* Plan anew/.test(document.querySelector('[data-testid=tour-of]')?.textContent ?? ''));
        await slideTo(page, 600, at(10));
        await page.getByTitle('Save the tour as a file').click();
        const coming = page.waitForEvent('download');
        await page.getByRole('button', { name: 'CSV', exact: true }).click();
        assert.match(readFileSync(await (await coming).path(), 'utf8'), /^Goal,At,Information,Reached\r\n1,"[0-9., -]+",[0-9.]+ bits,\d+ %\r\n/);
    });

    await check('the map is saved as it is shown', async () => {
        const saved = async (format) => {
            const menu = page.getByTestId('export').first();
            await menu.locator('summary').click();
            const coming = page.waitForEvent('download');
            await menu.getByRole('button', { name: format, exact: true }).click();
            return readFileSync(await (await coming).path());
        };
        const csv = (await saved('CSV')).toString();
        for (const line of [/^kind,name,x,y,value\r$/m, /^place,kitchen,/m, /^edge,edge\//m, /^look,,/m, /^cell,\d+\/\d+,/m]) assert.match(csv, line);
        assert.equal((await saved('PNG')).subarray(1, 4).toString(), 'PNG');
    });

    await check('states are searched, and text stays text', async () => {
        await page.getByRole('link', { name: 'States' }).click();
        const list = page.getByTestId('state-list');
        await page.getByLabel('Search states').fill('<script>');
        await list.getByRole('button').first().click();
        await page.getByRole('heading', { level: 2, name: HOSTILE }).waitFor();
        assert.equal(await list.getByRole('button').count(), 1);
        assert.equal(await page.evaluate(() => window.broken), undefined);
        await page.getByLabel('Search states').fill('kitchen');
        await list.getByRole('button', { name: /^kitchen/ }).click();
        await page.goto(`${daemon.http}/states/office?at=2025-03-11T12:30:00Z&select=kitchen`);
        await page.getByTestId('heat-strip').locator('canvas').first().waitFor();
        await page.getByTestId('state-week').locator('canvas').waitFor();
        await page.getByTestId('compare').locator('canvas').waitFor();
        await page.screenshot({ path: join(folder, 'states.png') });
    });

    await check('the states have the clock of the map, and their hours and tables are saved', async () => {
        assert.equal(await page.getByTestId('time-text').innerText(), 'Tue 11 Mar 2025, 12:30');
        await page.getByTestId('newest').waitFor();
        await page.getByTestId('play').click();
        await page.waitForFunction(() => !document.querySelector('[data-testid=time-text]')?.textContent.endsWith('12:30'));
        await page.getByTestId('play').click();
        const saved = async (what) => {
            await page.getByTitle(`Save ${what} as a file`).click();
            const coming = page.waitForEvent('download');
            await page.getByRole('button', { name: 'CSV', exact: true }).click();
            return readFileSync(await (await coming).path(), 'utf8').trim().split('\r\n');
        };
        assert.equal((await saved('the four weeks')).length, 1 + 28 * 24);
        assert.match((await saved('the comparison'))[1] ?? '', /,kitchen: auto,predicted,/);
    });

    await check('rows of changes and events are shown as what they stand for', async () => {
        contacts(daemon, folder);
        await page.goto(`${daemon.http}/states/contacts?at=2025-03-20T10:00:00Z&select=contact`);
        const text = (name) => page.getByTestId(name).innerText();
        await page.getByTestId('state-week').locator('canvas').waitFor();
        assert.equal(await text('reported'), 'as changes: a value holds until the next row, for 7 days at most; it is learned every 5 minutes');
        assert.match(await text('reported-then'), /^Reported: 1 since Thu 20 Mar 2025, 09:00, 1\.0 h before\.$/);
        await page.getByTestId('heat-strip').locator('canvas').first().waitFor();
        await page.screenshot({ path: join(folder, 'changes.png') });
        await page.goto(`${daemon.http}/states/contacts?at=2025-03-20T14:00:00Z&select=contact`);
        await page.getByText('There was no value then.').waitFor();
        // The hours of the strip: all of 10:00, half of 12:00, then nothing.
        await page.goto(`${daemon.http}/maps/contacts?at=2025-03-20T10:00:00Z&rows=day&hours=observed`);
        await page.getByLabel('Search states').fill('contact');
        await page.getByTitle('Save the rows as a file').click();
        const coming = page.waitForEvent('download');
        await page.getByTestId('overview').getByRole('button', { name: 'CSV', exact: true }).click();
        const hours = readFileSync(await (await coming).path(), 'utf8').trim().split('\r\n').slice(1).map((line) => line.split(',')[2]);
        assert.deepEqual(hours.slice(7, 15), ['0', '0', '1', '1', '1', '1', '', '']);
        await page.goto(`${daemon.http}/states/contacts?at=2025-03-20T08:00:00Z&select=gate`);
        await page.getByText('events in 1 hour').waitFor();
        assert.match(await text('reported'), /^as events, which are counted every hour/);
        assert.match(await text('today'), /^Thu 20 Mar: about [34](\.\d)? events are expected in all\.$/);
        await page.getByTestId('state-week').getByText('28 events, drawn as steps').waitFor();
    });

    await check('a map of few states opens on a week, at an hour when something changes', async () => {
        await page.goto(`${daemon.http}/maps/contacts`);
        await page.getByTestId('overview-rows').getByText('contact', { exact: true }).waitFor();
        assert.equal(await page.getByTestId('rows').inputValue(), 'week');
        assert.match(await page.getByTestId('time-text').innerText(), /^Mon 24 Mar 2025, (08|09|16|17):[03]0$/);
        // The hours in words, for those who do not see them.
        await page.getByRole('img', { name: /^likely 0 Mon 24 Mar 00:00 – Mon 24 Mar 09:00, likely 1 / }).waitFor();
    });

    await check('labels, tasks and the plan of a day are shown, and places without positions have no scale', async () => {
        works(daemon, folder);
        await page.goto(`${daemon.http}/maps/depot?at=2025-01-14T12:30:00Z`);
        const rows = page.getByTestId('overview-rows');
        await rows.getByText('eat', { exact: true }).waitFor();
        await rows.getByRole('img', { name: /^likely sleep 00:00 – 07:00, likely work 07:00 – 12:00, likely eat 12:00 – 13:00/ }).waitFor();
        await page.getByTestId('map-canvas').hover();
        assert.equal(await page.locator('.scale .bar').count(), 0);
        await page.getByTestId('tasks-toggle').click();
        await page.getByTestId('plan').getByText('inspect at Lab').waitFor();
        await page.getByTestId('task-list').getByText('08:00–18:00, Mon–Fri').waitFor();
        assert.equal(await page.getByRole('alert').count(), 0);
        await page.goto(`${daemon.http}/maps/depot?at=2025-01-15T12:30:00Z&tool=tasks`);
        await page.getByText('No plan of this day was kept.').waitFor();
        await page.goto(`${daemon.http}/states/depot?at=2025-01-14T12:30:00Z&select=activity`);
        await page.getByTestId('today').getByText('likely sleep 00:00 – 07:00, work 07:00 – 12:00, eat 12:00 – 13:00').waitFor();
        await page.getByTestId('state-week').getByText('observations', { exact: false }).first().waitFor();
        await page.getByTestId('heat-strip').getByText('work').waitFor();
        assert.equal(await page.getByRole('alert').count(), 0);
        // A position is told and drawn in metres.
        await page.goto(`${daemon.http}/maps/yard?at=2025-01-14T12:30:00Z&select=robot`);
        await page.getByTestId('state-value').first().getByText('x 2.00 m').waitFor();
        await page.getByTestId('legend').getByText('where something is expected').waitFor({ state: 'attached' });
        assert.equal(await page.getByRole('alert').count(), 0);
    });

    await check('rows of a kind are folded, and the list can be skipped', async () => {
        await page.goto(`${daemon.http}/maps/office?at=2025-03-18T10:00:00Z&list=1`);
        const group = page.getByTestId('overview').getByTestId('group').filter({ hasText: 'edge/' });
        await group.waitFor();
        assert.equal(await group.getAttribute('aria-expanded'), 'false');
        const edge = page.getByTestId('overview-rows').getByTitle('edge/corridor-1/corridor-2');
        assert.equal(await edge.count(), 0);
        await group.click();
        await edge.waitFor();
        await group.click();
        await edge.waitFor({ state: 'detached' });
        const skip = page.getByTestId('overview').getByRole('button', { name: 'Skip the list' });
        await skip.focus();
        await page.keyboard.press('Enter');
        await page.keyboard.press('Tab');
        assert.equal(await page.evaluate(() => document.activeElement?.closest('[data-testid=overview-rows]')), null);
        assert.notEqual(await page.evaluate(() => document.activeElement?.tagName), 'BODY');
    });

    await check('a dark page has a dark map, with the same order of colours in rows and legend', async () => {
        const dark = await open(browser, `${daemon.http}/maps/office?at=2025-03-18T03:00:00Z&list=0`, { colorScheme: 'dark' });
        await dark.waitForFunction((iso) => document.querySelector('[data-testid=map-canvas]')?.dataset.at === iso, at(3));
        const brightness = (page) => page.getByTestId('map-canvas').evaluate((canvas) => {
            const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
            let sum = 0;
            for (let index = 0; index < data.length; index += 4) sum += (data[index + 3] / 255) * data[index + 1];
            return sum / (data.length / 4);
        });
        await page.goto(tuesday);
        await page.waitForFunction((iso) => document.querySelector('[data-testid=map-canvas]')?.dataset.at === iso, at(3));
        assert.ok((await brightness(dark)) < 0.5 * (await brightness(page)));
        assert.match(await dark.getByTestId('legend').locator('.colours').first().getAttribute('style'), /right, rgb\(0,? 0,? 0\)/);
        assert.deepEqual(dark.problems, []);
        await dark.context().close();
    });

    await check('a flow of people is drawn, follows the clock, and is that of the command line', async () => {
        halls(daemon, folder);
        await page.goto(`${daemon.http}/maps/hall?at=2025-01-21T09:00:00Z`);
        await page.getByTestId('flow').selectOption('people');
        assert.equal(await page.getByTestId('motion').inputValue(), 'heading');
        const shown = page.getByTestId('flow-legend');
        const isAt = (iso) => page.waitForFunction((iso) => document.querySelector('[data-testid=flow-legend]')?.dataset.at === iso, iso);
        const drawn = () => page.locator('canvas.over').evaluate((canvas) => canvas.toDataURL());
        await isAt('2025-01-21T09:00:00.000Z');
        assert.match(await shown.innerText(), /^Flow of people\n0\n[\d.]+ detections\nin ten minutes, in cells of 1 m/);
        const morning = await drawn();
        await page.screenshot({ path: join(folder, 'flow.png') });
        await page.getByTestId('time').fill('900');
        await isAt('2025-01-21T15:00:00.000Z');
        assert.notEqual(await drawn(), morning);
        await page.getByTitle('Save the map as a file').click();
        const coming = page.waitForEvent('download');
        await page.getByRole('button', { name: 'CSV', exact: true }).click();
        const saved = readFileSync(await (await coming).path(), 'utf8').trim().split('\r\n').slice(1).map((line) => line.split(','));
        const rows = JSON.parse(daemon.run('position', 'hall', 'people', '--flow', 'heading', '--at', '2025-01-21T15:00:00Z', '--top', '0', '--output', 'json'));
        const said = (kind) => saved.filter(([name]) => name === kind).map(([, , x, , value]) => [Number(x), Number(value)]).sort(([a], [b]) => a - b);
        const expected = (column) => rows.map((row) => [Number(row.x), Number(Number(row[column]).toFixed(6))]).sort(([a], [b]) => a - b);
        assert.equal(rows.length, 12);
        for (const [kind, column] of [['flow', 'expected_count'], ['direction', 'direction_rad'], ['share', 'share']]) assert.deepEqual(said(kind), expected(column));
        await page.waitForURL(({ searchParams }) => searchParams.get('flow') === 'people' && searchParams.get('at')?.startsWith('2025-01-21T15'));
        await page.reload();
        await isAt('2025-01-21T15:00:00.000Z');
    });

    await check('what no update has learned is shown as last seen, until the page runs the update', async () => {
        daemon.run('sample', 'recording', join(folder, 'lab'));
        daemon.run('import', 'lab', join(folder, 'lab', 'robot.mcap'), '--no-update');
        await page.goto(daemon.http);
        await page.getByTestId('maps').getByRole('listitem').filter({ hasText: 'Not learned yet: 4,032 observations and 2,016 scans' }).waitFor();
        await page.goto(`${daemon.http}/states/lab?at=2025-01-15T12:00:00Z`);
        const value = page.getByTestId('state-value').first();
        assert.equal(await value.innerText(), 'not learned yet');
        await page.goto(`${daemon.http}/maps/lab?at=2025-01-15T12:00:00Z`);
        await page.getByTestId('overview-rows').getByText('not learned yet').first().waitFor();
        await page.getByTestId('legend-unlearned').getByText('all as last seen').waitFor();
        const before = await pixels(page);
        await page.getByTestId('layer').selectOption('seen');
        await page.getByTestId('legend-unlearned').waitFor({ state: 'detached' });
        assert.equal(await pixels(page), before);
        await page.getByTestId('layer').selectOption('probability');
        await page.getByTestId('learn').click();
        await page.getByTestId('not-learned').waitFor({ state: 'detached' });
        assert.equal(JSON.parse(daemon.run('map', 'show', 'lab', '--output', 'json'))[0].pending, 0);
        await page.getByTestId('legend-unlearned').waitFor({ state: 'detached' });
        await page.getByTestId('overview-rows').getByText('not learned yet').first().waitFor({ state: 'detached' });
    });

    await check('a flow that no update has learned says so', async () => {
        await page.goto(`${daemon.http}/maps/newhall?at=2025-01-21T09:00:00Z&flow=people`);
        await page.getByRole('alert').getByText('no update has learned any observation of it yet').waitFor();
        daemon.run('update', 'newhall');
        await page.getByTestId('flow-legend').waitFor();
        assert.equal(await page.getByRole('alert').count(), 0);
    });

    await check('several states are in one plot, with a model of choice and the week before', async () => {
        await page.goto(`${daemon.http}/states/office?at=2025-03-12T12:30:00Z&select=kitchen`);
        await page.getByTestId('plot-add').fill('lab');
        await page.getByTestId('plot-add').press('Enter');
        await page.getByRole('button', { name: 'Leave out lab' }).waitFor();
        await page.waitForURL(/with=lab/);
        await page.getByTestId('week-before').check();
        await page.getByTestId('state-week').getByText('observed a week before').waitFor();
        const before = await page.getByTestId('state-value').first().innerText();
        await page.getByTestId('model').selectOption('mean');
        await page.waitForFunction((value) => document.querySelector('[data-testid=state-value]')?.textContent !== value, before);
        const rows = JSON.parse(daemon.run('predict', 'office', 'kitchen', '--at', '2025-03-12T12:30:00Z', '--model', 'mean', '--output', 'json'));
        assert.equal(await page.getByTestId('state-value').first().innerText(), Number(rows[0].probability).toFixed(2));
    });

    await check('an anomaly is shown as it comes', async () => {
        await page.getByTitle('Watching', { exact: true }).waitFor();
        const file = join(folder, 'night.csv');
        writeFileSync(file, 'time,state,value\n2025-03-18T02:00:00Z,kitchen,1\n');
        daemon.run('observe', 'office', file, '--producer', 'robot-2');
        await page.getByTestId('anomalies').getByRole('row').nth(1).waitFor();
    });

    await check('jobs and producers are shown', async () => {
        await page.getByRole('link', { name: 'Operations' }).click();
        await page.getByTestId('jobs').getByText('done').first().waitFor();
        assert.equal(await page.getByTestId('health').innerText(), 'ready');
        await page.getByTestId('producers').getByRole('cell', { name: 'robot-2' }).first().waitFor();
        await page.screenshot({ path: join(folder, 'operations.png') });
    });

    await check('a recording that is dropped becomes a map, and is learned once', async () => {
        daemon.run('sample', 'recording', join(folder, 'recorded'));
        const file = join(folder, 'recorded', 'robot.mcap');
        await page.goto(daemon.http);
        await dropped(page, [file]);
        const name = page.getByTestId('import-map');
        assert.equal(await name.inputValue(), 'robot');
        assert.deepEqual(await violations(page), []);
        await name.fill('No name');
        await page.getByTestId('import-send').click();
        await page.getByTestId('import-refused').getByText('No name is no name of a map').waitFor();
        await name.fill('corridor');
        await name.press('Enter');
        await page.getByTestId('import-outcome').getByText('Imported into corridor.').waitFor();
        const said = await page.getByTestId('import-lines').innerText();
        assert.match(said, /map "corridor" is created[^]*\/scan +sensor_msgs\/LaserScan +2016 +scans +2016 +0 +0/);
        assert.match(said, /map "corridor" has learned 2,016 scans and 4,032 observations, in [0-9.]+ s/);
        assert.deepEqual(await violations(page), []);
        await page.screenshot({ path: join(folder, 'import.png') });
        await page.getByTestId('import-open').click();
        await page.getByTestId('map-canvas').waitFor();
        assert.equal(new URL(page.url()).pathname, '/maps/corridor');
        assert.equal(await page.getByTestId('import-dialog').count(), 0);
        // The map is shown as it was learned.
        await page.getByTestId('legend').waitFor();
        assert.deepEqual(await Promise.all(['not-learned', 'legend-unlearned'].map((id) => page.getByTestId(id).count())), [0, 0]);
        // The same file, picked with the button, is for the open map, and nothing of it is new.
        await page.getByTestId('import-files').setInputFiles(file);
        assert.equal(await name.inputValue(), 'corridor');
        await page.getByTestId('import-send').click();
        await page.getByTestId('import-outcome').waitFor();
        assert.match(await page.getByTestId('import-lines').innerText(), /sent 6048 observations as upload\/robot\.mcap before/);
        assert.equal(await page.getByTestId('import-open').count(), 0);
        await page.keyboard.press('Escape');
        await page.getByTestId('import-dialog').waitFor({ state: 'detached' });
        assert.equal(await page.evaluate(() => document.activeElement?.dataset.testid), 'import');
        const [shown] = JSON.parse(daemon.run('map', 'show', 'corridor', '--output', 'json'));
        assert.deepEqual([shown.scans, shown.pending, shown.pending_scans, shown.updates], [2016, 0, 0, 1]);
    });

    await check('what is no recording is told', async () => {
        const [text, noise] = ['notes.txt', 'noise.bag'].map((name) => join(folder, name));
        writeFileSync(text, 'nothing');
        writeFileSync(noise, HOSTILE.repeat(100));
        await dropped(page, [text]);
        await page.getByRole('alert').getByText('notes.txt is no recording').waitFor();
        assert.equal(await page.getByTestId('import-send').count(), 0);
        await page.keyboard.press('Escape');
        await dropped(page, [noise]);
        await page.getByTestId('import-map').fill('noise');
        await page.getByTestId('import-send').click();
        await page.getByTestId('import-outcome').getByText('Not all was taken').waitFor();
        assert.match(await page.getByTestId('import-lines').innerText(), /noise\.bag: this is no recording that is known/);
        assert.equal(await page.getByTestId('import-open').count(), 0);
        assert.equal(await page.evaluate(() => window.broken), undefined);
        await page.keyboard.press('Escape');
    });

    await check('where nobody may write, a drop says so', async () => {
        const alone = join(folder, 'reading');
        mkdirSync(alone);
        const reading = await Daemon.start(program, cli, alone);
        try {
            await page.goto(reading.http);
            await dropped(page, [join(folder, 'recorded', 'robot.mcap')]);
            await page.getByTestId('import-refused').getByText('http_write').waitFor();
        } finally {
            await reading.stop();
        }
    });

    await check('a daemon that goes away is told, and the page recovers', async () => {
        await page.goto(tuesday);
        await page.waitForFunction((iso) => document.querySelector('[data-testid=map-canvas]')?.dataset.at === iso, at(3));
        await daemon.stop();
        await page.getByTestId('time').evaluate((slider) => {
            slider.value = '960';
            slider.dispatchEvent(new Event('input', { bubbles: true }));
        });
        await page.getByTestId('away').waitFor();
        await daemon.start();
        await page.getByTestId('away').waitFor({ state: 'detached' });
        await page.waitForFunction((iso) => document.querySelector('[data-testid=map-canvas]')?.dataset.at === iso, at(16));
    });

    await check('a daemon that goes away is told where nothing is asked, too', async () => {
        await page.goto(`${daemon.http}/states/office?select=kitchen`);
        await page.getByTestId('state-week').locator('canvas').waitFor();
        await daemon.stop();
        await page.getByTestId('away').waitFor();
        await daemon.start();
        await page.getByTestId('away').waitFor({ state: 'detached' });
    });

    await check('a daemon that hangs is told, and the page recovers', async () => {
        daemon.process.kill('SIGSTOP');
        await page.getByTestId('away').waitFor();
        daemon.process.kill('SIGCONT');
        await page.getByTestId('away').waitFor({ state: 'detached' });
    });

    await check('all views are whole and readable in each size and scheme', () => lookAtViews(browser, daemon, folder));

    await check('a phone shows it without scrolling sideways', async () => {
        const phone = await open(browser, `${daemon.http}/maps/office?at=2025-03-18T10:00:00Z&select=kitchen`, {
            viewport: { width: 390, height: 800 }, deviceScaleFactor: 2, hasTouch: true, isMobile: true, colorScheme: 'dark',
        });
        await phone.getByTestId('state-week').locator('canvas').waitFor();
        assert.ok((await phone.evaluate(() => document.documentElement.scrollWidth)) <= 390);
        await phone.screenshot({ path: join(folder, 'phone.png') });
        assert.deepEqual(phone.problems, []);
        await phone.context().close();
    });

    await check('no code of the page failed', async () => assert.deepEqual(page.problems, []));
} finally {
    await browser?.close();
    await daemon.stop();
}
