// Civil time: zones, and the days on which clocks are changed.

import assert from 'node:assert/strict';
import { suite, test } from 'node:test';

import {
    addDays, ago, civil, clock, DAY, dayName, fieldText, fromField, HOUR, instant, longTime, midnight, MINUTE, monday, offsetAt,
    rfc3339,
} from './civil';

const at = (text: string) => Date.parse(text);
const iso = (ms: number) => new Date(ms).toISOString().replace('.000Z', 'Z');

suite('civil time of an instant', () => {
    test('is that of the zone, in winter and in summer', () => {
        assert.deepEqual(civil(at('2025-01-31T23:30:15Z'), 'Europe/Berlin'), {
            year: 2025, month: 2, day: 1, hour: 0, minute: 30, second: 15,
        });
        assert.equal(offsetAt(at('2025-01-01T00:00:00Z'), 'Europe/Berlin'), HOUR);
        assert.equal(offsetAt(at('2025-07-01T00:00:00Z'), 'Europe/Berlin'), 2 * HOUR);
        assert.equal(offsetAt(at('2025-07-01T00:00:00Z'), 'Asia/Kolkata'), 5 * HOUR + 30 * MINUTE);
        assert.equal(offsetAt(at('2025-07-01T00:00:00.250Z'), 'America/New_York'), -4 * HOUR);
    });

    test('is UTC in a zone that is not known', () => {
        assert.equal(offsetAt(at('2025-07-01T12:00:00Z'), 'Mars/Olympus_Mons'), 0);
    });

    test('has the hour 0 at midnight', () => {
        assert.equal(civil(at('2025-07-01T00:00:00Z'), 'UTC').hour, 0);
        assert.equal(clock(at('2025-07-01T00:00:00Z'), 'UTC'), '00:00');
    });
});

suite('instant of a civil time', () => {
    const cases: [string, string, string][] = [
        ['an ordinary one', 'Europe/Berlin 2025 7 1 12 0', '2025-07-01T10:00:00Z'],
        ['before a gap, east', 'Europe/Berlin 2025 3 30 1 59', '2025-03-30T00:59:00Z'],
        ['in a gap, east', 'Europe/Berlin 2025 3 30 2 30', '2025-03-30T01:30:00Z'],
        ['after a gap, east', 'Europe/Berlin 2025 3 30 3 0', '2025-03-30T01:00:00Z'],
        ['before a gap, west', 'America/New_York 2025 3 9 1 59', '2025-03-09T06:59:00Z'],
        ['in a gap, west', 'America/New_York 2025 3 9 2 30', '2025-03-09T07:30:00Z'],
        ['after a gap, west', 'America/New_York 2025 3 9 3 0', '2025-03-09T07:00:00Z'],
        ['that comes twice, east', 'Europe/Berlin 2025 10 26 2 30', '2025-10-26T00:30:00Z'],
        ['after one that comes twice, east', 'Europe/Berlin 2025 10 26 3 0', '2025-10-26T02:00:00Z'],
        ['that comes twice, west', 'America/New_York 2025 11 2 1 30', '2025-11-02T05:30:00Z'],
        ['after one that comes twice, west', 'America/New_York 2025 11 2 2 0', '2025-11-02T07:00:00Z'],
        ['beyond the end of a month', 'UTC 2025 1 32 0 0', '2025-02-01T00:00:00Z'],
        ['beyond the end of a year', 'UTC 2025 13 1 0 0', '2026-01-01T00:00:00Z'],
    ];
    for (const [name, text, expected] of cases) {
        test(name, () => {
            const [zone = '', ...numbers] = text.split(' ');
            const [year = 0, month = 0, day = 0, hour = 0, minute = 0] = numbers.map(Number);
            assert.equal(iso(instant(year, month, day, hour, minute, zone)), expected);
        });
    }

    test('undoes civil time at every half hour of a year', () => {
        for (const zone of ['Europe/Berlin', 'America/Santiago', 'Australia/Lord_Howe']) {
            for (let ms = at('2025-01-01T00:00:00Z'); ms < at('2026-01-01T00:00:00Z'); ms += 30 * MINUTE) {
                const seen = civil(ms, zone);
                const found = instant(seen.year, seen.month, seen.day, seen.hour, seen.minute, zone);
                if (found === ms) continue;
                // Only the second of two equal times is not found again: the first one is found.
                assert.deepEqual(civil(found, zone), seen, `${zone} ${iso(ms)}`);
                assert.ok(ms - found === HOUR || ms - found === HOUR / 2, `${zone} ${iso(ms)}: ${iso(found)}`);
            }
        }
    });
});

