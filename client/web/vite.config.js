import { svelte } from '@sveltejs/vite-plugin-svelte';
import { defineConfig } from 'vite';

// The address of a running daemon's HTTP port, for `npm run dev`.
const daemon = process.env.TIDEMAP_HTTP ?? 'http://127.0.0.1:7436';
const proxied = ['/tidemap.v1.', '/api', '/healthz', '/readyz', '/metrics'];

export default defineConfig({
    plugins: [svelte()],
    build: { target: 'es2022', outDir: 'build', emptyOutDir: true, modulePreload: { polyfill: false }, assetsInlineLimit: 0 },
    server: {
        // The daemon refuses requests from pages of other origins, so the proxy speaks in its name.
        proxy: Object.fromEntries(proxied.map((path) => [path, { target: daemon, changeOrigin: true, headers: { origin: daemon } }])),
    },
});
