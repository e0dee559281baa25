// The view that the page shows, from its address: `/maps/NAME?at=…&layer=…`, `/states/NAME`, `/operations`.
//
// Invariant: the address alone restores a view. Names are written with percent signs where needed.

import { MINUTE, rfc3339 } from './civil';

export type ViewName = 'maps' | 'states' | 'operations';

interface Address {
    view: ViewName;
    /** Name of the map; empty: the list of maps. */
    map: string;
    params: Record<string, string>;
}

function decode(part: string): string {
    try {
        return decodeURIComponent(part);
    } catch {
        return part;
    }
}

function read(): Address {
    const [first = '', second = ''] = window.location.pathname.split('/').filter(Boolean);
    const view: ViewName = first === 'states' || first === 'operations' ? first : 'maps';
    return { view, map: decode(second), params: Object.fromEntries(new URLSearchParams(window.location.search)) };
}

export const address: Address = $state(read());

function assign(): void {
    Object.assign(address, read());
}

window.addEventListener('popstate', assign);

/** The path of a view. */
export function pathOf(view: ViewName, map = ''): string {
    return map ? `/${view}/${encodeURIComponent(map)}` : view === 'maps' ? '/' : `/${view}`;
}

/** Goes to a path of the page. */
export function go(path: string): void {
    window.history.pushState(null, '', path);
    assign();
}

/** Lets a plain click on a link of the page change the view without loading it again. */
export function follow(event: MouseEvent): void {
    if (event.button !== 0 || event.metaKey || event.ctrlKey || event.shiftKey) return;
    const target = event.currentTarget as HTMLAnchorElement;
    event.preventDefault();
    go(target.pathname + target.search);
}

let waiting: ReturnType<typeof setTimeout> | undefined;

/** Changes parameters of the address; `undefined` or an empty text removes one. Makes no step in the history. */
export function setParams(changes: Record<string, string | undefined>): void {
    for (const [name, value] of Object.entries(changes)) {
        if (value) address.params[name] = value;
        else delete address.params[name];
    }
    // Browsers refuse more than about a hundred changes in half a minute: a playing slider waits.
    clearTimeout(waiting);
    const path = window.location.pathname;
    waiting = setTimeout(() => {
        if (window.location.pathname !== path) return;
        const text = new URLSearchParams(address.params).toString();
        window.history.replaceState(null, '', text ? `${path}?${text}` : path);
    }, 400);
}

/** Changes the time of the view, to the minute. */
export function setTime(ms: number, zone: string): void {
    setParams({ at: rfc3339(Math.round(ms / MINUTE) * MINUTE, zone) });
}