suite('days and weeks', () => {
    test('begin at the midnight of the zone', () => {
        assert.equal(iso(midnight(at('2025-07-01T21:59:59Z'), 'Europe/Berlin')), '2025-06-30T22:00:00Z');
        assert.equal(iso(midnight(at('2025-07-01T22:00:00Z'), 'Europe/Berlin')), '2025-07-01T22:00:00Z');
        assert.equal(iso(monday(at('2025-07-06T21:59:00Z'), 'Europe/Berlin')), '2025-06-29T22:00:00Z');
        assert.equal(iso(monday(at('2025-07-06T22:00:00Z'), 'Europe/Berlin')), '2025-07-06T22:00:00Z');
    });

    test('begin after midnight where the clock skips it', () => {
        // Chile: at 24:00 of 6 September 2025 it becomes 1:00.
        assert.equal(iso(midnight(at('2025-09-07T15:00:00Z'), 'America/Santiago')), '2025-09-07T04:00:00Z');
        assert.equal(iso(midnight(at('2025-04-25T12:00:00Z'), 'Africa/Cairo')), '2025-04-24T22:00:00Z');
    });

    test('begin at the first midnight where there are two', () => {
        // Cuba: at 1:00 it becomes 0:00.
        assert.equal(iso(midnight(at('2025-11-02T15:00:00Z'), 'America/Havana')), '2025-11-02T04:00:00Z');
        assert.equal(iso(midnight(at('2021-10-29T12:00:00Z'), 'Asia/Amman')), '2021-10-28T21:00:00Z');
    });

    test('last 23 or 25 hours where clocks are changed', () => {
        const length = (text: string) => {
            const start = midnight(at(text), 'Europe/Berlin');
            return (addDays(start, 1, 'Europe/Berlin') - start) / HOUR;
        };
        assert.deepEqual(['2025-03-30T12:00Z', '2025-03-31T12:00Z', '2025-10-26T12:00Z'].map(length), [23, 24, 25]);
    });

    test('later are at the same time of the day, to the millisecond', () => {
        assert.equal(iso(addDays(at('2025-03-29T11:00:01Z'), 1, 'Europe/Berlin')), '2025-03-30T10:00:01Z');
        assert.equal(iso(addDays(at('2025-03-30T10:00:00Z'), -1, 'Europe/Berlin')), '2025-03-29T11:00:00Z');
        assert.equal(addDays(at('2025-03-01T10:20:30.456Z'), 0, 'UTC'), at('2025-03-01T10:20:30.456Z'));
        assert.equal(addDays(-1, 1, 'UTC'), DAY - 1);
    });
});

suite('texts of times', () => {
    const noon = at('2025-03-04T10:05:00Z');

    test('are in the zone', () => {
        assert.equal(longTime(noon, 'UTC'), 'Tue 4 Mar 2025, 10:05');
        assert.equal(longTime(noon, 'Asia/Tokyo'), 'Tue 4 Mar 2025, 19:05');
        const autumn = at('2025-09-04T10:05:00Z');
        assert.deepEqual([longTime(autumn, 'UTC'), dayName(autumn, 'UTC')], ['Thu 4 Sep 2025, 10:05', 'Thu 4 Sep']);
        assert.equal(clock(noon, 'America/New_York'), '05:05');
        assert.equal(dayName(at('2025-03-04T20:00:00Z'), 'Asia/Tokyo'), 'Wed 5 Mar');
    });

    test('of RFC 3339 name the same instant, with the offset of the zone', () => {
        assert.equal(rfc3339(noon, 'UTC'), '2025-03-04T10:05:00+00:00');
        assert.equal(rfc3339(noon, 'Asia/Kolkata'), '2025-03-04T15:35:00+05:30');
        assert.equal(rfc3339(noon, 'America/St_Johns'), '2025-03-04T06:35:00-03:30');
        for (const zone of ['Asia/Kolkata', 'America/St_Johns', 'Pacific/Chatham']) assert.equal(at(rfc3339(noon, zone)), noon);
    });

    test('of fields are read as they were written', () => {
        assert.equal(fieldText(noon, 'Asia/Tokyo'), '2025-03-04 19:05');
        for (const zone of ['UTC', 'Asia/Tokyo', 'America/New_York']) assert.equal(fromField(fieldText(noon, zone), 0, zone), noon);
    });

    test('of fields may be a date or a time alone, which keeps the other', () => {
        assert.equal(fromField('2025-03-05', noon, 'UTC'), noon + DAY);
        assert.equal(fromField('11:05', noon, 'UTC'), noon + HOUR);
    });

    test('of fields that are empty or no times are not a number', () => {
        for (const text of ['', 'soon', '2025-13-04', '25:05', '2025-03-04 10:5']) assert.ok(Number.isNaN(fromField(text, noon, 'UTC')), text);
    });

    test('of lengths have one unit, and a digit more where they are short', () => {
        const lengths = [0, 999, 1000, 59_000, 90_000, 9 * MINUTE, 45 * MINUTE, 90 * MINUTE, 36 * HOUR, 20 * DAY, -90_000];
        assert.deepEqual(lengths.map(ago), [
            '0 s', '0 s', '1 s', '59 s', '1.5 min', '9.0 min', '45 min', '1.5 h', '1.5 d', '20 d', '-1.5 min',
        ]);
    });
});
