// The places with most information: the information gain of one observation all around, from places all over the
// visible part of the grid.
//
// Invariant: the parameters are the parameters of `PlanTour` and of the command line: a sensor of 4 m, all around.

import { message, exploration } from './rpc.svelte';
import { toNanos } from './times';

/** Places of one request. */
const PLACES_MAX = 400;
/** The nearest that two places are, metres. */
const SPACING_MIN_M = 1;
const REST_MS = 150;

export interface Look {
    x: number;
    y: number;
    /** Edge of the square that the place represents, metres. */
    size: number;
    bits: number;
}

interface Box {
    minX: number;
    minY: number;
    maxX: number;
    maxY: number;
}

/** The places of a lattice over a box in metres, and the edge of its squares. */
export function placesOf({ minX, minY, maxX, maxY }: Box): { size: number; places: { x: number; y: number }[] } {
    const [width, height] = [Math.max(0, maxX - minX), Math.max(0, maxY - minY)];
    const count = (length: number, edge: number) => Math.max(1, Math.ceil(length / edge - 1e-9));
    let size = Math.max(SPACING_MIN_M, Math.sqrt((width * height) / PLACES_MAX));
    while (count(width, size) * count(height, size) > PLACES_MAX) size *= 1.1;
    // The squares cover the box evenly: the excess lies on both sides.
    const along = (from: number, length: number) => {
        const squares = count(length, size);
        return Array.from({ length: squares }, (_, index) => from + (length - squares * size) / 2 + (index + 0.5) * size);
    };
    const columns = along(minX, width);
    const places = along(minY, height).flatMap((y) => columns.map((x) => ({ x, y })));
    return { size, places };
}

export class LookFeed {
    looks: Look[] = $state.raw([]);
    problem = $state('');
    #timer: ReturnType<typeof setTimeout> | undefined;
    #stop: AbortController | undefined;
    #key = '';

    /** Requests the gains of the visible part at a time; without a box there are none. `generation` changes when the
     * reply may change. */
    ask(map: string, box: Box | undefined, at: number, generation = ''): void {
        const key = JSON.stringify([map, box, at, generation]);
        if (key === this.#key) return;
        this.stop();
        this.#key = key;
        if (!box) {
            this.looks = [];
            return;
        }
        this.#timer = setTimeout(() => void this.#answer(map, box, at), REST_MS);
    }

    stop(): void {
        this.#key = '';
        clearTimeout(this.#timer);
        this.#stop?.abort();
    }

    async #answer(map: string, box: Box, at: number): Promise<void> {
        const { size, places } = placesOf(box);
        const stop = (this.#stop = new AbortController());
        const viewpoints = places.map(({ x, y }) => ({ xM: x, yM: y }));
        const found: Look[] = [];
        try {
            for await (const answer of exploration.evaluateViews({ map, viewpoints, timesNanos: [toNanos(at)] }, { signal: stop.signal })) {
                const place = places[answer.viewpoint];
                const bits = answer.informationBits[0] ?? Number.NaN;
                if (place && Number.isFinite(bits)) found.push({ ...place, size, bits });
            }
            if (!stop.signal.aborted) [this.looks, this.problem] = [found, ''];
        } catch (error) {
            if (!stop.signal.aborted) this.problem = message(error);
        }
    }
}
