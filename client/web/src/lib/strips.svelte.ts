// The rows that are visible: their hours as predicted or as observed, the value at the time of the slider, and the last
// reading.
//
// Invariant: only rows that were asked for are predicted, one request at a time; what was asked before is not waited
// for. At most `KEPT_MAX` rows are kept.

import { ModelKind } from '../wire/tidemap/v1/types_pb';
import { DAY, HOUR } from './civil';
import { hourMeans, type Columns } from './rows';
import { message, queries } from './rpc.svelte';
import { toNanos } from './times';
import { observed } from './week';

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
    /** What the hours show. */
    show: 'predicted' | 'observed' | 'week';
}

/** Requests for observations that run at the same time: each is of one state. */
const READ_AT_ONCE = 6;

/** The means of the hours that were observed; NaN where nothing was, or is kept. */
async function hoursSeen(map: string, states: string[], { starts, end }: Columns): Promise<number[][]> {
    const found: number[][] = states.map(() => []);
    let next = 0;
    const work = async () => {
        for (let at = next++; at < states.length; at = next++) {
            found[at] = hourMeans(await observed(map, states[at] ?? '', starts[0] ?? end, end), starts);
        }
    };
    await Promise.all(Array.from({ length: READ_AT_ONCE }, work));
    return found;
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

/** The hours of rows, and with `week` those of a week before. */
export async function hoursOf(map: string, names: string[], columns: Columns, show: StripQuestion['show']): Promise<{ values: number[][]; before: number[][] | undefined }> {
    if (show === 'observed') return { values: await hoursSeen(map, names, columns), before: undefined };
    const middles = columns.starts.map((start) => start + HOUR / 2);
    const values = await predict(map, names, middles);
    const before = show === 'week' ? await predict(map, names, middles.map((ms) => ms - 7 * DAY)) : undefined;
    return { values, before };
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

    async #answer({ map, names, columns, at, generation, show }: StripQuestion): Promise<void> {
        const key = JSON.stringify([map, columns.starts[0], columns.span, generation, show]);
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
        const rows = new Map(this.rows);
        const { values, before } = await hoursOf(map, missing, columns, show);
        for (const [index, name] of missing.entries()) rows.set(name, values[index] ?? []);
        for (const name of rows.keys()) {
            if (rows.size <= KEPT_MAX) break;
            rows.delete(name);
        }
        if (before) this.before = new Map([...this.before, ...missing.map((name, index) => [name, before[index] ?? []] as const)]);
        this.rows = rows;
    }
}
