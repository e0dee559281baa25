// The description of a day of a state, in parts.

import assert from 'node:assert/strict';
import { suite, test } from 'node:test';

import { RowKind } from '../wire/tidemap/v1/types_pb';
import { DAY, HOUR } from './civil';
import { eventsOf, todayOf } from './today';
import { STEP_MS, type Week } from './week';

const ZONE = 'Europe/Berlin';
/** A Monday there. */
const MONDAY = Date.parse('2025-03-09T23:00Z');
const NOON = MONDAY + 2 * DAY + 12 * HOUR;

/** A week whose values depend on the hour of the day alone. */
function week(value: (hour: number) => number, isProbability = true): Week {
    const times = Array.from({ length: (7 * DAY) / STEP_MS + 1 }, (_, index) => MONDAY + index * STEP_MS);
    const values = times.map((ms) => value(((ms - MONDAY) % DAY) / HOUR));
    return {
        times, series: [{ name: 'door', values, lower: [], upper: [] }], seen: { times: [], values: [], note: '', pieces: undefined },
        knownUntil: 0, observations: 0, model: undefined, isProbability,
    };
}
/** Parts as hours of the day. */
const hours = (parts: { from: number; to: number }[] = []) => parts.map(({ from, to }) => [from, to].map((ms) => (ms - MONDAY - 2 * DAY) / HOUR));

suite('a day', () => {
    test('has the parts in which a 1 is likely', () => {
        const today = todayOf(week((hour) => Number(hour >= 9 && hour < 17)), NOON, ZONE);
        assert.deepEqual([hours(today?.parts), today?.isAllDay, today?.quiet], [[[9, 17]], false, []]);
        assert.equal(todayOf(week(() => 0.9), NOON, ZONE)?.isAllDay, true);
    });

    test('on which a 1 is never likely has those in which it is least so, and the peak', () => {
        const today = todayOf(week((hour) => (hour >= 6 && hour < 22 ? 0.2 + (hour === 18 ? 0.1 : 0) : 0.01)), NOON, ZONE);
        assert.deepEqual([hours(today?.parts), hours(today?.quiet)], [[], [[0, 6], [22, 24]]]);
        assert.deepEqual([(today?.peak.ms ?? 0) - MONDAY - 2 * DAY, today?.peak.value], [18 * HOUR, 0.30000000000000004]);
    });

    test('of no probability has no such parts', () => {
        assert.equal(todayOf(week(() => 3, false), NOON, ZONE), undefined);
    });

    test('has as many events as are expected in all its steps', () => {
        const hourly = { rows: RowKind.EVENTS, holdMs: 7 * DAY, stepMs: HOUR } as const;
        assert.equal(eventsOf(week((hour) => (Math.floor(hour) === 8 ? 5 : 0.25), false), NOON, ZONE, hourly), 5 + 23 * 0.25);
        assert.equal(eventsOf(week(() => 1, false), NOON, ZONE, { ...hourly, stepMs: STEP_MS }), 48);
    });
});
