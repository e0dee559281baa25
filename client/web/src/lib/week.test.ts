// The content of the panels of a state: a week, and the strip of four weeks hour by hour.

import assert from 'node:assert/strict';
import { beforeEach, mock, suite, test } from 'node:test';

import { create } from '@bufbuild/protobuf';
import { Code, ConnectError } from '@connectrpc/connect';

import { DescribeModelResponseSchema, PredictStatesResponseSchema, ReconstructResponseSchema } from '../wire/tidemap/v1/query_pb';
import { StateKind } from '../wire/tidemap/v1/types_pb';
import { DAY, HOUR, MINUTE } from './civil';
import { queries } from './rpc.svelte';
import { loadStrip, STRIP_DAYS } from './strip';
import { fromNanos, toNanos } from './times';
import { loadWeek, momentOf, periodText } from './week';

const ZONE = 'Europe/Berlin';
const MONDAY = Date.parse('2025-03-23T23:00Z');

/** Makes the daemon return observations, as pairs of time and value, in pieces of two. */
function observe(pairs: [number, number][]): void {
    mock.method(queries, 'reconstruct', async function* () {
        await Promise.resolve();
        for (let first = 0; first < pairs.length; first += 2) {
            const piece = pairs.slice(first, first + 2);
            yield create(ReconstructResponseSchema, {
                timesNanos: piece.map(([ms]) => toNanos(ms)), values: piece.map(([, value]) => value),
            });
        }
    });
}

/** Makes the daemon predict for each axis, in two pieces; the values are those of `value`. */
function predict(axes: number[], value: (ms: number, axis: number) => number, labels: string[] = []): void {
    mock.method(queries, 'predictStates', async function* (request: Parameters<typeof queries.predictStates>[0]) {
        await Promise.resolve();
        const times = (request.timesNanos ?? []).map(fromNanos);
        for (const axis of axes) {
            for (const part of [times.slice(0, 5), times.slice(5)]) {
                const probabilities = part.map((ms) => value(ms, axis));
                yield create(PredictStatesResponseSchema, {
                    axis, probabilities, observations: 12n, label: labels[axis - 1] ?? '',
                    lower: probabilities.map((middle) => middle - 1), upper: probabilities.map((middle) => middle + 1),
                });
            }
        }
    });
}

function describe(kind: StateKind | Code): void {
    mock.method(queries, 'describeModel', () => {
        if (kind === (Code.InvalidArgument as number)) return Promise.reject(new ConnectError('a vector', Code.InvalidArgument));
        return Promise.resolve(create(DescribeModelResponseSchema, { kind: kind as StateKind }));
    });
}

beforeEach(() => {
    observe([]);
    predict([0], () => 0.5);
    describe(StateKind.PROBABILITY);
});

suite('a week', () => {
    test('has a time each half hour up to its end, also where clocks are changed', async () => {
        const { times } = await loadWeek('home', 'door', MONDAY, ZONE, undefined);
        assert.deepEqual([times[0], times[1], times.at(-1)], [MONDAY, MONDAY + 30 * MINUTE, Date.parse('2025-03-30T22:00Z')]);
        assert.equal(times.length, (7 * 24 - 1) * 2 + 1);
    });

    test('has one series of a state, with its interval, from all pieces', async () => {
        predict([0], (ms) => ms / DAY);
        const week = await loadWeek('home', 'door', MONDAY, ZONE, undefined);
        assert.deepEqual(week.series.map(({ name }) => name), ['door']);
        const [door] = week.series;
        assert.deepEqual(door?.values, week.times.map((ms) => ms / DAY));
        assert.deepEqual([door?.lower.at(-1), door?.upper.length], [(week.times.at(-1) ?? 0) / DAY - 1, week.times.length]);
        assert.deepEqual([week.observations, week.isProbability], [12, true]);
    });

    test('has a series for each axis of a vector, which has no model of its own', async () => {
        predict([1, 2, 4], (_, axis) => axis);
        describe(Code.InvalidArgument as number);
        const week = await loadWeek('home', 'wind', MONDAY, ZONE, undefined);
        assert.deepEqual(week.series.map(({ name, values }) => [name, values[0]]), [['wind/x', 1], ['wind/y', 2], ['wind/4', 4]]);
        assert.deepEqual([week.model, week.isProbability], [undefined, false]);
    });

    test('has a series for each label of a categorical state, and they are probabilities', async () => {
        predict([1, 2], (_, axis) => axis / 3, ['sleep', 'x']);
        describe(Code.InvalidArgument as number);
        const week = await loadWeek('home', 'activity', MONDAY, ZONE, undefined);
        assert.deepEqual(week.series.map(({ name, values }) => [name, values[0]]), [['activity/sleep', 1 / 3], ['activity/x', 2 / 3]]);
        assert.deepEqual([week.model, week.isProbability], [undefined, true]);
    });

    test('of a cell is a probability whatever its model says', async () => {
        describe(StateKind.UNSPECIFIED);
        assert.equal((await loadWeek('home', 'cell/1/2/3', MONDAY, ZONE, undefined)).isProbability, true);
        assert.equal((await loadWeek('home', 'door', MONDAY, ZONE, undefined)).isProbability, false);
    });

    test('thins out observations that are too many to draw', async () => {
        observe(Array.from({ length: 8002 }, (_, index) => [index, index % 2]));
        const { seen: { times, values } } = await loadWeek('home', 'door', MONDAY, ZONE, undefined);
        assert.deepEqual([times.length, values.length, times[1]], [2668, 2668, 3]);
    });
});

