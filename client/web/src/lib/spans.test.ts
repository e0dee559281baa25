// The time slider: its spans, its positions, and its jumps over days on which clocks are changed.

import assert from 'node:assert/strict';
import { suite, test } from 'node:test';

import { civil, DAY, HOUR, MINUTE } from './civil';
import { jump, position, positionTime, SPANS, spanTicks, type SpanName } from './spans';

const ZONE = 'Europe/Berlin';
const at = (text: string) => Date.parse(text);
const iso = (ms: number) => new Date(ms).toISOString().replace('.000Z', 'Z');

/** Start and end of the span around a time. */
function ends(span: SpanName, text: string, anchor = text): [string, string] {
    const start = SPANS[span].start(at(text), ZONE, at(anchor));
    return [iso(start), iso(SPANS[span].end(start, ZONE))];
}

suite('spans', () => {
    test('are whole local days and weeks', () => {
        assert.deepEqual(ends('day', '2025-03-30T12:00Z'), ['2025-03-29T23:00:00Z', '2025-03-30T22:00:00Z']);
        assert.deepEqual(ends('week', '2025-03-30T12:00Z'), ['2025-03-23T23:00:00Z', '2025-03-30T22:00:00Z']);
        assert.deepEqual(ends('week', '2025-03-30T22:00Z'), ['2025-03-30T22:00:00Z', '2025-04-06T22:00:00Z']);
    });

    test('of the last seven days end with the day of the anchor, and are whole weeks from there', () => {
        const anchor = '2025-03-12T15:00Z';
        const last: [string, string] = ['2025-03-05T23:00:00Z', '2025-03-12T23:00:00Z'];
        assert.deepEqual(ends('last', '2025-03-12T15:00Z', anchor), last);
        assert.deepEqual(ends('last', '2025-03-05T23:00Z', anchor), last);
        assert.deepEqual(ends('last', '2025-03-05T22:59Z', anchor), ['2025-02-26T23:00:00Z', '2025-03-05T23:00:00Z']);
        assert.deepEqual(ends('last', '2025-03-31T12:00Z', anchor), ['2025-03-26T23:00:00Z', '2025-04-02T22:00:00Z']);
    });

    test('are whole years at the time of the day, also leap years', () => {
        assert.deepEqual(ends('year', '2025-07-01T10:30Z'), ['2025-01-01T11:30:00Z', '2026-01-01T11:30:00Z']);
        assert.deepEqual(ends('year', '2024-07-01T10:30Z'), ['2024-01-01T11:30:00Z', '2025-01-01T11:30:00Z']);
        const start = SPANS.year.start(at('2024-07-01T10:30Z'), ZONE, 0);
        assert.equal(position('year', start, SPANS.year.end(start, ZONE), ZONE), 366 * DAY);
    });

    test('hold every time from their start to their end', () => {
        for (const span of Object.keys(SPANS) as SpanName[]) {
            for (const text of ['2025-01-01T00:30Z', '2025-03-30T01:00Z', '2025-10-26T00:30Z', '2024-02-29T12:00Z', '2024-12-31T12:00Z']) {
                const start = SPANS[span].start(at(text), ZONE, at(text));
                assert.ok(start <= at(text) && at(text) < SPANS[span].end(start, ZONE), `${span} ${text}`);
            }
        }
    });
});

suite('ticks', () => {
    const texts = (span: SpanName, text: string, zone = ZONE) => spanTicks(span, SPANS[span].start(at(text), zone, at(text)), zone);

    test('of a day stand where the clock shows the hour, also after a change of half an hour', () => {
        assert.deepEqual(texts('day', '2025-03-30T12:00Z').map(({ ms, text }) => [iso(ms).slice(11, 16), text]).slice(0, 3), [['23:00', '00:00'], ['01:00', '03:00'], ['04:00', '06:00']]);
        assert.deepEqual(texts('day', '2025-10-26T12:00Z').map(({ ms }) => iso(ms).slice(11, 16)).slice(0, 3), ['22:00', '02:00', '05:00']);
        const island = texts('day', '2025-10-05T03:00Z', 'Australia/Lord_Howe');
        assert.deepEqual(island.map(({ text }) => text), ['00:00', '03:00', '06:00', '09:00', '12:00', '15:00', '18:00', '21:00']);
    });

    test('leave out a midnight that the clock leaves out', () => {
        assert.deepEqual(texts('day', '2025-09-07T12:00Z', 'America/Santiago').slice(0, 2).map(({ text }) => text), ['03:00', '06:00']);
    });

    test('of a year stand at the first days of months', () => {
        const [january, , march] = texts('year', '2025-07-01T10:30Z');
        assert.deepEqual([january?.text, march?.text], ['Jan', 'Mar']);
        assert.equal(position('year', january?.ms ?? 0, march?.ms ?? 0, ZONE), 59 * DAY);
    });
});

