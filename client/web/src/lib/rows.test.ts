// Rows of the overview: their columns, their colours, and when predictions cross one half.

import assert from 'node:assert/strict';
import { suite, test } from 'node:test';

import { HOUR } from './civil';
import { occupancy, unknown } from './colours';
import { bandsOf, changesOf, columnsOf, hoursText, likelyParts, linePoints, nameParts, rangeOf, rowColour, ticksOf } from './rows';

const ZONE = 'Europe/Berlin';

suite('columns', () => {
    test('are the hours of a local day or week as they pass', () => {
        const lengths = (text: string) => (['day', 'week'] as const).map((span) => columnsOf(span, Date.parse(text), ZONE).starts.length);
        assert.deepEqual(lengths('2025-03-12T12:00Z'), [24, 168]);
        assert.deepEqual(lengths('2025-03-30T12:00Z'), [23, 167]);
        assert.deepEqual(lengths('2025-10-26T12:00Z'), [25, 169]);
    });

    test('have labels at the hours that the clock shows, where these begin', () => {
        assert.deepEqual(ticksOf(columnsOf('day', Date.parse('2025-03-12T12:00Z'), ZONE), ZONE).map(({ share }) => share), [0, 0.25, 0.5, 0.75]);
        const spring = ticksOf(columnsOf('day', Date.parse('2025-03-30T12:00Z'), ZONE), ZONE);
        assert.deepEqual(spring.map(({ share, text }) => [Math.round(share * 23), text]), [[0, '00:00'], [5, '06:00'], [11, '12:00'], [17, '18:00']]);
        assert.equal(ticksOf(columnsOf('week', Date.parse('2025-03-12T12:00Z'), ZONE), ZONE)[2]?.text, 'Wed 12 Mar');
    });
});

suite('colours', () => {
    test('of probabilities are those of the map, and those of other values are grey', () => {
        assert.equal(rowColour(0.3, { low: 0, high: 1 }, true), occupancy(0.3));
        assert.equal(rowColour(20, { low: 20, high: 30 }, false), 'rgb(235 239 247)');
        assert.equal(rowColour(99, { low: 20, high: 30 }, false), 'rgb(65 69 77)');
    });

    test('of hours without observations are those of what is unknown', () => {
        assert.equal(rowColour(Number.NaN, { low: 0, high: 1 }, true), unknown());
        assert.equal(linePoints([0, Number.NaN, 1], { low: 0, high: 1 }).split(' ').length, 2);
    });

    test('lie side by side without gaps', () => {
        assert.equal(bandsOf(['red', 'blue']), 'linear-gradient(to right, red 0.000% 50.000%, blue 50.000% 100.000%)');
    });
});

test('the range of a row is that of probabilities, or that of its values', () => {
    assert.deepEqual(rangeOf([0.4, 0.5], true), { low: 0, high: 1 });
    assert.deepEqual(rangeOf([4, 2, 9], false), { low: 2, high: 9 });
    assert.deepEqual(rangeOf([4, 4], false), { low: 3.5, high: 4.5 });
    assert.equal(linePoints([2, 9], { low: 2, high: 9 }), '25.0,19.0 75.0,1.0');
});

suite('crossings of one half', () => {
    const times = [0, 1, 2, 3].map((hour) => hour * HOUR);

    test('are on the line between two predictions, and at the later one where these jump', () => {
        assert.deepEqual(changesOf(times, [0.375, 0.625, 1, 0.25]), [{ ms: 0.5 * HOUR, isUp: true }, { ms: 3 * HOUR, isUp: false }]);
        assert.deepEqual(changesOf(times, [0.5, 0.6, 0.9, 1]), []);
    });

    test('bound the parts in which a state is likely 1', () => {
        assert.deepEqual(likelyParts(times, [1, 0, 0, 1], 4 * HOUR), [{ from: 0, to: HOUR }, { from: 3 * HOUR, to: 4 * HOUR }]);
        assert.deepEqual(likelyParts(times, [0, 0, 0, 0], 4 * HOUR), []);
        assert.deepEqual(likelyParts([], [], 4 * HOUR), []);
    });
});

test('a long name is parted, so that its end is kept whole', () => {
    const parts = (name: string) => Object.values(nameParts(name));
    assert.deepEqual(parts('kitchen'), ['kitchen', '']);
    assert.deepEqual(parts('binary_sensor.living_room_window'), ['binary_sensor.living_', 'room_window']);
    assert.deepEqual(parts('abcdefghijklmnopqrstuvwxyz'), ['abcdefghij', 'klmnopqrstuvwxyz']);
    for (const name of ['a-name-with-many-words', 'ääääääääääääääää_ö', '📷📷📷📷📷📷📷📷📷📷📷📷📷📷📷📷📷📷📷📷']) assert.equal(parts(name).join(''), name);
});

test('hours are read out as the times when they are likely 1, the labels, or a range', () => {
    const columns = columnsOf('day', Date.parse('2025-03-12T10:00Z'), 'UTC');
    const hours = (value: (hour: number) => number) => columns.starts.map((_, hour) => value(hour));
    const door = hours((hour) => (hour === 0 ? Number.NaN : Number(hour >= 8 && hour < 17)));
    assert.equal(hoursText(door, columns, 'UTC', true), 'not observed 00:00 – 01:00, likely 0 01:00 – 08:00, likely 1 08:00 – 17:00, likely 0 17:00 – 23:59');
    assert.equal(hoursText(hours((hour) => Number(hour >= 7)), columns, 'UTC', false, ['sleep', 'work']), 'likely sleep 00:00 – 07:00, likely work 07:00 – 23:59');
    assert.equal(hoursText(hours((hour) => Math.abs(hour - 12)), columns, 'UTC', false), 'from 0 at 12:00 to 12 at 00:00');
    assert.equal(hoursText(hours(() => 2), columns, 'UTC', false), '2 throughout');
    assert.equal(hoursText(hours(() => Number.NaN), columns, 'UTC', false), 'not observed');
});
