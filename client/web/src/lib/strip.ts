// Days of a state, hour by hour: predicted beside observed.

import { addDays, HOUR, midnight, MINUTE } from './civil';
import { queries } from './rpc.svelte';
import { toNanos } from './times';
import { observed } from './week';

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
export async function loadStrip(map: string, state: string, ms: number, zone: string): Promise<Strip> {
    const last = midnight(ms, zone);
    const days = Array.from({ length: STRIP_DAYS }, (_, index) => addDays(last, index + 1 - STRIP_DAYS, zone));
    const times = days.flatMap((day) => Array.from({ length: HOURS }, (_, hour) => day + hour * HOUR + 30 * MINUTE));
    const predicted: (number | undefined)[] = [];
    const predict = async () => {
        for await (const piece of queries.predictStates({ map, states: [state], timesNanos: times.map(toNanos) })) {
            // The first axis of a vector stands for it.
            if (piece.axis <= 1) predicted.push(...piece.probabilities);
        }
    };
    const first = days[0] ?? last;
    const [, seen] = await Promise.all([predict(), observed(map, state, first, addDays(last, 1, zone))]);
    const sums = new Float64Array(times.length);
    const counts = new Uint32Array(times.length);
    let day = 0;
    for (const [index, time] of seen.times.entries()) {
        while (day > 0 && time < (days[day] ?? 0)) day--;
        while (day + 1 < days.length && time >= (days[day + 1] ?? Infinity)) day++;
        const hour = Math.min(HOURS - 1, Math.floor((time - (days[day] ?? 0)) / HOUR));
        const at = day * HOURS + hour;
        sums[at] = (sums[at] ?? 0) + (seen.values[index] ?? 0);
        counts[at] = (counts[at] ?? 0) + 1;
    }
    const means = times.map((_, at) => (counts[at] ? (sums[at] ?? 0) / (counts[at] ?? 1) : undefined));
    const values = [...predicted, ...means].filter((value) => value !== undefined);
    const inUnit = values.every((value) => value >= 0 && value <= 1);
    return {
        days, predicted, observed: means, note: seen.note,
        low: inUnit ? 0 : Math.min(...values), high: inUnit ? 1 : Math.max(...values),
    };
}
