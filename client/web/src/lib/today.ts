// The description of a day of a state, from the predictions of its week.
//
// Invariant: times lie within the local day; for a probability the text gives the times when it is at least one half,
// or, if it never is, when it is least.

import { addDays, HOUR, midnight } from './civil';
import { likelyParts } from './rows';
import type { Reported } from './seen';
import { STEP_MS, type Week } from './week';

export interface Part {
    from: number;
    to: number;
}

export interface Today {
    isAllDay: boolean;
    /** The times when it is likely 1. */
    parts: Part[];
    /** For a state that is likely 0 all day: the times when this is surest. */
    quiet: Part[];
    peak: { ms: number; value: number };
}

/** A time is quiet if a 1 is at most this share as probable as at the peak. */
const QUIET_SHARE = 0.25;
/** Shorter times are not shown. */
const QUIET_LEAST_MS = HOUR;
const QUIET_MOST = 3;

function dayOf(week: Week, at: number, zone: string): { from: number; to: number; times: number[]; values: number[] } {
    const [from, to] = [midnight(at, zone), addDays(midnight(at, zone), 1, zone)];
    const within = week.times.flatMap((time, index) => (time >= from && time <= to ? [index] : []));
    return { from, to, times: within.map((index) => week.times[index] ?? 0), values: within.map((index) => week.series[0]?.values[index] ?? 0) };
}

/** The day of a time, of a state that is a probability. */
export function todayOf(week: Week, at: number, zone: string): Today | undefined {
    const { from, to, times, values } = dayOf(week, at, zone);
    if (!week.isProbability || times.length === 0) return undefined;
    const parts = likelyParts(times, values, to);
    const peak = values.indexOf(Math.max(...values));
    const limit = (values[peak] ?? 0) * QUIET_SHARE;
    const quiet = likelyParts(times, values.map((value) => Number(value <= limit)), to).filter((part) => part.to - part.from >= QUIET_LEAST_MS);
    const longest = [...quiet].sort((a, b) => b.to - b.from - (a.to - a.from)).slice(0, QUIET_MOST);
    return {
        isAllDay: values.every((value) => value >= 0.5), parts, quiet: parts.length ? [] : quiet.filter((part) => longest.includes(part)),
        peak: { ms: times[peak] ?? from, value: values[peak] ?? 0 },
    };
}

/** The expected number of events on the day of a time. */
export function eventsOf(week: Week, at: number, zone: string, { stepMs }: Reported): number {
    const { to, times, values } = dayOf(week, at, zone);
    return values.reduce((sum, value, index) => sum + ((times[index] ?? to) < to ? value * (STEP_MS / stepMs) : 0), 0);
}
