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

/** The shortest time between two changes of the written address: browsers refuse about a hundred in half a minute. */
const BETWEEN_WRITES_MS = 400;
let waiting: ReturnType<typeof setTimeout> | undefined;
let writtenAt = -Infinity;

function write(path: string): void {
    // A view that was left meanwhile has no address to write.
    if (window.location.pathname !== path) return;
    writtenAt = performance.now();
    const text = new URLSearchParams(address.params).toString();
    window.history.replaceState(null, '', text ? `${path}?${text}` : path);
}

/**
 * Changes parameters of the address; `undefined` or an empty text removes one. Makes no step in the history.
 *
 * The first change is written at once, so that loading the page again shows the same view; the changes of a playing
 * slider are written every 0.4 s.
 */
export function setParams(changes: Record<string, string | undefined>): void {
    for (const [name, value] of Object.entries(changes)) {
        if (value) address.params[name] = value;
        else delete address.params[name];
    }
    clearTimeout(waiting);
    const path = window.location.pathname;
    const rest = writtenAt + BETWEEN_WRITES_MS - performance.now();
    if (rest <= 0) write(path);
    else waiting = setTimeout(() => write(path), rest);
}

/** Changes the time of the view, to the minute. */
export function setTime(ms: number, zone: string): void {
    setParams({ at: rfc3339(Math.round(ms / MINUTE) * MINUTE, zone) });
}
