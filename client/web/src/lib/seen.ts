// The observations of a state: its rows, and the pieces of time that they represent.
//
// Invariant: rows of samples are readings. A row of changes gives the value that holds from then on, and rows of events
// are counted by the step: both are pieces of time with a value, and where no value is known there is no piece.

import { Code, ConnectError } from '@connectrpc/connect';

import { RowKind, type StateReporting } from '../wire/tidemap/v1/types_pb';
import { ago, clock, DAY, dayName, HOUR, longTime, MINUTE } from './civil';
import type { Parts } from './parts';
import { queries } from './rpc.svelte';
import { fromNanos, toTimestamp } from './times';
import { plain } from './unusual';

/** A value that is known up to this short a time ago is known now: the page sends a request every few seconds. */
const NOW_MS = MINUTE;

/** The reporting of a state that is not reported by samples. */
export interface Reported {
    rows: RowKind.CHANGES | RowKind.EVENTS;
    /** The longest time for which a row is valid, milliseconds. */
    holdMs: number;
    /** The time between two readings that are learned, milliseconds. */
    stepMs: number;
}

/** A value from a time on up to but not including another, milliseconds. */
export interface Piece {
    from: number;
    to: number;
    value: number;
    /** The time of the row that starts the piece. */
    since: number;
}

export interface Rows {
    times: number[];
    /** NaN: no value is known from then on. */
    values: number[];
    /** Why there are none, if there are none. */
    note: string;
    /** The daemon keeps no rows, or returns no more of them. */
    isRefused?: boolean;
    /** The number of observations, if each has several numbers. */
    count?: number;
    /** Whether the values are the numbers of labels, which no line has. */
    isLabels?: boolean;
}

export interface Seen extends Rows {
    /** The pieces that the rows represent; `undefined` for samples. */
    pieces: Piece[] | undefined;
}

const known = new Map<string, Reported>();

/** The reporting of a state; `undefined`: by samples. States with equal reporting share one object, so that no effect
 * sees a change. */
export function reportedAs(reporting: StateReporting | undefined): Reported | undefined {
    const rows = reporting?.kind;
    if (rows !== RowKind.CHANGES && rows !== RowKind.EVENTS) return undefined;
    const ms = (duration: { seconds: bigint; nanos: number } | undefined, usual: number) => (duration ? Number(duration.seconds) * 1000 + duration.nanos / 1e6 : usual);
    const found = { rows, holdMs: ms(reporting?.holdMax, 7 * DAY), stepMs: ms(reporting?.step, rows === RowKind.EVENTS ? HOUR : 5 * MINUTE) };
    const key = JSON.stringify(found);
    const kept = known.get(key) ?? found;
    known.set(key, kept);
    return kept;
}

/** A length of time in its largest whole unit, as `7 days`. */
export function lengthText(ms: number): string {
    const units: [number, string][] = [[DAY, 'day'], [HOUR, 'hour'], [MINUTE, 'minute'], [1000, 'second']];
    const [length, unit] = units.find(([length]) => ms >= length && ms % length === 0) ?? [1000, 'second'];
    return new Intl.NumberFormat('en', { style: 'unit', unit, unitDisplay: 'long' }).format(ms / length);
}

/** The reporting of a state, in words. */
export function reportedText(reported: Reported | undefined): string {
    if (!reported) return 'as readings';
    const [hold, every] = [lengthText(reported.holdMs), lengthText(reported.stepMs).replace(/^1 /, '')];
    if (reported.rows === RowKind.CHANGES) return `as changes: a value holds until the next row, for ${hold} at most; it is learned every ${every}`;
    return `as events, which are counted every ${every}; silence counts as 0, for ${hold} at most`;
}

/** The newest row of a state, milliseconds. */
export interface LastReport {
    row: number;
    /** The time up to which its value is known to hold. */
    until: number;
    /** The time up to which the map is known. */
    newest: number;
    /** Whether the row has a value, if this was requested. */
    hasValue?: boolean | undefined;
}

/** Whether the newest row has no value: it holds no longer than itself, although there is newer data. */
const hasNoValue = ({ row, until, newest, hasValue = row >= newest }: LastReport) => until <= row && !hasValue;

/** Whether it is unknown if the newest row has a value: its value ends with the row, and the row is the newest data of
 * all. */
export const isDoubtful = ({ row, until, newest }: LastReport) => until <= row && row >= newest;

/** The value of the newest row of changes or events, and its end. */
export function heldText(reported: Reported, value: string, report: LastReport, zone: string): string {
    const { row, until } = report;
    const isNow = Date.now() - until < NOW_MS;
    const end = isNow ? 'now' : longTime(until, zone);
    if (reported.rows === RowKind.EVENTS) return until > row ? `complete until ${end}` : 'there is no data after it';
    if (hasNoValue(report)) return 'its sensor has no value since';
    if (until - row >= reported.holdMs) return `its value ${value} held until ${end}, and is unknown since`;
    return until > row ? `its value ${value} ${isNow ? 'holds now' : `held until ${end}, the newest data`}` : `its value is ${value}`;
}