suite('a strip', () => {
    const NOON = Date.parse('2025-06-20T10:00Z');

    test('is of whole local days, the last one that of the time', async () => {
        const { days } = await loadStrip('home', 'door', NOON, ZONE);
        assert.equal(days.length, STRIP_DAYS);
        assert.deepEqual([days[0], days.at(-1)], [Date.parse('2025-05-23T22:00Z'), Date.parse('2025-06-19T22:00Z')]);
    });

    test('predicts the middle of each hour, and takes the first axis of a vector', async () => {
        predict([1, 2], (ms, axis) => (axis === 1 ? ms : -1));
        const { days, predicted, low } = await loadStrip('home', 'wind', NOON, ZONE);
        assert.equal(predicted.length, STRIP_DAYS * 24);
        assert.deepEqual([predicted[0], predicted[25]], [(days[0] ?? 0) + 30 * MINUTE, (days[1] ?? 0) + 90 * MINUTE]);
        assert.equal(low, predicted[0]);
    });

    test('has the mean of the observations of each hour, in whatever order they come', async () => {
        const first = Date.parse('2025-05-23T22:00Z');
        const at = (day: number, hours: number) => first + day * DAY + hours * HOUR;
        observe([[at(0, 0), 1], [at(0, 0.99), 0], [at(27, 23.99), 1], [at(1, 0), 0.25], [at(0, 1), 1]]);
        const { observed: means } = await loadStrip('home', 'door', NOON, ZONE);
        const seen = [...means.entries()].filter(([, value]) => value !== undefined);
        assert.deepEqual(seen, [[0, 0.5], [1, 1], [24, 0.25], [27 * 24 + 23, 1]]);
    });

    test('puts the hour that comes twice into the last of its day', async () => {
        const day = Date.parse('2025-10-25T22:00Z');
        observe([[day + 24.5 * HOUR, 1], [day + 25 * HOUR, 0.5], [day + 2.5 * HOUR, 0]]);
        const { observed: means, days } = await loadStrip('home', 'door', day + 40 * HOUR, ZONE);
        const row = days.indexOf(day);
        assert.deepEqual([row, means[row * 24 + 2], means[row * 24 + 23], means[row * 24 + 24]], [STRIP_DAYS - 2, 0, 1, 0.5]);
    });

    test('has the scale of probabilities, or that of its values', async () => {
        const door = await loadStrip('home', 'door', NOON, ZONE);
        assert.deepEqual([door.low, door.high], [0, 1]);
        predict([0], () => 3);
        observe([[NOON, -2]]);
        const count = await loadStrip('home', 'people', NOON, ZONE);
        assert.deepEqual([count.low, count.high], [-2, 3]);
    });
});

test('periods have the unit that people use', () => {
    const hours = [0.5, 1, 4.8, 12, 24, 47, 48, 60, 168];
    assert.deepEqual(hours.map((length) => periodText(length * 3600)), ['30 min', '1 h', '4.8 h', '12 h', '24 h', '47 h', '2 d', '2.5 d', '7 d']);
});

test('a moment has the exact time, each axis of a vector, and its interval', async () => {
    predict([0, 1], (ms, axis) => ms + axis);
    const found = await momentOf('home', ['door'], MONDAY + 7 * MINUTE, undefined);
    assert.deepEqual(found.map(({ name, value }) => [name, value]), [['door', MONDAY + 7 * MINUTE], ['door/x', MONDAY + 7 * MINUTE + 1]]);
    assert.equal(found[0]?.lower, MONDAY + 7 * MINUTE - 1);
});
