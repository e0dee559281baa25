// Observations that were unusual before they were learned, and the changes that come soon.

import type { Surprise } from '../wire/tidemap/v1/query_pb';
import { clock, DAY, dayName, HOUR, MINUTE } from './civil';
import { changesOf, type Change } from './rows';
import { queries } from './rpc.svelte';
import { fromTimestamp, toNanos, toTimestamp } from './times';

/** The days of "lately". */
export const LATELY_DAYS = 7;
/** The maximum number of requested runs. */
const RUNS_MAX = 10_000;
/** Runs begin with an observation to which the model gave at most a probability of 1 minus this. */
const CONFIDENCE = 0.9;

export interface Unusual {
    state: string;
    from: number;
    to: number;
    observations: number;
    isAbove: boolean;
    value: number;
    probability: number;
    bits: number;
}

function read(run: Surprise): Unusual {
    const from = fromTimestamp(run.firstTime) ?? 0;
    return {
        state: run.state, from, to: fromTimestamp(run.lastTime) ?? from, observations: Number(run.observations),
        isAbove: run.above, value: run.value, probability: run.probability, bits: run.bits,
    };
}

/** Runs of unusual observations in the days before the newest data, the most surprising first. */
export async function unusualLately(map: string, newest: number, days = LATELY_DAYS, states: string[] = [], top = RUNS_MAX): Promise<Unusual[]> {
    return unusualBetween(map, newest - days * DAY, newest + 1, states, top);
}

/** Runs of unusual observations between two times, the most surprising first. */
export async function unusualBetween(map: string, from: number, to: number, states: string[] = [], top = RUNS_MAX): Promise<Unusual[]> {
    const [fromTime, toTime] = [toTimestamp(Math.max(0, from)), toTimestamp(to)];
    const answer = await queries.listSurprises({ map, states, fromTime, toTime, confidence: CONFIDENCE, top });
    return answer.surprises.map(read);
}

/** A number as people write it: without digits that carry no information. */
export function plain(value: number, digits = 3): string {
    if (!Number.isFinite(value)) return '–';
    return Number.isInteger(value) && Math.abs(value) < 1e6 ? String(value) : String(Number(value.toPrecision(digits)));
}

/** A range such as `Tue 24 Nov 01:00 – 05:30`. */
export function rangeText(from: number, to: number, zone: string): string {
    const [first, last] = [`${dayName(from, zone)} ${clock(from, zone)}`, clock(to, zone)];
    if (to - from < MINUTE) return first;
    return dayName(from, zone) === dayName(to, zone) ? `${first} – ${last}` : `${first} – ${dayName(to, zone)} ${last}`;
}

/** The observation and its prediction, in words: `was 1 on Tue 24 Nov 01:00 – 05:30, predicted 0.03`. */
export function runText(run: Unusual, zone: string, isProbability: boolean): string {
    // For other kinds than probabilities, `probability` is the probability of a value at least as far from the
    // prediction.
    const predicted = run.probability > 0.99 ? 'over 0.99' : run.probability < 0.001 ? 'under 0.001' : plain(run.probability, 2);
    const expected = isProbability ? `, predicted ${predicted}` : `, ${run.isAbove ? 'above' : 'below'} the prediction`;
    return `was ${plain(run.value)} on ${rangeText(run.from, run.to, zone)}${expected}`;
}

/** The number of states that "changes soon" covers. */
export const SOON_STATES_MAX = 2000;
/** The lead time of "changes soon", hours. */
export const SOON_HOURS = 24;
const SOON_STEP_MS = 15 * MINUTE;

/** The next change of each state within a day; states without one are left out. */
export async function changesSoon(map: string, states: string[], at: number): Promise<Map<string, Change>> {
    const times = Array.from({ length: (SOON_HOURS * HOUR) / SOON_STEP_MS + 1 }, (_, index) => at + index * SOON_STEP_MS);
    const found = new Map<string, Change>();
    const asked = states.slice(0, SOON_STATES_MAX);
    const values = new Map<number, number[]>();
    for await (const piece of queries.predictStates({ map, states: asked, timesNanos: times.map(toNanos) })) {
        const row = values.get(piece.stateIndex) ?? [];
        row.push(...piece.probabilities);
        values.set(piece.stateIndex, row);
    }
    for (const [index, row] of values) {
        const [next] = changesOf(times, row);
        const name = asked[index];
        if (next && name !== undefined) found.set(name, next);
    }
    return found;
}

/** The strongest run of each state, in the order of the runs, and how many more it has. */
export function strongestOf(runs: Unusual[]): { run: Unusual; more: number }[] {
    const found = new Map<string, { run: Unusual; more: number }>();
    for (const run of runs) {
        const known = found.get(run.state);
        if (known) known.more++;
        else found.set(run.state, { run, more: 0 });
    }
    return [...found.values()];
}

/** An interval and the probability that it holds, without digits that carry no information. */
export function intervalText(lower: number, upper: number, mass: number): string {
    const share = mass > 0.99 ? 'over 99' : (mass * 100).toFixed(0);
    return `${share} % interval ${plain(lower, 2)} – ${plain(upper, 2)}`;
}
