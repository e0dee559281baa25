// Local civil time of a map: where its days begin, and how its times are written.
//
// Invariant: times are milliseconds since 1970 in UTC; the zone is the zone of the map, never the zone of the browser.

export const MINUTE = 60_000;
export const HOUR = 60 * MINUTE;
export const DAY = 24 * HOUR;

/** A civil date and time of day. */
export interface Civil {
    year: number;
    month: number;
    day: number;
    hour: number;
    minute: number;
    second: number;
}

const formats = new Map<string, Intl.DateTimeFormat>();

function format(zone: string, key: string, options: Intl.DateTimeFormatOptions): Intl.DateTimeFormat {
    const name = `${zone} ${key}`;
    let found = formats.get(name);
    if (!found) {
        try {
            found = new Intl.DateTimeFormat('en-GB', { timeZone: zone, ...options });
        } catch {
            // A zone that this browser does not know.
            found = new Intl.DateTimeFormat('en-GB', { timeZone: 'UTC', ...options });
        }
        formats.set(name, found);
    }
    return found;
}

/** The civil time of an instant. */
export function civil(ms: number, zone: string): Civil {
    const parts = format(zone, 'parts', {
        year: 'numeric', month: 'numeric', day: 'numeric', hour: 'numeric', minute: 'numeric', second: 'numeric',
        hourCycle: 'h23',
    }).formatToParts(ms);
    const of = (type: string) => Number(parts.find((part) => part.type === type)?.value ?? 0);
    return { year: of('year'), month: of('month'), day: of('day'), hour: of('hour'), minute: of('minute'), second: of('second') };
}

/** The offset of local time from UTC, milliseconds. */
export function offsetAt(ms: number, zone: string): number {
    const at = civil(ms, zone);
    return Date.UTC(at.year, at.month - 1, at.day, at.hour, at.minute, at.second) - Math.floor(ms / 1000) * 1000;
}

/** The reading of a clock of the zone, as if the zone were UTC, milliseconds. */
export function wallTime(ms: number, zone: string): number {
    return ms + offsetAt(ms, zone);
}

/**
 * The instant at which the clock shows a time. If it shows the time twice, this is the first instant; if it skips the
 * time, this is as much later as the clock was moved.
 */
export function fromWall(wall: number, zone: string): number {
    // An offset changes at most once in two days: one of these two is the offset of the instant.
    const before = offsetAt(wall - DAY, zone);
    const after = offsetAt(wall + DAY, zone);
    if (offsetAt(wall - before, zone) !== before && offsetAt(wall - after, zone) === after) return wall - after;
    return wall - before;
}

/** The instant of a civil time, as `fromWall`; days and months may overflow. */
export function instant(year: number, month: number, day: number, hour: number, minute: number, zone: string): number {
    return fromWall(Date.UTC(year, month - 1, day, hour, minute), zone);
}

/** The midnight that begins the local day of an instant. */
export function midnight(ms: number, zone: string): number {
    const at = civil(ms, zone);
    return instant(at.year, at.month, at.day, 0, 0, zone);
}

/** The midnight that begins the local week, on Monday. */
export function monday(ms: number, zone: string): number {
    const at = civil(ms, zone);
    const weekday = (new Date(Date.UTC(at.year, at.month - 1, at.day)).getUTCDay() + 6) % 7;
    return instant(at.year, at.month, at.day - weekday, 0, 0, zone);
}

/** The instants of a local day at which the clock shows these hours, without those that a clock change leaves out. */
export function clockHours(day: number, hours: number[], zone: string): number[] {
    const at = civil(day, zone);
    const found = hours.map((hour) => ({ hour, ms: instant(at.year, at.month, at.day, hour, 0, zone) }));
    return found.filter(({ hour, ms }) => clock(ms, zone) === `${String(hour).padStart(2, '0')}:00`).map(({ ms }) => ms);
}

/** The instant this many local days later, at the same time of the day. */
export function addDays(ms: number, days: number, zone: string): number {
    return fromWall(wallTime(ms, zone) + days * DAY, zone);
}

/** A time such as `Tue 4 Mar 2025, 10:00`. */
export function longTime(ms: number, zone: string): string {
    const parts = format(zone, 'long', {
        weekday: 'short', day: 'numeric', month: 'short', year: 'numeric', hour: '2-digit', minute: '2-digit', hourCycle: 'h23',
    }).formatToParts(ms);
    const of = (type: string) => parts.find((part) => part.type === type)?.value ?? '';
    return `${of('weekday')} ${of('day')} ${of('month').slice(0, 3)} ${of('year')}, ${of('hour')}:${of('minute')}`;
}

/** A time such as `10:00`. */
export function clock(ms: number, zone: string): string {
    return format(zone, 'clock', { hour: '2-digit', minute: '2-digit', hourCycle: 'h23' }).format(ms);
}

/** A day such as `Tue 4 Mar`. */
export function dayName(ms: number, zone: string): string {
    return format(zone, 'day', { weekday: 'short', day: 'numeric', month: 'short' }).format(ms).replace(',', '').replace('Sept', 'Sep');
}

/** A time such as `2025-03-04T10:00:00+00:00`. */
export function rfc3339(ms: number, zone: string): string {
    const offset = offsetAt(ms, zone);
    const wall = new Date(ms + offset).toISOString().slice(0, 19);
    const minutes = Math.abs(Math.round(offset / MINUTE));
    const two = (value: number) => String(value).padStart(2, '0');
    return `${wall}${offset < 0 ? '-' : '+'}${two(Math.floor(minutes / 60))}:${two(minutes % 60)}`;
}

/** The text of a field for a local date and time, as `2025-03-04 10:00`. */
export function fieldText(ms: number, zone: string): string {
    return new Date(wallTime(ms, zone)).toISOString().slice(0, 16).replace('T', ' ');
}

/** Reads such a field; a date alone keeps the time of the day of `ms`, a time alone its date. NaN if it is neither. */
export function fromField(text: string, ms: number, zone: string): number {
    const [, date, time] = /^\s*(\d{4}-\d{1,2}-\d{1,2})?[T\s]*(\d{1,2}:\d{2})?\s*$/.exec(text) ?? [];
    if (!date && !time) return Number.NaN;
    const at = civil(ms, zone);
    const [year, month, day] = date ? date.split('-').map(Number) : [at.year, at.month, at.day];
    const [hour, minute] = time ? time.split(':').map(Number) : [at.hour, at.minute];
    if ((month ?? 0) > 12 || (day ?? 0) > 31 || (hour ?? 0) > 23 || (minute ?? 0) > 59) return Number.NaN;
    return instant(year ?? 0, month ?? 1, day ?? 1, hour ?? 0, minute ?? 0, zone);
}

/** A length of time for people, as `3 min`. */
export function ago(ms: number): string {
    const steps: [number, string][] = [[DAY, 'd'], [HOUR, 'h'], [MINUTE, 'min'], [1000, 's']];
    for (const [length, unit] of steps) {
        if (Math.abs(ms) >= length) return `${(ms / length).toFixed(Math.abs(ms) < 10 * length && unit !== 's' ? 1 : 0)} ${unit}`;
    }
    return '0 s';
}
