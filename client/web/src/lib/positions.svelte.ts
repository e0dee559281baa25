// Where things are expected at a time: the coordinates of the positions of a map, to draw on it.
//
// Invariant: a position that no update has learned is where it was last seen; one that was never observed is left out.

import type { State } from '../wire/tidemap/v1/map_pb';
import { ModelKind } from '../wire/tidemap/v1/types_pb';
import type { Extent } from './extent';
import { oneAtATime } from './latest';
import { isLearned } from './learned';
import type { PlanMark } from './plan';
import { positionText } from './parts';
import { queries } from './rpc.svelte';
import { toNanos } from './times';

/** Positions that are drawn. */
const SHOWN_MAX = 50;
/** Room around positions, metres. */
const AROUND_M = 3;

export class PositionFeed {
    marks: PlanMark[] = $state.raw([]);
    /** Around all positions so far: the view does not jump. */
    extent: Extent | undefined = $state.raw();
    readonly #run = oneAtATime();
    #key = '';

    /** Requests the positions of a time; a change of `generation` only makes a new request. */
    ask(map: string, states: State[], ms: number, generation: string): void {
        const shown = states.filter((state) => state.observations > 0n).slice(0, SHOWN_MAX);
        const key = JSON.stringify([map, shown.map((state) => state.name), ms, generation]);
        if (key === this.#key) return;
        this.#key = key;
        // The list shows the problem.
        this.#run(() => this.#ask(map, shown, ms).catch(() => undefined));
    }

    async #ask(map: string, states: State[], ms: number): Promise<void> {
        const marks: PlanMark[] = [];
        for (const isForecast of [true, false]) {
            const names = states.filter((state) => isLearned(state) === isForecast).map((state) => state.name);
            if (names.length === 0) continue;
            const found = new Map<string, number[]>();
            const model = isForecast ? undefined : { kind: ModelKind.LATEST };
            for await (const { stateIndex, axis, probabilities } of queries.predictStates({ map, states: names, timesNanos: [toNanos(ms)], model })) {
                const name = names[stateIndex] ?? '';
                const at = found.get(name) ?? [];
                at[axis - 1] = probabilities[0] ?? Number.NaN;
                found.set(name, at);
            }
            for (const [name, at] of found) {
                const [x = Number.NaN, y = Number.NaN] = at;
                if (Number.isFinite(x + y)) marks.push({ name, x, y, title: `${name}: ${isForecast ? 'expected at' : 'last seen at'} ${positionText(at)}` });
            }
        }
        this.marks = marks;
        if (marks.length === 0) return;
        const [xs, ys] = [marks.map(({ x }) => x), marks.map(({ y }) => y)];
        const { minX = Infinity, minY = Infinity, maxX = -Infinity, maxY = -Infinity } = this.extent ?? {};
        const extent = {
            minX: Math.min(minX, ...xs.map((x) => x - AROUND_M)), maxX: Math.max(maxX, ...xs.map((x) => x + AROUND_M)),
            minY: Math.min(minY, ...ys.map((y) => y - AROUND_M)), maxY: Math.max(maxY, ...ys.map((y) => y + AROUND_M)),
        };
        if (JSON.stringify(extent) !== JSON.stringify(this.extent)) this.extent = extent;
    }
}
