// Packs what Vite built into `dist`, compressed, as the daemon embeds it.
//
// Invariant: the same source gives the same files. Other versions of zlib pack the same content in other bytes, so a
// file whose content is unchanged is left as it is.

import { mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from 'node:fs';
import { dirname, join } from 'node:path';
import { gunzipSync, gzipSync } from 'node:zlib';

/** The most that all files together may weigh over the wire, bytes. */
const WEIGHT_MAX = 160 * 1024;

function filesOf(folder) {
    try {
        return readdirSync(folder, { recursive: true, withFileTypes: true })
            .filter((entry) => entry.isFile())
            .map((entry) => join(entry.parentPath, entry.name))
            .sort();
    } catch {
        return [];
    }
}

function hasContent(path, content) {
    try {
        return gunzipSync(readFileSync(path)).equals(content);
    } catch {
        return false;
    }
}

let weight = 0;
const targets = new Set();
for (const name of filesOf('build')) {
    const target = `${name.replace(/^build/, 'dist')}.gz`;
    const content = readFileSync(name);
    targets.add(target);
    if (!hasContent(target, content)) {
        const packed = gzipSync(content, { level: 9 });
        packed[9] = 255; // The system that packed it: unknown.
        mkdirSync(dirname(target), { recursive: true });
        writeFileSync(target, packed);
    }
    const { length } = readFileSync(target);
    weight += length;
    console.log(`${String(length).padStart(8)}  ${target}`);
}
for (const stale of filesOf('dist').filter((path) => !targets.has(path))) rmSync(stale);
console.log(`${String(weight).padStart(8)}  in all, of at most ${WEIGHT_MAX}`);
if (weight > WEIGHT_MAX) throw new Error(`the page weighs ${weight} bytes; at most ${WEIGHT_MAX} are allowed`);
