// The rows that are visible: their hours as predicted or as observed, the value at the time of the slider, and the last
// reading.
//
// Invariant: only requested rows are predicted, one request at a time; earlier requests are not waited for. At most
// `KEPT_MAX` rows are kept.

import type { State } from '../wire/tidemap/v1/map_pb';
import { ModelKind } from '../wire/tidemap/v1/types_pb';
import { DAY, HOUR } from './civil';
import { modes, type Parts } from './parts';
import { message, queries } from './rpc.svelte';
import type { Columns } from './rows';
import { averages, hasValueAt, isDoubtful, observed, reportedAs, seenOf, type Reported } from './seen';
import { fromTimestamp, toNanos } from './times';

/** Rows that are kept. */
const KEPT_MAX = 4000;
/** Rows of a request. */
const ASKED_MAX = 200;
/** Scrolling and sliding come to rest before a request is sent. */
const REST_MS = 50;

export interface StripQuestion {
    map: string;
    names: string[];
    columns: Columns;
    at: number;
    /** Changes when predictions do. */
    generation: string;
    reported: AllReported;
    /** The parts of states that have some, by name. */
    partsOf?: ReadonlyMap<string, Parts>;
    /** The times of the newest rows of these states, and up to when the map is known. */
    newestRows?: ReadonlyMap<string, number>;
    newest?: number;
    /** The content of the hours. */
    show: 'predicted' | 'observed' | 'week';
}

/** Requests for observations that run at the same time: each is of one state. */
const READ_AT_ONCE = 6;

/** The reporting of states that are not reported by samples, by name. */
export type AllReported = ReadonlyMap<string, Reported>;

export function allReported(states: Pick<State, 'name' | 'reporting'>[]): AllReported {
    return new Map(states.flatMap(({ name, reporting }) => {
        const reported = reportedAs(reporting);
        return reported ? [[name, reported] as const] : [];
    }));
}

/** The means of the hours that were observed; NaN where nothing was, or is kept. */
async function hoursSeen(map: string, states: string[], { starts, end }: Columns, reported: AllReported, partsOf: ReadonlyMap<string, Parts> | undefined): Promise<number[][]> {
    const found: number[][] = states.map(() => []);
    const first = starts[0] ?? end;
    const { untils } = states.some((name) => reported.has(name)) ? await predict(map, states, [end], { kind: ModelKind.LATEST }) : { untils: [] };
    let next = 0;
    const work = async () => {
        for (let at = next++; at < states.length; at = next++) {
            const name = states[at] ?? '';
            const parts = partsOf?.get(name);
            const rows = await observed(map, name, first, end, reported.get(name), parts && (parts.isLabels ? parts : { ...parts, names: parts.names.slice(0, 1) }));
            found[at] = parts?.isLabels ? modes(rows, starts, end) : averages(seenOf(rows, reported.get(name), first, end, untils[at] ?? 0), starts, end);
        }
    };
    await Promise.all(Array.from({ length: READ_AT_ONCE }, work));
    return found;
}

interface Predicted {
    values: number[][];
    /** Of each state with several numbers: the values of each. */
    parts: number[][][];
    /** The time up to which each state is known, milliseconds. */
    untils: number[];
}

async function predict(map: string, states: string[], times: number[], model?: { kind: ModelKind }): Promise<Predicted> {
    const found: Predicted = { values: states.map(() => []), parts: states.map(() => []), untils: states.map(() => 0) };
    const timesNanos = times.map(toNanos);
    for await (const piece of queries.predictStates({ map, states, timesNanos, model })) {
        // The first axis of a vector represents it.
        if (piece.axis <= 1) found.values[piece.stateIndex]?.push(...piece.probabilities);
        if (piece.axis > 0) ((found.parts[piece.stateIndex] ??= [])[piece.axis - 1] ??= []).push(...piece.probabilities);
        found.untils[piece.stateIndex] = fromTimestamp(piece.lastTime) ?? 0;
    }
    return found;
}

/** A request for hours: the states, and the content. */
export type HoursQuestion = Pick<StripQuestion, 'map' | 'names' | 'columns' | 'show' | 'reported' | 'partsOf'>;

