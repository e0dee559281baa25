// Rows of the overview: the hours of a day or a week of a state, and when its prediction crosses one half.
//
// Invariant: columns are hours as they pass, so the day of a clock change has 23 or 25.

import { addDays, clock, clockHours, dayName, HOUR, midnight, monday } from './civil';
import { amount, occupancy, unknown } from './colours';

export type RowSpan = 'day' | 'week';

/** The columns of rows: where each begins, and where the last one ends, milliseconds. */
export interface Columns {
    span: RowSpan;
    starts: number[];
    end: number;
}

export function columnsOf(span: RowSpan, at: number, zone: string): Columns {
    const start = span === 'day' ? midnight(at, zone) : monday(at, zone);
    const end = addDays(start, span === 'day' ? 1 : 7, zone);
    return { span, starts: Array.from({ length: Math.round((end - start) / HOUR) }, (_, hour) => start + hour * HOUR), end };
}

/** The places of labels above columns: shares of the width. */
export function ticksOf({ span, starts, end }: Columns, zone: string): { share: number; text: string }[] {
    const start = starts[0] ?? end;
    const share = (ms: number) => (ms - start) / (end - start);
    if (span === 'week') {
        return Array.from({ length: 7 }, (_, day) => addDays(start, day, zone)).map((ms) => ({ share: share(ms), text: dayName(ms, zone) }));
    }
    return clockHours(start, [0, 6, 12, 18], zone).map((ms) => ({ share: share(ms), text: clock(ms, zone) }));
}

/** The range of values that is drawn from none to full. */
export function rangeOf(values: number[], isProbability: boolean): { low: number; high: number } {
    const known = values.filter(Number.isFinite);
    if (isProbability || known.length === 0) return { low: 0, high: 1 };
    const [low, high] = [Math.min(...known), Math.max(...known)];
    return high > low ? { low, high } : { low: low - 0.5, high: low + 0.5 };
}

/** The colour of a value; probabilities have the colours of the map, other values shades of grey. */
export function rowColour(value: number, { low, high }: { low: number; high: number }, isProbability: boolean): string {
    if (Number.isNaN(value)) return unknown();
    if (isProbability) return occupancy(value);
    return amount((value - low) / Math.max(1e-12, high - low));
}

/** Colours side by side, as an image of a style. */
export function bandsOf(colours: string[]): string {
    const part = (index: number) => `${((index / colours.length) * 100).toFixed(3)}%`;
    return `linear-gradient(to right, ${colours.map((colour, index) => `${colour} ${part(index)} ${part(index + 1)}`).join(', ')})`;
}

/** Points of a line through the middles of columns, in a box of 100 by 20. */
export function linePoints(values: number[], { low, high }: { low: number; high: number }): string {
    const y = (value: number) => (19 - 18 * Math.max(0, Math.min(1, (value - low) / (high - low)))).toFixed(1);
    const points = values.map((value, index) => [index, value] as const).filter(([, value]) => Number.isFinite(value));
    return points.map(([index, value]) => `${(((index + 0.5) / values.length) * 100).toFixed(1)},${y(value)}`).join(' ');
}

/** A time at which a prediction crosses one half. */
export interface Change {
    ms: number;
    /** Whether the prediction is above one half from then on. */
    isUp: boolean;
}

/** A greater difference between two predictions is a jump, which lies at the later one. */
const JUMP = 0.5;

/** The crossings of one half: between two times by a straight line, or at the later one if the prediction jumps. */
export function changesOf(times: number[], values: number[]): Change[] {
    const found: Change[] = [];
    for (let index = 1; index < Math.min(times.length, values.length); index++) {
        const [before, now] = [values[index - 1] ?? 0, values[index] ?? 0];
        if (before < 0.5 === now < 0.5) continue;
        const [from, to] = [times[index - 1] ?? 0, times[index] ?? 0];
        const share = Math.abs(now - before) > JUMP ? 1 : (0.5 - before) / (now - before);
        found.push({ ms: from + share * (to - from), isUp: now >= 0.5 });
    }
    return found;
}

/** The parts of a time in which a probability is at least one half. */
export function likelyParts(times: number[], values: number[], end: number): { from: number; to: number }[] {
    const parts: { from: number; to: number }[] = [];
    let from = (values[0] ?? 0) >= 0.5 ? times[0] : undefined;
    for (const { ms, isUp } of changesOf(times, values)) {
        if (isUp) from = ms;
        else if (from !== undefined) {
            parts.push({ from, to: ms });
            from = undefined;
        }
    }
    if (from !== undefined) parts.push({ from, to: end });
    return parts;
}

/** The runs of equal text in hours, in words, for those who do not see their colours. */
function runsText(said: string[], { starts, end }: Columns, name: (ms: number) => string): string {
    const runs: { text: string; from: number }[] = [];
    for (const [hour, text] of said.entries()) if (text !== runs.at(-1)?.text) runs.push({ text, from: starts[hour] ?? end });
    return runs.map(({ text, from }, index) => `${text} ${name(from)} – ${index + 1 < runs.length ? name(runs[index + 1]?.from ?? end) : name(end - 1)}`).join(', ');
}

/** The hours of a row in words: when a probability is likely 1, which label holds, or the range of a number. */
export function hoursText(values: number[], columns: Columns, zone: string, isProbability: boolean, labels?: string[]): string {
    const name = (ms: number) => (columns.span === 'day' ? clock(ms, zone) : `${dayName(ms, zone)} ${clock(ms, zone)}`);
    if (labels) return runsText(values.map((value) => (Number.isNaN(value) ? 'not observed' : `likely ${labels[value] ?? ''}`)), columns, name);
    if (isProbability) return runsText(values.map((value) => (Number.isNaN(value) ? 'not observed' : value >= 0.5 ? 'likely 1' : 'likely 0')), columns, name);
    const known = values.filter(Number.isFinite);
    if (known.length === 0) return 'not observed';
    const [low, high] = [Math.min(...known), Math.max(...known)];
    const round = (value: number) => Number(value.toPrecision(3));
    if (round(low) === round(high)) return `${round(low)} throughout`;
    const at = (value: number) => name(columns.starts[values.indexOf(value)] ?? columns.end);
    return `from ${round(low)} at ${at(low)} to ${round(high)} at ${at(high)}`;
}

/** The number of characters at the end of a name that are kept. */
const TAIL_MOST = 16;
/** A shorter name is not parted. */
const PARTED_LEAST = 18;

/** A name in two parts: the part that may be cut, and the end that is kept, from a separator on if there is one. */
export function nameParts(name: string): { head: string; tail: string } {
    const letters = [...name];
    if (letters.length < PARTED_LEAST) return { head: name, tail: '' };
    const end = letters.slice(-TAIL_MOST);
    const from = end.findIndex((letter, index) => index > 0 && /[._/ -]/.test(end[index - 1] ?? '') && !/[._/ -]/.test(letter));
    const tail = end.slice(Math.max(0, from)).join('');
    return { head: name.slice(0, name.length - tail.length), tail };
}
