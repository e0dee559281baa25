// The flow of people of a map at the time of the slider.
//
// Invariant: `flow` belongs to the states of the newest request. One request runs at a time.

import type { PredictFlowResponse } from '../wire/tidemap/v1/query_pb';
import type { Flow, FlowStates } from './flow';
import { oneAtATime } from './latest';
import { message, queries } from './rpc.svelte';
import { toNanos } from './times';

/** The slider comes to rest before a request is sent. */
const REST_MS = 60;

/** The flow that is made of the pieces of a reply for one time. */
export async function readFlow(answers: AsyncIterable<PredictFlowResponse>): Promise<Flow> {
    const flow: Flow = { lowX: 0, lowY: 0, edge: 1, columns: 0, rows: 0, detections: 0n, cells: [] };
    let directions = 1;
    for await (const { message } of answers) {
        if (message.case === 'header') {
            const { lowM, resolutionM, counts, detections } = message.value;
            directions = message.value.directions;
            const [lowX = 0, lowY = 0] = lowM;
            const [columns = 0, rows = 0] = counts;
            Object.assign(flow, { lowX, lowY, edge: resolutionM, columns, rows, detections });
        } else if (message.case === 'cells') {
            const { indices, expectedCounts, shares } = message.value;
            for (const [place, index] of indices.entries()) {
                flow.cells.push({
                    column: index % flow.columns, row: Math.floor(index / flow.columns),
                    count: expectedCounts[place] ?? 0, shares: shares.slice(place * directions, (place + 1) * directions),
                });
            }
        }
    }
    return flow;
}

export class FlowFeed {
    flow: Flow | undefined = $state.raw();
    /** The time of that flow, milliseconds. */
    shownMs = $state(Number.NaN);
    problem = $state('');
    #key = '';
    #timer: ReturnType<typeof setTimeout> | undefined;
    #stop = new AbortController();
    readonly #run = oneAtATime();

    /** Requests the flow of a time; without states there is none. A change of `generation` only makes a new request. */
    ask(map: string, states: FlowStates | undefined, ms: number, generation: string): void {
        void generation;
        const key = states ? JSON.stringify([map, states.positions, states.directions]) : '';
        if (key !== this.#key) {
            this.stop();
            this.#key = key;
            [this.flow, this.shownMs, this.problem] = [undefined, Number.NaN, ''];
        }
        clearTimeout(this.#timer);
        // A request that still waits when other states are chosen ends with this signal, not with the next one.
        const { signal } = this.#stop;
        if (states) this.#timer = setTimeout(() => this.#run(() => this.#answer(map, states, ms, signal)), REST_MS);
    }

    /** Drops the request that is on its way. */
    stop(): void {
        this.#key = '';
        clearTimeout(this.#timer);
        this.#stop.abort();
        this.#stop = new AbortController();
    }

    async #answer(map: string, { positions, directions }: FlowStates, ms: number, signal: AbortSignal): Promise<void> {
        if (signal.aborted) return;
        try {
            const request = { map, source: { state: positions, motionState: directions }, timesNanos: [toNanos(ms)] };
            const flow = await readFlow(queries.predictFlow(request, { signal }));
            if (!signal.aborted) [this.flow, this.shownMs, this.problem] = [flow, ms, ''];
        } catch (error) {
            if (signal.aborted) return;
            this.problem = message(error);
            // While the daemon is away, the page keeps its content.
            if (this.problem) [this.flow, this.shownMs] = [undefined, Number.NaN];
        }
    }
}
