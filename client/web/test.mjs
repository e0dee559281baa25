// Runs the tests of the page's source, `src/**/*.test.ts`, in Node: Vite makes a module of each, as it makes the page.
//
// Invariant: what is made stays out of `build` and `dist`.

import { spawnSync } from 'node:child_process';
import { readdirSync, rmSync } from 'node:fs';
import { basename, join } from 'node:path';

import { svelte } from '@sveltejs/vite-plugin-svelte';
import { build } from 'vite';

// Git and the checks of the source ignore this folder, and modules in it find the packages.
const FOLDER = 'node_modules/.tests';

const tests = readdirSync('src', { recursive: true })
    .filter((name) => name.endsWith('.test.ts'))
    .sort();
if (tests.length === 0) throw new Error('there are no tests below src');
await build({
    configFile: false,
    logLevel: 'warn',
    plugins: [svelte()],
    build: {
        ssr: true,
        target: 'node20',
        outDir: FOLDER,
        emptyOutDir: true,
        rollupOptions: {
            input: Object.fromEntries(tests.map((name) => [basename(name, '.ts'), join('src', name)])),
            output: { entryFileNames: '[name].mjs', chunkFileNames: 'parts/[name].mjs' },
        },
    },
});
const made = readdirSync(FOLDER)
    .filter((name) => name.endsWith('.test.mjs'))
    .map((name) => join(FOLDER, name));
// `test-browser.mjs` stands in for the browser.
const { status, stdout } = spawnSync(process.execPath, ['--import', './test-browser.mjs', '--test', '--test-reporter', 'spec', ...made], {
    encoding: 'utf8',
    timeout: 120_000,
    stdio: ['ignore', 'pipe', 'inherit'],
    // The zone of the machine must not matter: one far from all that the tests use.
    env: { ...process.env, TZ: 'Pacific/Kiritimati' },
});
rmSync(FOLDER, { recursive: true });
if (status === 0) console.log(`${/tests \d+/.exec(stdout)?.[0]} of the page's source pass`);
else console.error(stdout);
process.exit(status ?? 1);
