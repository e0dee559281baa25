import { svelte } from '@sveltejs/vite-plugin-svelte';
import { defineConfig } from 'vite';

// The address of a running daemon's HTTP port, for `npm run dev`.
const daemon = process.env.TIDEMAP_HTTP ?? 'http://127.0.0.1:7436';
const proxied = ['/tidemap.v1.', '/api', '/healthz', '/readyz', '/metrics'];

/** Writes the descriptors of the wire as they are: base64 hides from gzip what repeats in them. */
const plainDescriptors = {
    name: 'plain-descriptors',
    transform(code, id) {
        if (!/\/wire\/.*_pb\.ts$/.test(id)) return;
        const plain = (_, base64) => `fileDesc(btoa(${JSON.stringify(Buffer.from(base64, 'base64').toString('latin1'))})`;
        return { code: code.replace(/fileDesc\("([A-Za-z0-9+/=]+)"/g, plain), map: null };
    },
};

export default defineConfig({
    plugins: [svelte(), plainDescriptors],
    build: { target: 'es2022', outDir: 'build', emptyOutDir: true, modulePreload: { polyfill: false }, assetsInlineLimit: 0 },
    server: {
        // The daemon refuses requests from pages of other origins, so the proxy speaks in its name.
        proxy: Object.fromEntries(proxied.map((path) => [path, { target: daemon, changeOrigin: true, headers: { origin: daemon } }])),
    },
});
