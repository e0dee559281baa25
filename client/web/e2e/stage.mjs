// A daemon with the building of `tidemap sample`, and a browser in front of it.
//
// Invariant: every process that is started here ends with `stop`; everything is written into one folder.

import { execFileSync, spawn } from 'node:child_process';
import { openSync, readdirSync, readFileSync } from 'node:fs';
import { createServer } from 'node:net';
import { basename, join } from 'node:path';

import { chromium } from 'playwright-core';

const CHROMIUM = process.env.TIDEMAP_CHROMIUM ?? '/usr/bin/chromium';
// A browser for tests: no window, no sandbox (tests may run as root), and no calls home.
const FLAGS = [
    '--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking',
    '--disable-component-update', '--disable-sync', '--enable-precise-memory-info', '--js-flags=--expose-gc',
];
const START_WITHIN_MS = 30_000;

/** A port that nothing listens on. */
export function freePort() {
    return new Promise((done, failed) => {
        const server = createServer();
        server.once('error', failed);
        server.listen(0, '127.0.0.1', () => {
            const { port } = server.address();
            server.close(() => done(port));
        });
    });
}

export class Daemon {
    constructor(program, cli, folder, ports, options = []) {
        [this.program, this.cli, this.folder, this.ports, this.options] = [program, cli, folder, ports, options];
        this.http = `http://127.0.0.1:${ports.http}`;
        this.server = `http://127.0.0.1:${ports.grpc}`;
    }

    static async start(program, cli, folder, options = []) {
        const daemon = new Daemon(program, cli, folder, { grpc: await freePort(), http: await freePort() }, options);
        await daemon.start();
        return daemon;
    }

    async start() {
        const log = openSync(join(this.folder, 'daemon.log'), 'a');
        const listen = [['--listen', this.ports.grpc], ['--http-listen', this.ports.http]].flatMap(([flag, port]) => [flag, `127.0.0.1:${port}`]);
        this.process = spawn(this.program, ['--data-dir', join(this.folder, 'data'), ...listen, ...this.options], { stdio: ['ignore', log, log] });
        for (const begun = Date.now(); ; ) {
            const answer = await fetch(`${this.http}/readyz`).catch(() => undefined);
            if (answer?.ok) return;
            if (Date.now() - begun > START_WITHIN_MS || this.process.exitCode !== null) throw new Error(`the daemon does not start: see ${this.folder}/daemon.log`);
            await new Promise((next) => setTimeout(next, 50));
        }
    }

    async stop() {
        if (!this.process || this.process.exitCode !== null) return;
        const ended = new Promise((done) => this.process.once('exit', done));
        this.process.kill('SIGTERM');
        await ended;
    }

    /** Runs the command line and returns what it prints. */
    run(...args) {
        return execFileSync(this.cli, args, { env: { ...process.env, TIDEMAP_SERVER: this.server }, encoding: 'utf8' });
    }

    async call(method, message) {
        const answer = await fetch(`${this.http}/api/v1/${method}`, {
            method: 'POST', headers: { 'content-type': 'application/json' }, body: JSON.stringify(message),
        });
        if (!answer.ok) throw new Error(`${method}: ${await answer.text()}`);
        return answer.json();
    }

    /** Makes the map `office` of `tidemap sample building`. */
    furnish({ cell = 0.2, days = 14, scansPerDay = 24 } = {}) {
        const files = join(this.folder, 'office');
        const maps = this.building(files, { cell, days, scansPerDay });
        this.run('map', 'create', 'office', '--time-zone', 'Europe/London', '--grid', `resolution=${cell},flat`, '--grid-retention', 'forever');
        const times = ['--times-from', 'map_%Y-%m-%d_%H-%M.yaml', '--utc'];
        this.run('grid', 'observe', 'office', ...maps, ...times, '--producer', 'scanner', '--label', 'scans');
        this.run('observe', 'office', join(files, 'rooms.csv'), '--producer', 'robot-1');
        this.run('topology', 'load', 'office', join(files, 'topology.yaml'));
        this.run('traverse', 'office', join(files, 'drives.csv'), '--producer', 'robot-1');
        this.run('update', 'office');
    }

    /** Writes the building; the files of its maps in order of time. */
    building(folder, { cell, days, scansPerDay }) {
        this.run('sample', 'building', folder, '--cell', String(cell), '--days', String(days), '--scans-per-day', String(scansPerDay));
        const names = readdirSync(join(folder, 'maps')).filter((name) => name.endsWith('.yaml'));
        return names.sort().map((name) => join(folder, 'maps', name));
    }
}

/** A browser. */
export function launch() {
    return chromium.launch({ executablePath: CHROMIUM, args: FLAGS });
}

/** A page that fails the test when its code does. */
export async function open(browser, url, options = {}) {
    const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, ...options });
    const page = await context.newPage();
    page.problems = [];
    page.on('pageerror', (error) => page.problems.push(error.message));
    await page.goto(url);
    return page;
}

/** A hash of the pixels of the map. */
export function pixels(page) {
    return page.getByTestId('map-canvas').evaluate((canvas) => {
        const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
        let hash = 2_166_136_261;
        for (let index = 0; index < data.length; index += 4) {
            hash = Math.imul(hash ^ data[index] ^ (data[index + 1] << 8) ^ (data[index + 2] << 16), 16_777_619);
        }
        return hash >>> 0;
    });
}

/** Drops files onto the page. */
export async function dropped(page, files) {
    // A dialog that Escape has closed takes part until its event, and the page takes no drop meanwhile.
    await page.getByTestId('import-dialog').waitFor({ state: 'detached' });
    const contents = files.map((file) => ({ name: basename(file), base64: readFileSync(file).toString('base64') }));
    const transfer = await page.evaluateHandle((contents) => {
        const transfer = new DataTransfer();
        for (const { name, base64 } of contents) transfer.items.add(new File([Uint8Array.from(atob(base64), (byte) => byte.charCodeAt(0))], name));
        return transfer;
    }, contents);
    for (const event of ['dragover', 'drop']) await page.dispatchEvent('main', event, { dataTransfer: transfer });
    await page.getByTestId('import-dialog').waitFor();
}

/** Moves the slider of the day to a time and waits until the map shows it. */
export async function slideTo(page, minutes, iso) {
    await page.getByTestId('time').evaluate((slider, value) => {
        slider.value = value;
        slider.dispatchEvent(new Event('input', { bubbles: true }));
    }, String(minutes));
    await page.waitForFunction((at) => document.querySelector('[data-testid=map-canvas]')?.dataset.at === at, iso);
}
