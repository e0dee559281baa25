// All views of the page at four sizes and in two schemes: pictures, contrast by axe-core, and nothing beside the edge.
//
// Invariant: a picture is `view-NAME-SIZE-SCHEME.png` in the folder of the test.

import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { join } from 'node:path';

import { open } from './stage.mjs';

const AXE = readFileSync(createRequire(import.meta.url).resolve('axe-core/axe.min.js'), 'utf8');
const SIZES = {
    wide: { viewport: { width: 1440, height: 900 } },
    tablet: { viewport: { width: 820, height: 1180 }, hasTouch: true },
    laptop: { viewport: { width: 1024, height: 700 } },
    phone: { viewport: { width: 390, height: 800 }, deviceScaleFactor: 2, hasTouch: true, isMobile: true },
};
const AT = 'at=2025-03-18T10:00:00Z';
/** The views, and what is there once they are whole. */
const VIEWS = {
    maps: ['/', 'maps'],
    map: [`/maps/office?${AT}`, 'map-canvas'],
    overview: [`/maps/office?${AT}&list=1&sort=unusual`, 'overview-rows'],
    select: [`/maps/office?${AT}&list=0&select=kitchen`, 'state-week'],
    week: [`/maps/doors?rows=week&sort=soon`, 'overview-rows'],
    three: [`/maps/office?${AT}&list=1&select=kitchen`, 'state-week'],
    look: [`/maps/office?${AT}&list=0&layer=look&tool=explore&start=10,8.4`, 'information'],
    states: [`/states/office?${AT}&select=kitchen`, 'state-week'],
    changes: ['/states/contacts?at=2025-03-20T10:00:00Z&select=contact', 'reported-then'],
    flow: ['/maps/hall?at=2025-01-21T09:00:00Z&flow=people&list=0', 'motion'],
    operations: ['/operations', 'jobs'],
};

/** Requests that last as long as the view, or come whatever it shows. */
const LASTING = /WatchAnomalies|readyz/;
const QUIET_MS = 200;
const QUIET_WITHIN_MS = 10_000;

/** Follows the requests of a page; the answer waits until it has what it asked for, and asks for no more. */
function quietly(page) {
    const open = new Set();
    let last = Date.now();
    const note = (request, isOpen) => {
        if (LASTING.test(request.url())) return;
        last = Date.now();
        if (isOpen) open.add(request);
        else open.delete(request);
    };
    page.on('request', (request) => note(request, true));
    for (const end of ['requestfinished', 'requestfailed']) page.on(end, (request) => note(request, false));
    return async () => {
        const begun = Date.now();
        while (open.size || Date.now() - last < QUIET_MS) {
            if (Date.now() - begun > QUIET_WITHIN_MS) throw new Error(`still waits for ${[...open].map((request) => request.url())}`);
            await page.waitForTimeout(20);
        }
    };
}

/** What axe-core finds against WCAG 2 A and AA, as lines. */
export async function violations(page) {
    await page.evaluate(AXE);
    const found = await page.evaluate(async () => {
        const rules = { type: 'tag', values: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa'] };
        const { violations } = await globalThis.axe.run(document, { runOnly: rules });
        return violations.map(({ id, nodes }) => `${id}: ${nodes.slice(0, 4).map((node) => `${node.target} (${node.any[0]?.message ?? ''})`).join('; ')}`);
    });
    return found;
}

/** Looks at each view in each size and scheme. */
export async function lookAtViews(browser, daemon, folder) {
    const problems = [];
    for (const [size, options] of Object.entries(SIZES)) {
        const look = async (colorScheme) => {
            const page = await open(browser, 'about:blank', { ...options, colorScheme });
            const isQuiet = quietly(page);
            for (const [view, [path, there]] of Object.entries(VIEWS)) {
                const where = `${view}, ${size}, ${colorScheme}`;
                await page.goto(`${daemon.http}${path}`);
                await page.getByTestId(there).first().waitFor().then(isQuiet).catch(async (error) => {
                    await page.screenshot({ path: join(folder, 'failed-view.png') });
                    throw new Error(`${where}: ${error.message}`, { cause: error });
                });
                await page.screenshot({ path: join(folder, `view-${view}-${size}-${colorScheme}.png`) });
                for (const found of await violations(page)) problems.push(`${where}: ${found}`);
                const beside = await page.evaluate(() => {
                    const parts = [document.documentElement, ...document.querySelectorAll('main, section, aside, canvas, .list')];
                    const isIn = (part) => part.closest('.wide') === null && part.getClientRects().length > 0;
                    return Math.round(Math.max(...parts.filter(isIn).map((part) => part.getBoundingClientRect().right)) - document.documentElement.clientWidth);
                });
                if (beside > 0) problems.push(`${where}: ${beside} pixels lie beside the edge`);
            }
            assert.deepEqual(page.problems, []);
            await page.context().close();
        };
        await Promise.all(['light', 'dark'].map(look));
    }
    assert.deepEqual(problems, []);
}
