// Stands in for a browser in the tests in Node: the parts that the page's source uses when it is loaded.

const listeners = new Map();
globalThis.window = {
    location: { origin: 'http://127.0.0.1:9', pathname: '/', search: '' },
    history: {
        pushState(_state, _title, path) {
            const { pathname, search } = new URL(path, window.location.origin);
            Object.assign(window.location, { pathname, search });
        },
        replaceState(state, title, path) {
            this.pushState(state, title, path);
        },
    },
    addEventListener: (name, listener) => listeners.set(name, listener),
    dispatchEvent: ({ type }) => listeners.get(type)?.(),
};
// A test that reaches the network is wrong: it says what the daemon answers.
globalThis.fetch = () => Promise.reject(new TypeError('the tests have no daemon'));
