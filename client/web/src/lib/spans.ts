// The spans of the time slider: a day, a week, the last seven days and a year, each from a local midnight on.

import { addDays, civil, clock, clockHours, DAY, dayName, fromWall, HOUR, instant, midnight, MINUTE, monday, wallTime } from './civil';

export type SpanName = 'day' | 'week' | 'last' | 'year';

interface Span {
    /** Between two positions of the slider. */
    stepMs: number;
    /** Between two frames that are fetched while it plays. */
    frameMs: number;
    /** The time that a second of playing shows. */
    pace: number;
    /** `anchor`: the time that spans without a beginning of their own end with the day of. */
    start: (ms: number, zone: string, anchor: number) => number;
    end: (start: number, zone: string) => number;
}

export const SPANS: Record<SpanName, Span> = {
    day: {
        stepMs: 5 * MINUTE, frameMs: 15 * MINUTE, pace: 2 * HOUR,
        start: midnight,
        end: (start, zone) => addDays(start, 1, zone),
    },
    week: {
        stepMs: 30 * MINUTE, frameMs: HOUR, pace: 8 * HOUR,
        start: monday,
        end: (start, zone) => addDays(start, 7, zone),
    },
    last: {
        stepMs: 30 * MINUTE, frameMs: HOUR, pace: 8 * HOUR,
        // Seven days that end with the day of the anchor, or whole weeks before or after it, so that they contain the
        // time.
        start: (ms, zone, anchor) => {
            const first = addDays(midnight(anchor, zone), -6, zone);
            const weeks = Math.floor((wallTime(ms, zone) - wallTime(first, zone)) / (7 * DAY));
            return addDays(first, 7 * weeks, zone);
        },
        end: (start, zone) => addDays(start, 7, zone),
    },
    year: {
        stepMs: DAY, frameMs: DAY, pace: 7 * DAY,
        start: (ms, zone) => {
            const at = civil(ms, zone);
            // At the same time of the day throughout the year.
            return instant(at.year, 1, 1, at.hour, at.minute, zone);
        },
        end: (start, zone) => jump('year', start, 1, zone),
    },
};

/** The span of a name in the address. */
export function spanOf(name: string | undefined): SpanName {
    return name !== undefined && name in SPANS ? (name as SpanName) : 'day';
}

/**
 * The time of a position of the slider, in milliseconds after its start: for a day in elapsed time, for a week and a
 * year in clock time.
 */
export function positionTime(span: SpanName, start: number, elapsed: number, zone: string): number {
    return span === 'day' ? start + elapsed : fromWall(wallTime(start, zone) + elapsed, zone);
}

/** The position of a time: the inverse of `positionTime`. */
export function position(span: SpanName, start: number, ms: number, zone: string): number {
    return span === 'day' ? ms - start : wallTime(ms, zone) - wallTime(start, zone);
}

const DAY_TICKS = [0, 3, 6, 9, 12, 15, 18, 21];
const MONTHS = ['Jan', 'Feb', 'Mar', 'Apr', 'May', 'Jun', 'Jul', 'Aug', 'Sep', 'Oct', 'Nov', 'Dec'];

/** The labels below the slider, and their places: hours of the clock, days, or the first days of months. */
export function spanTicks(span: SpanName, start: number, zone: string): { ms: number; text: string }[] {
    if (span === 'day') return clockHours(start, DAY_TICKS, zone).map((ms) => ({ ms, text: clock(ms, zone) }));
    if (span !== 'year') return [0, 1, 2, 3, 4, 5, 6].map((day) => addDays(start, day, zone)).map((ms) => ({ ms, text: dayName(ms, zone) }));
    const { year, hour, minute } = civil(start, zone);
    return MONTHS.map((text, month) => ({ ms: instant(year, month + 1, 1, hour, minute, zone), text }));
}

/** Moves a time by whole days, weeks or years. */
export function jump(span: SpanName, ms: number, count: number, zone: string): number {
    if (span !== 'year') return addDays(ms, span === 'day' ? count : 7 * count, zone);
    const at = civil(ms, zone);
    return instant(at.year + count, at.month, at.day, at.hour, at.minute, zone);
}
