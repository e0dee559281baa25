// A week of a state: the prediction, with its interval, and the observations.

import { Code, ConnectError } from '@connectrpc/connect';

import { StateKind } from '../wire/tidemap/v1/types_pb';
import type { DescribeModelResponse } from '../wire/tidemap/v1/query_pb';
import type { ModelKind } from '../wire/tidemap/v1/types_pb';
import { addDays, HOUR, MINUTE } from './civil';
import type { Parts } from './parts';
import { queries } from './rpc.svelte';
import { observed, seenOf, type Reported, type Seen } from './seen';
import { fromTimestamp, toNanos } from './times';

/** Between two predictions of a week. */
export const STEP_MS = 30 * MINUTE;
const LEVEL = 0.9;
/** More observations than this are not drawn one by one. */
const DOTS_MAX = 4000;

export interface Series {
    /** Name of the series: the state, or an axis or a label of it. */
    name: string;
    values: number[];
    lower: number[];
    upper: number[];
    /** The probability that each interval holds; empty without intervals. */
    masses?: number[];
}

/** A model to request, instead of the model that the last update chose. */
export interface Asked {
    kind: ModelKind;
    order?: number;
}

export interface Week {
    /** Times of the predictions, milliseconds. */
    times: number[];
    series: Series[];
    /** The observations; readings are thinned out to the number that can be drawn. */
    seen: Seen;
    /** The time up to which observations are known, at most the end of the week, milliseconds. */
    knownUntil: number;
    observations: number;
    /** The model; only known for a single state. */
    model: DescribeModelResponse | undefined;
    isProbability: boolean;
}

/** A prediction of a state, or of one of its axes, for one time. */
export interface Moment {
    name: string;
    value: number;
    lower: number | undefined;
    upper: number | undefined;
    /** The probability that the interval holds. */
    mass: number | undefined;
}

function axisName(state: string, { axis, label }: { axis: number; label?: string }): string {
    return axis === 0 ? state : `${state}/${label || ('xyz'[axis - 1] ?? axis)}`;
}

/** The predictions of states for a time. */
export async function momentOf(map: string, states: string[], at: number, model: Asked | undefined): Promise<Moment[]> {
    const found: Moment[] = [];
    for await (const piece of queries.predictStates({ map, states, timesNanos: [toNanos(at)], model, intervalLevel: LEVEL })) {
        if (piece.probabilities.length === 0) continue;
        found.push({
            name: axisName(states[piece.stateIndex] ?? '', piece), value: piece.probabilities[0] ?? Number.NaN,
            lower: piece.lower[0], upper: piece.upper[0], mass: piece.masses[0],
        });
    }
    return found;
}

/** Everything that the panel of a state shows. */
export async function loadWeek(map: string, state: string, start: number, zone: string, model: Asked | undefined, reported?: Reported, parts?: Parts): Promise<Week> {
    const end = addDays(start, 7, zone);
    const times: number[] = [];
    for (let ms = start; ms <= end; ms += STEP_MS) times.push(ms);
    const isCell = state.startsWith('cell/');
    const answers: Series[] = [];
    let [observations, knownUntil, hasLabels] = [0, 0, false];
    const predict = async () => {
        const request = { map, states: [state], timesNanos: times.map(toNanos), model, intervalLevel: LEVEL };
        for await (const piece of queries.predictStates(request)) {
            const name = axisName(state, piece);
            const found = answers.find((series) => series.name === name) ?? { name, values: [], lower: [], upper: [], masses: [] };
            if (found.values.length === 0) answers.push(found);
            found.values.push(...piece.probabilities);
            found.lower.push(...piece.lower);
            found.upper.push(...piece.upper);
            found.masses?.push(...piece.masses);
            observations = Number(piece.observations);
            hasLabels ||= Boolean(piece.label);
            knownUntil = Math.max(knownUntil, fromTimestamp(piece.lastTime) ?? 0);
        }
    };
    const describe = async () => {
        try {
            return await queries.describeModel({ map, state });
        } catch (error) {
            // A vector has a model for each axis, and none of its own; so has a categorical state for each label.
            if (ConnectError.from(error).code === Code.InvalidArgument) return undefined;
            throw error;
        }
    };
    const [, rows, described] = await Promise.all([predict(), observed(map, state, start, end, reported, parts), describe()]);
    const isProbability = isCell || hasLabels || described?.kind === StateKind.PROBABILITY;
    const seen = seenOf(rows, reported, start, end, knownUntil);
    const every = seen.pieces ? 1 : Math.ceil(seen.times.length / DOTS_MAX);
    const kept = <T>(list: T[]) => list.filter((_, index) => index % every === 0);
    return {
        times, series: answers, seen: { ...seen, times: kept(seen.times), values: kept(seen.values) }, knownUntil,
        observations, model: described, isProbability,
    };
}

/** A period for people, as `24 h` or `7 d`. */
export function periodText(secs: number): string {
    const hours = (secs * 1000) / HOUR;
    if (hours >= 48) return `${(hours / 24).toFixed(hours % 24 < 0.1 ? 0 : 1)} d`;
    return hours >= 1 ? `${hours.toFixed(Math.abs(hours - Math.round(hours)) < 0.05 ? 0 : 1)} h` : `${(hours * 60).toFixed(0)} min`;
}
