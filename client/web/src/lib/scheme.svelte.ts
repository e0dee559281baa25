// Whether the page is dark, as the system wants it.
//
// Invariant: files that are saved are for white paper in both schemes.

const query = globalThis.matchMedia?.('(prefers-color-scheme: dark)');
const scheme = $state({ isDark: query?.matches ?? false });
query?.addEventListener('change', ({ matches }) => (scheme.isDark = matches));
let isPaper = false;

/** Whether colours are for a dark ground. */
export function isDark(): boolean {
    return scheme.isDark && !isPaper;
}

/** Makes something with the colours of white paper. */
export function onPaper<T>(make: () => T): T {
    isPaper = true;
    try {
        return make();
    } finally {
        isPaper = false;
    }
}

/** Changes the scheme: for tests. */
export function setDark(dark: boolean): void {
    scheme.isDark = dark;
}
