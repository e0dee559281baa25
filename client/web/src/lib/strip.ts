// Days of a state, hour by hour: predicted beside observed.
//
// Invariant: a column is an hour of the clock. The hour that a clock change leaves out has no value, and an hour that
// comes twice is one column.

import { addDays, DAY, fromWall, HOUR, midnight, MINUTE, wallTime } from './civil';
import { labelRuns, modes, type Parts } from './parts';
import { queries } from './rpc.svelte';
import { averages, observed, seenOf, type Reported } from './seen';
import { fromTimestamp, toNanos } from './times';

/** Days of a strip. */
export const STRIP_DAYS = 28;
const HOURS = 24;

export interface Strip {
    /** The midnights of the days, the oldest first. */
    days: number[];
    /** The begins of the hours of the days. */
    starts: number[];
    /** The values of each hour of each day; `undefined` where the clock leaves it out, or nothing was observed. */
    predicted: (number | undefined)[];
    observed: (number | undefined)[];
    low: number;
    high: number;
    note: string;
    /** If the values are numbers of labels: the labels. */
    labels: string[] | undefined;
}

/** The begin of each hour of the clock on a day, by its midnight; an hour that the clock leaves out begins at the same
 * time as the next. */
export function hoursOfDay(day: number, zone: string): number[] {
    // Where a clock change leaves out midnight, the day begins later.
    const first = Math.floor(wallTime(day, zone) / DAY) * DAY;
    return Array.from({ length: HOURS }, (_, hour) => fromWall(first + hour * HOUR, zone));
}

/** The strip that ends with the day of a time. */
export async function loadStrip(map: string, state: string, ms: number, zone: string, reported?: Reported, parts?: Parts): Promise<Strip> {
    const last = midnight(ms, zone);
    const days = Array.from({ length: STRIP_DAYS }, (_, index) => addDays(last, index + 1 - STRIP_DAYS, zone));
    const [first, end] = [days[0] ?? last, addDays(last, 1, zone)];
    const starts = days.flatMap((day) => hoursOfDay(day, zone));
    const isLeftOut = (index: number) => starts[index] === (starts[index + 1] ?? end);
    const times = starts.map((start) => start + 30 * MINUTE);
    const answers: number[] = [];
    const shares: number[][] = [];
    const labels = parts?.isLabels ? parts.names : undefined;
    let knownUntil = 0;
    const predict = async () => {
        for await (const piece of queries.predictStates({ map, states: [state], timesNanos: times.map(toNanos) })) {
            // The first axis of a vector represents it.
            if (piece.axis <= 1) answers.push(...piece.probabilities);
            if (labels) (shares[piece.axis - 1] ??= []).push(...piece.probabilities);
            knownUntil = Math.max(knownUntil, fromTimestamp(piece.lastTime) ?? 0);
        }
    };
    const [, rows] = await Promise.all([predict(), observed(map, state, first, end, reported, parts)]);
    // The reports are known up to the last requested time.
    const seen = seenOf(rows, reported, first, end, knownUntil >= (times.at(-1) ?? 0) ? end : knownUntil);
    const likeliest = labels ? starts.flatMap((_, hour) => labelRuns([0], shares.map((share) => [share[hour] ?? Number.NaN])).map(({ index }) => index)) : answers;
    const predicted = likeliest.map((value, index) => (isLeftOut(index) ? undefined : value));
    const means = (labels ? modes(seen, starts, end) : averages(seen, starts, end)).map((value) => (Number.isNaN(value) ? undefined : value));
    const values = [...predicted, ...means].filter((value) => value !== undefined);
    const inUnit = values.every((value) => value >= 0 && value <= 1);
    return {
        days, starts, predicted, observed: means, note: seen.note, labels,
        low: inUnit ? 0 : Math.min(...values), high: inUnit ? 1 : Math.max(...values),
    };
}