/** The newest value in few words: the time since which a change holds, or the time of a reading. */
export function newestText(value: number | undefined, report: LastReport, reported: Reported | undefined, { zone, isNarrow, text }: { zone: string; isNarrow: boolean; text?: string | undefined }): string {
    const isChange = reported?.rows === RowKind.CHANGES;
    const { row } = report;
    const said = isChange && hasNoValue(report) ? 'unknown' : text !== undefined ? text : value === undefined || Number.isNaN(value) ? '' : plain(value);
    const [age, day] = [ago(Date.now() - row), dayName(row, zone).replace(/^\S+ /, '')];
    if (Date.now() - row < DAY) return isChange && said ? `${said} for ${age}` : `${said && `${said}, `}${age} ago`;
    return `${said && `${said}${isChange && !isNarrow ? ' since ' : ', '}`}${day}${isNarrow ? '' : ` ${clock(row, zone)}`}`;
}

/** The value of changes at a time, and its start; `undefined` where nothing was known. */
export function heldAt({ pieces }: Seen, ms: number): Piece | undefined {
    // At the time of a change its new value holds.
    const piece = pieces?.filter(({ from }) => from <= ms).at(-1);
    return piece && ms <= piece.to ? piece : undefined;
}

/** The number of rows, and how they are drawn. */
export function seenText({ times, note, pieces, count, isLabels }: Seen, reported: Reported | undefined): string {
    if (note) return note;
    if (count !== undefined) return `${count.toLocaleString('en')} observation${count === 1 ? '' : 's'}${isLabels ? '' : ' as dots'}`;
    const [what, drawn] = !reported ? ['observation', 'dot'] : reported.rows === RowKind.CHANGES ? ['change', 'step'] : ['event', 'step'];
    const many = (count: number) => (count === 1 ? '' : 's');
    if (!pieces) return `${times.length.toLocaleString('en')} ${what}${many(times.length)} as ${times.length === 1 ? 'a ' : ''}${drawn}${many(times.length)}`;
    return `${times.length.toLocaleString('en')} ${what}${many(times.length)}, drawn as steps`;
}

async function read(map: string, state: string, from: number, to: number): Promise<Rows> {
    const [times, values]: [number[], number[]] = [[], []];
    try {
        const request = { map, state, fromTime: toTimestamp(Math.max(0, from)), toTime: toTimestamp(to) };
        for await (const piece of queries.reconstruct(request)) {
            for (const [index, nanos] of piece.timesNanos.entries()) {
                times.push(fromNanos(nanos));
                values.push(piece.values[index] ?? 0);
            }
        }
    } catch (error) {
        const found = ConnectError.from(error);
        if ([Code.FailedPrecondition, Code.OutOfRange, Code.InvalidArgument, Code.ResourceExhausted].includes(found.code)) {
            return { times: [], values: [], note: found.rawMessage, isRefused: true };
        }
        throw error;
    }
    return { times, values, note: times.length ? '' : 'No observations in this week.' };
}

/** Whether the row of a time has a value; `undefined` where rows are not kept. */
export async function hasValueAt(map: string, state: string, row: number): Promise<boolean | undefined> {
    const { values } = await read(map, state, Math.floor(row), Math.floor(row) + 1);
    const value = values.at(-1);
    return value === undefined ? undefined : !Number.isNaN(value);
}

/** The rows of the parts of a state: the number of the label of each time, or all coordinates. */
async function observedParts(map: string, state: string, from: number, to: number, { names, isLabels }: Parts): Promise<Rows> {
    const all = await Promise.all(names.map((name) => read(map, `${state}/${name}`, from, to)));
    const [first] = all;
    const { note = '', isRefused = false } = first ?? {};
    if (!isLabels) return { times: all.flatMap(({ times }) => times), values: all.flatMap(({ values }) => values), note, isRefused, count: first?.times.length ?? 0 };
    const best = new Map<number, { label: number; share: number }>();
    for (const [label, { times, values }] of all.entries()) {
        for (const [index, ms] of times.entries()) {
            const share = values[index] ?? 0;
            if (share > (best.get(ms)?.share ?? 0)) best.set(ms, { label, share });
        }
    }
    const times = [...best.keys()].sort((a, b) => a - b);
    return { times, values: times.map((ms) => best.get(ms)?.label ?? 0), note, isRefused, count: times.length, isLabels };
}

/** The rows between two times, with earlier rows that are still valid; an explanation if rows are not kept. */
export async function observed(map: string, state: string, from: number, to: number, reported?: Reported, parts?: Parts): Promise<Rows> {
    if (parts) return observedParts(map, state, from, to, parts);
    const rows = await read(map, state, from, to);
    if (!reported || rows.isRefused) return rows;
    // Most states have a report in a day; few need a request for the whole time that their rows may cover.
    let end = from;
    for (const back of [DAY, 7 * DAY, Infinity]) {
        const start = Math.max(0, from - Math.min(back, reported.holdMs));
        if (start >= end) break;
        const before = await read(map, state, start, end);
        if (before.times.length) return { times: [...before.times, ...rows.times], values: [...before.values, ...rows.values], note: '' };
        end = start;
    }
    return rows;
}