/** The hours of rows, and with `week` the hours of a week before. */
export async function hoursOf({ map, names, columns, show, reported, partsOf }: HoursQuestion): Promise<{ values: number[][]; before: number[][] | undefined; parts?: number[][][] }> {
    if (show === 'observed') return { values: await hoursSeen(map, names, columns, reported, partsOf), before: undefined };
    const middles = columns.starts.map((start) => start + HOUR / 2);
    const { values, parts } = await predict(map, names, middles);
    const before = show === 'week' ? (await predict(map, names, middles.map((ms) => ms - 7 * DAY))).values : undefined;
    return { values, before, parts };
}

export class StripFeed {
    rows: ReadonlyMap<string, number[]> = $state.raw(new Map());
    before: ReadonlyMap<string, number[]> = $state.raw(new Map());
    now: ReadonlyMap<string, number> = $state.raw(new Map());
    /** Of states with several numbers: the hours of each, the values at the time of the slider, and the newest ones. */
    parts: ReadonlyMap<string, { hours?: number[][]; now?: number[]; last?: number[] }> = $state.raw(new Map());
    /** The newest values, and up to when they are known. */
    last: ReadonlyMap<string, { value: number; until: number; hasValue?: boolean | undefined }> = $state.raw(new Map());
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

    #noteParts<Key extends 'hours' | 'now' | 'last'>(key: Key, names: string[], values: { hours: number[][]; now: number[]; last: number[] }[Key][] | undefined): void {
        const parts = new Map(this.parts);
        for (const [index, name] of names.entries()) {
            const value = values?.[index];
            if (value?.length || parts.has(name)) parts.set(name, { ...parts.get(name), [key]: value });
        }
        this.parts = parts;
    }

    async #answer({ map, names, columns, at, generation, reported, partsOf, show, newestRows, newest = 0 }: StripQuestion): Promise<void> {
        const key = JSON.stringify([map, columns.starts[0], columns.span, generation, show]);
        if (key !== this.#key) {
            [this.#key, this.rows, this.before] = [key, new Map(), new Map()];
            this.#noteParts('hours', [...this.parts.keys()], undefined);
        }
        const asked = names.slice(0, ASKED_MAX);
        const nowKey = JSON.stringify([map, generation, at]);
        const known = nowKey === this.#nowKey ? this.now : new Map<string, number>();
        const moments = asked.filter((name) => !known.has(name));
        if (moments.length) {
            const { values, parts } = await predict(map, moments, [at]);
            this.#noteParts('now', moments, parts.map((part) => part.map(([value]) => value ?? Number.NaN)));
            const now = new Map(known);
            for (const [index, name] of moments.entries()) now.set(name, values[index]?.[0] ?? Number.NaN);
            [this.now, this.#nowKey] = [now, nowKey];
        }
        const lastKey = JSON.stringify([map, generation]);
        const read = lastKey === this.#lastKey ? this.last : new Map<string, { value: number; until: number; hasValue?: boolean | undefined }>();
        const unread = asked.filter((name) => !read.has(name));
        if (unread.length) {
            // A value is known at most up to the requested time.
            const { values, parts, untils } = await predict(map, unread, [Math.max(at, Date.now())], { kind: ModelKind.LATEST });
            this.#noteParts('last', unread, parts.map((part) => part.map(([value]) => value ?? Number.NaN)));
            const last = new Map(read);
            for (const [index, name] of unread.entries()) {
                const [until, row] = [untils[index] ?? 0, newestRows?.get(name)];
                const isAsked = row !== undefined && reported.has(name) && isDoubtful({ row, until, newest });
                last.set(name, { value: values[index]?.[0] ?? Number.NaN, until, hasValue: isAsked ? await hasValueAt(map, name, row) : undefined });
            }
            [this.last, this.#lastKey] = [last, lastKey];
        }
        const missing = asked.filter((name) => !this.rows.has(name));
        if (missing.length === 0) return;
        const rows = new Map(this.rows);
        const { values, before, parts } = await hoursOf({ map, names: missing, columns, show, reported, partsOf });
        this.#noteParts('hours', missing, parts);
        for (const [index, name] of missing.entries()) rows.set(name, values[index] ?? []);
        for (const name of rows.keys()) {
            if (rows.size <= KEPT_MAX) break;
            rows.delete(name);
        }
        if (before) this.before = new Map([...this.before, ...missing.map((name, index) => [name, before[index] ?? []] as const)]);
        this.rows = rows;
    }
}
