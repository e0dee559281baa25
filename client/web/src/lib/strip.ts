// Days of a state, hour by hour: predicted beside observed.

import { addDays, HOUR, midnight, MINUTE } from './civil';
import { queries } from './rpc.svelte';
import { averages, observed, seenOf, type Reported } from './seen';
import { fromTimestamp, toNanos } from './times';

/** Days of a strip. */
export const STRIP_DAYS = 28;
const HOURS = 24;

export interface Strip {
    /** The midnights of the days, the oldest first. */
    days: number[];
    /** Of each hour of each day; `undefined` where nothing was observed. */
    predicted: (number | undefined)[];
    observed: (number | undefined)[];
    low: number;
    high: number;
    note: string;
}

/** The strip that ends with the day of a time. */
export async function loadStrip(map: string, state: string, ms: number, zone: string, reported?: Reported): Promise<Strip> {
    const last = midnight(ms, zone);
    const days = Array.from({ length: STRIP_DAYS }, (_, index) => addDays(last, index + 1 - STRIP_DAYS, zone));
    const times = days.flatMap((day) => Array.from({ length: HOURS }, (_, hour) => day + hour * HOUR + 30 * MINUTE));
    const predicted: (number | undefined)[] = [];
    let knownUntil = 0;
    const predict = async () => {
        for await (const piece of queries.predictStates({ map, states: [state], timesNanos: times.map(toNanos) })) {
            // The first axis of a vector stands for it.
            if (piece.axis <= 1) predicted.push(...piece.probabilities);
            knownUntil = Math.max(knownUntil, fromTimestamp(piece.lastTime) ?? 0);
        }
    };
    const [first, end] = [days[0] ?? last, addDays(last, 1, zone)];
    const [, rows] = await Promise.all([predict(), observed(map, state, first, end, reported)]);
    // It is told up to the last of the times that are asked for.
    const seen = seenOf(rows, reported, first, end, knownUntil >= (times.at(-1) ?? 0) ? end : knownUntil);
    // The hour that comes twice is a part of the last one of its day.
    const starts = days.flatMap((day) => Array.from({ length: HOURS }, (_, hour) => day + hour * HOUR));
    const means = averages(seen, starts, end).map((value) => (Number.isNaN(value) ? undefined : value));
    const values = [...predicted, ...means].filter((value) => value !== undefined);
    const inUnit = values.every((value) => value >= 0 && value <= 1);
    return {
        days, predicted, observed: means, note: seen.note,
        low: inUnit ? 0 : Math.min(...values), high: inUnit ? 1 : Math.max(...values),
    };
}