suite('positions', () => {
    const week = SPANS.week.start(at('2025-03-30T12:00Z'), ZONE, 0);

    test('of a week and a year are those of the clock, also after a change', () => {
        assert.equal(iso(positionTime('week', week, 6 * DAY + 12 * HOUR, ZONE)), '2025-03-30T10:00:00Z');
        assert.equal(position('week', week, at('2025-03-30T10:00Z'), ZONE), 6 * DAY + 12 * HOUR);
        const autumn = SPANS.week.start(at('2025-10-26T12:00Z'), ZONE, 0);
        assert.equal(iso(positionTime('week', autumn, 6 * DAY + 23 * HOUR, ZONE)), '2025-10-26T22:00:00Z');
        const year = SPANS.year.start(at('2025-07-01T10:30Z'), ZONE, 0);
        assert.equal(iso(positionTime('year', year, 181 * DAY, ZONE)), '2025-07-01T10:30:00Z');
        assert.equal(position('year', year, at('2025-07-01T10:30Z'), ZONE), 181 * DAY);
    });

    test('of a day are the time that has passed, so that no time of it is missed', () => {
        const day = SPANS.day.start(at('2025-10-26T12:00Z'), ZONE, 0);
        assert.equal(SPANS.day.end(day, ZONE) - day, 25 * HOUR);
        for (let elapsed = 0; elapsed < 25 * HOUR; elapsed += SPANS.day.stepMs) {
            const ms = positionTime('day', day, elapsed, ZONE);
            assert.equal(ms, day + elapsed);
            assert.equal(position('day', day, ms, ZONE), elapsed);
        }
    });

    test('never leave the span, and are found again', () => {
        for (const text of ['2025-03-30T12:00Z', '2025-10-26T12:00Z', '2025-06-10T12:00Z']) {
            const start = SPANS.week.start(at(text), ZONE, 0);
            const end = SPANS.week.end(start, ZONE);
            for (let elapsed = 0; elapsed < 7 * DAY; elapsed += SPANS.week.stepMs) {
                const ms = positionTime('week', start, elapsed, ZONE);
                assert.ok(ms >= start && ms < end, iso(ms));
                const isSkipped = civil(ms, ZONE).hour !== Math.floor((elapsed % DAY) / HOUR);
                assert.equal(position('week', start, ms, ZONE), isSkipped ? elapsed + HOUR : elapsed, iso(ms));
            }
        }
    });
});

suite('jumps', () => {
    test('of days and weeks keep the time of the day', () => {
        assert.equal(iso(jump('day', at('2025-03-29T11:00Z'), 1, ZONE)), '2025-03-30T10:00:00Z');
        assert.equal(iso(jump('day', at('2025-03-30T10:00Z'), -1, ZONE)), '2025-03-29T11:00:00Z');
        assert.equal(iso(jump('week', at('2025-10-20T10:00Z'), 1, ZONE)), '2025-10-27T11:00:00Z');
    });

    test('of years keep the date, and go to 1 March where there is no 29 February', () => {
        assert.equal(iso(jump('year', at('2024-07-01T10:00Z'), 1, ZONE)), '2025-07-01T10:00:00Z');
        assert.equal(iso(jump('year', at('2024-02-29T11:00Z'), 1, ZONE)), '2025-03-01T11:00:00Z');
    });
});

test('frames of a span lie on steps of its slider', () => {
    for (const { frameMs, stepMs } of Object.values(SPANS)) assert.equal(frameMs % stepMs, 0);
    assert.equal(SPANS.day.stepMs, 5 * MINUTE);
});
