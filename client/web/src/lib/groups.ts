// Rows of a list of states: those of a kind that the daemon derives, such as `edge/A/B`, are folded into one.
//
// Invariant: every state is in the list or in a folded group; states keep their order.

import type { State } from '../wire/tidemap/v1/map_pb';

/** States of one kind. */
export interface Group {
    /** What their names begin with, without the `/`. */
    prefix: string;
    count: number;
    isOpen: boolean;
}

export type Row = { state: State; group?: undefined } | { group: Group; state?: undefined };

/** A list of at most this many states is not folded. */
const WHOLE_MOST = 12;
/** Fewer states are no group. */
const GROUP_LEAST = 3;

const MEANINGS: Record<string, string> = {
    edge: 'edges: passed', speed: 'edges: speed', pace: 'edges: pace', node: 'presence at places',
    landmark: 'landmarks: visible', task: 'tasks: done',
};

/** The kind of a state, by its name; empty: a name that a robot gave. */
export function prefixOf(name: string): string {
    const end = name.indexOf('/');
    return end > 0 ? name.slice(0, end) : '';
}

/** What the states of a group are. */
export function meaningOf(prefix: string): string {
    return MEANINGS[prefix] ?? '';
}

/** The rows of a list. `open` has the groups that were opened or closed by hand; the group of a chosen state is
 * open. */
export function rowsOf(states: State[], open: ReadonlyMap<string, boolean>, chosen: string[], isFolded: boolean): Row[] {
    if (!isFolded || states.length <= WHOLE_MOST) return states.map((state) => ({ state }));
    const counts = new Map<string, number>();
    for (const { name } of states) counts.set(prefixOf(name), (counts.get(prefixOf(name)) ?? 0) + 1);
    const wanted = new Set(chosen.map(prefixOf));
    const rows: Row[] = [];
    const begun = new Set<string>();
    for (const state of states) {
        const prefix = prefixOf(state.name);
        const count = counts.get(prefix) ?? 0;
        if (!prefix || count < GROUP_LEAST) {
            rows.push({ state });
            continue;
        }
        const isOpen = open.get(prefix) ?? wanted.has(prefix);
        if (!begun.has(prefix)) rows.push({ group: { prefix, count, isOpen } });
        begun.add(prefix);
        if (isOpen) rows.push({ state });
    }
    return rows;
}

/** The key of a row. */
export function keyOf(row: Row): string {
    return row.state ? row.state.name : `${row.group.prefix}//`;
}
