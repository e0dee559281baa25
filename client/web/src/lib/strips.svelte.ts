// The predictions of the rows that are visible: their hours, the value at the time of the slider, and the last reading.
//
// Invariant: only rows that were asked for are predicted, one request at a time; what was asked before is not waited
// for. At most `KEPT_MAX` rows are kept.

import { ModelKind } from '../wire/tidemap/v1/types_pb';
import { HOUR } from './civil';
import type { Columns } from './rows';
import { message, queries } from './rpc.svelte';
import { toNanos } from './times';

/** Rows that are kept. */
const KEPT_MAX = 4000;
/** Rows of a request. */
const ASKED_MAX = 200;
/** Scrolling and sliding come to rest before anything is asked. */
const REST_MS = 50;

export interface StripQuestion {
    map: string;
    names: string[];
    columns: Columns;
    at: number;
    /** Changes when predictions do. */
    generation: string;
    /** Milliseconds to subtract for the rows to compare with; 0 for none. */
    against: number;
}

async function predict(map: string, states: string[], times: number[], model?: { kind: ModelKind }): Promise<number[][]> {
    const found: number[][] = states.map(() => []);
    const timesNanos = times.map(toNanos);
    for await (const piece of queries.predictStates({ map, states, timesNanos, model })) {
        // The first axis of a vector stands for it.
        if (piece.axis <= 1) found[piece.stateIndex]?.push(...piece.probabilities);
    }
    return found;
}

export class StripFeed {
    rows: ReadonlyMap<string, number[]> = $state.raw(new Map());
    before: ReadonlyMap<string, number[]> = $state.raw(new Map());
    now: ReadonlyMap<string, number> = $state.raw(new Map());
    /** The newest readings. */
    last: ReadonlyMap<string, number> = $state.raw(new Map());
    problem = $state('');
    #lastKey = '';
    #key = '';
    #nowKey = '';
    #wanted: StripQuestion | undefined;
    #timer: ReturnType<typeof setTimeout> | undefined;
    #isAsking = false;

    ask(question: StripQuestion): void {
        this.#wanted = question;
        clearTimeout(this.#timer);
        this.#timer = setTimeout(() => void this.#run(), REST_MS);
    }

    stop(): void {
        clearTimeout(this.#timer);
        this.#wanted = undefined;
    }

    async #run(): Promise<void> {
        if (this.#isAsking) return;
        this.#isAsking = true;
        for (let question = this.#wanted; question; question = this.#wanted) {
            this.#wanted = undefined;
            try {
                await this.#answer(question);
                this.problem = '';
            } catch (error) {
                this.problem = message(error);
            }
        }
        this.#isAsking = false;
    }

    async #answer({ map, names, columns, at, generation, against }: StripQuestion): Promise<void> {
        const key = JSON.stringify([map, columns.starts[0], columns.span, generation, against]);
        if (key !== this.#key) {
            [this.#key, this.rows, this.before] = [key, new Map(), new Map()];
        }
        const asked = names.slice(0, ASKED_MAX);
        const nowKey = JSON.stringify([map, generation, at]);
        const known = nowKey === this.#nowKey ? this.now : new Map<string, number>();
        const moments = asked.filter((name) => !known.has(name));
        if (moments.length) {
            const values = await predict(map, moments, [at]);
            const now = new Map(known);
            for (const [index, name] of moments.entries()) now.set(name, values[index]?.[0] ?? Number.NaN);
            [this.now, this.#nowKey] = [now, nowKey];
        }
        const lastKey = JSON.stringify([map, generation]);
        const read = lastKey === this.#lastKey ? this.last : new Map<string, number>();
        const unread = asked.filter((name) => !read.has(name));
        if (unread.length) {
            const values = await predict(map, unread, [at], { kind: ModelKind.LATEST });
            const last = new Map(read);
            for (const [index, name] of unread.entries()) last.set(name, values[index]?.[0] ?? Number.NaN);
            [this.last, this.#lastKey] = [last, lastKey];
        }
        const missing = asked.filter((name) => !this.rows.has(name));
        if (missing.length === 0) return;
        const middles = columns.starts.map((start) => start + HOUR / 2);
        const rows = new Map(this.rows);
        const values = await predict(map, missing, middles);
        for (const [index, name] of missing.entries()) rows.set(name, values[index] ?? []);
        for (const name of rows.keys()) {
            if (rows.size <= KEPT_MAX) break;
            rows.delete(name);
        }
        if (against) {
            const before = new Map(this.before);
            const earlier = await predict(map, missing, middles.map((ms) => ms - against));
            for (const [index, name] of missing.entries()) before.set(name, earlier[index] ?? []);
            this.before = before;
        }
        this.rows = rows;
    }
}
