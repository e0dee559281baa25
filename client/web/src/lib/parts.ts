// States of several numbers: the likeliest label of a category, and the coordinates of a position.
//
// Invariant: parts are in the order of the daemon: labels as the state lists them, coordinates x, y, z.

import type { State } from '../wire/tidemap/v1/map_pb';
import { StateKind } from '../wire/tidemap/v1/types_pb';

/** The parts of a state, by their names without its own. */
export interface Parts {
    names: string[];
    /** Labels, of which one holds; else coordinates. */
    isLabels: boolean;
}

/** The parts of a state; `undefined` for a state of one number. States with equal parts share one object, so that no
 * effect sees a change. */
export function partsOf(state: Pick<State, 'kind' | 'labels' | 'dimensions'> | undefined): Parts | undefined {
    if (!state || ![StateKind.CATEGORICAL, StateKind.VECTOR].includes(state.kind)) return undefined;
    const isLabels = state.kind === StateKind.CATEGORICAL;
    const found = { names: isLabels ? state.labels : [...'xyz'].slice(0, state.dimensions), isLabels };
    const key = JSON.stringify(found);
    const kept = known.get(key) ?? found;
    known.set(key, kept);
    return kept;
}

const known = new Map<string, Parts>();

/** The index of the likeliest label, and its probability; `undefined` where nothing is known. */
export function likeliestPart(shares: number[]): { index: number; share: number } | undefined {
    let best: { index: number; share: number } | undefined;
    for (const [index, share] of shares.entries()) if (Number.isFinite(share) && share > (best?.share ?? -Infinity)) best = { index, share };
    return best;
}

/** A position, as `x 5.5, y 2.5 m`. */
export function positionText(coordinates: number[]): string {
    const said = coordinates.map((value, index) => `${'xyz'[index] ?? index} ${Number.isFinite(value) ? value.toFixed(Math.abs(value) < 100 ? 1 : 0) : '–'}`);
    return `${said.join(', ')} m`;
}

/** The parts of a category or a position in few words; `undefined` for other kinds. */
export function partsText({ kind, labels }: Pick<State, 'kind' | 'labels'>, parts: number[] | undefined): string | undefined {
    if (!parts?.length) return undefined;
    if (kind === StateKind.VECTOR) return positionText(parts);
    const best = kind === StateKind.CATEGORICAL ? likeliestPart(parts) : undefined;
    return best && (labels[best.index] ?? '');
}

/** The parts of times in which one label holds: the index of the likeliest one from a time on. */
export function labelRuns(times: number[], shares: number[][]): { from: number; index: number }[] {
    const runs: { from: number; index: number }[] = [];
    for (const [at, from] of times.entries()) {
        const best = likeliestPart(shares.map((share) => share[at] ?? Number.NaN));
        if (best && best.index !== runs.at(-1)?.index) runs.push({ from, index: best.index });
    }
    return runs;
}

/** The label that was observed most often from each start up to the next, or to the end; NaN where none was. */
export function modes({ times, values }: { times: number[]; values: number[] }, starts: number[], end: number): number[] {
    const counts = starts.map(() => new Map<number, number>());
    let at = 0;
    for (const [index, ms] of times.entries()) {
        if (ms < (starts[0] ?? end) || ms >= end) continue;
        while (at + 1 < starts.length && ms >= (starts[at + 1] ?? end)) at++;
        const label = values[index] ?? Number.NaN;
        counts[at]?.set(label, (counts[at]?.get(label) ?? 0) + 1);
    }
    return counts.map((count) => [...count].sort((a, b) => b[1] - a[1])[0]?.[0] ?? Number.NaN);
}

/** The name of a part without the name of its state. */
export function partName(state: string, name: string): string {
    return name.startsWith(`${state}/`) ? name.slice(state.length + 1) : name;
}