/** The times between which the value of each row of changes holds. `until`: nothing is known from then on. */
function held(rows: Rows, { holdMs }: Reported, until: number): Piece[] {
    const pieces: Piece[] = [];
    for (const [index, from] of rows.times.entries()) {
        const [value, before] = [rows.values[index] ?? Number.NaN, pieces.at(-1)];
        const to = Math.min(rows.times[index + 1] ?? Math.max(from, until), from + holdMs);
        // A row that repeats the known value is no change.
        if (before?.to === from && before.value === value) before.to = to;
        else pieces.push({ from, to, value, since: from });
    }
    return pieces;
}

/** The number of events of each step, with pieces of 0 between them. */
function counted(rows: Rows, { holdMs, stepMs }: Reported, until: number): Piece[] {
    const floor = (ms: number) => Math.floor(ms / stepMs) * stepMs;
    const steps = new Map<number, { count: number; last: number; isKnown: boolean }>();
    for (const [index, ms] of rows.times.entries()) {
        const value = rows.values[index] ?? Number.NaN;
        const before = steps.get(floor(ms))?.count ?? Number.NaN;
        const count = Number.isNaN(before) ? value : before + (Number.isNaN(value) ? 0 : value);
        steps.set(floor(ms), { count, last: ms, isKnown: !Number.isNaN(value) });
    }
    const starts = [...steps.keys()];
    return [...steps].flatMap(([from, { count, last, isKnown }], index) => {
        const end = Math.min(starts[index + 1] ?? floor(until), floor(last + holdMs) + stepMs);
        return [{ from, to: from + stepMs, value: count, since: from }, { from: from + stepMs, to: isKnown ? end : from, value: 0, since: last }];
    });
}

/** The pieces that rows represent between two times. `until`: the time up to which the rows are known to be
 * complete. */
export function seenOf(rows: Rows, reported: Reported | undefined, from: number, to: number, until: number): Seen {
    if (!reported) return { ...rows, pieces: undefined };
    const pieces = (reported.rows === RowKind.CHANGES ? held : counted)(rows, reported, until)
        .map((piece) => ({ ...piece, from: Math.max(from, piece.from), to: Math.min(to, piece.to) }))
        .filter((piece) => piece.to > piece.from && !Number.isNaN(piece.value));
    const within = rows.times.flatMap((ms, index) => (ms >= from && ms < to ? [index] : []));
    const note = rows.note || within.length || pieces.length ? rows.note : 'No observations in this week.';
    return { times: within.map((index) => rows.times[index] ?? 0), values: within.map((index) => rows.values[index] ?? 0), note, pieces };
}

/** The mean of the observations from each start up to the next, or to the end; NaN where there are none. */
export function averages(seen: Pick<Seen, 'times' | 'values'> & Partial<Seen>, starts: number[], end: number): number[] {
    const [sums, weights] = [new Float64Array(starts.length), new Float64Array(starts.length)];
    const startAt = (index: number) => starts[index] ?? (index < starts.length ? 0 : end);
    let at = 0;
    const find = (ms: number) => {
        while (at > 0 && ms < startAt(at)) at--;
        while (at + 1 < starts.length && ms >= startAt(at + 1)) at++;
        return at;
    };
    const add = (index: number, value: number, weight: number) => {
        sums[index] = (sums[index] ?? 0) + value * weight;
        weights[index] = (weights[index] ?? 0) + weight;
    };
    for (const { from, to, value } of seen.pieces ?? []) {
        for (let index = find(from); index < starts.length && startAt(index) < to; index++) {
            const weight = Math.min(to, startAt(index + 1)) - Math.max(from, startAt(index));
            if (weight > 0) add(index, value, weight);
        }
    }
    for (const [index, ms] of (seen.pieces ? [] : seen.times).entries()) {
        if (ms >= startAt(0) && ms < end) add(find(ms), seen.values[index] ?? 0, 1);
    }
    return starts.map((_, index) => (sums[index] ?? 0) / (weights[index] || Number.NaN));
}

/** The mean squared difference between observations and predictions for times of equal distance. */
export function errorOf(seen: Pick<Seen, 'times' | 'values'> & Partial<Seen>, times: number[], predicted: number[]): number | undefined {
    const [first = 0, second = 1] = times;
    const step = second - first;
    const nearest = (ms: number) => Math.round((ms - first) / step);
    let [sum, weights] = [0, 0];
    const add = (index: number, value: number, weight: number) => {
        sum += (value - (predicted[index] ?? 0)) ** 2 * weight;
        weights += weight;
    };
    for (const { from, to, value } of seen.pieces ?? []) {
        for (let index = nearest(from); index <= nearest(to); index++) {
            const middle = first + index * step;
            add(index, value, Math.max(0, Math.min(to, middle + step / 2) - Math.max(from, middle - step / 2)));
        }
    }
    for (const [index, ms] of (seen.pieces ? [] : seen.times).entries()) add(nearest(ms), seen.values[index] ?? 0, 1);
    return weights ? sum / weights : undefined;
}
