// Observations: what rows of readings, changes and events represent.

import assert from 'node:assert/strict';
import { beforeEach, mock, suite, test } from 'node:test';

import { create } from '@bufbuild/protobuf';
import { Code, ConnectError } from '@connectrpc/connect';

import { ReconstructResponseSchema } from '../wire/tidemap/v1/query_pb';
import { RowKind, StateReportingSchema } from '../wire/tidemap/v1/types_pb';
import { DAY, HOUR, MINUTE } from './civil';
import { queries } from './rpc.svelte';
import { averages, hasValueAt, errorOf, heldAt, heldText, isDoubtful, newestText, observed, reportedAs, reportedText, seenOf, seenText, type Reported } from './seen';
import { fromTimestamp, toNanos } from './times';

const CHANGES: Reported = { rows: RowKind.CHANGES, holdMs: 2 * HOUR, stepMs: 5 * MINUTE };
const EVENTS: Reported = { rows: RowKind.EVENTS, holdMs: 4 * HOUR, stepMs: HOUR };
const UNKNOWN = Number.NaN;

let asked: [number, number][];

/** Makes the daemon return observations, as pairs of time and value, in pieces of two. */
function observe(pairs: [number, number][]): void {
    asked = [];
    mock.method(queries, 'reconstruct', async function* (request: Parameters<typeof queries.reconstruct>[0]) {
        await Promise.resolve();
        const [from, to] = [fromTimestamp(request.fromTime as never) ?? 0, fromTimestamp(request.toTime as never) ?? 0];
        asked.push([from, to]);
        const within = pairs.filter(([ms]) => ms >= from && ms < to);
        for (let first = 0; first < within.length; first += 2) {
            const piece = within.slice(first, first + 2);
            yield create(ReconstructResponseSchema, { timesNanos: piece.map(([ms]) => toNanos(ms)), values: piece.map(([, value]) => value) });
        }
    });
}

/** Makes the daemon refuse to return observations. */
function refuse(code: Code): void {
    mock.method(queries, 'reconstruct', () => {
        throw new ConnectError('not kept', code);
    });
}

/** The pieces of rows, as triples of hours and a value. */
function pieces(rows: [number, number][], reported: Reported, from: number, to: number, until: number): number[][] {
    const given = { times: rows.map(([hour]) => hour * HOUR), values: rows.map(([, value]) => value), note: '' };
    const seen = seenOf(given, reported, from * HOUR, to * HOUR, until * HOUR);
    return (seen.pieces ?? []).map((piece) => [piece.from / HOUR, piece.to / HOUR, piece.value]);
}

beforeEach(() => observe([]));

suite('observations', () => {
    test('come in the order of all pieces', async () => {
        observe([[1000, 1], [2000, 0], [3000, 1]]);
        assert.deepEqual(await observed('home', 'door', 0, 4000), { times: [1000, 2000, 3000], values: [1, 0, 1], note: '' });
    });

    test('that are not kept are explained, and other errors go on', async () => {
        assert.match((await observed('home', 'door', 0, 1)).note, /No observations/);
        for (const code of [Code.FailedPrecondition, Code.OutOfRange, Code.InvalidArgument, Code.ResourceExhausted]) {
            refuse(code);
            assert.deepEqual(await observed('home', 'door', 0, 1), { times: [], values: [], note: 'not kept', isRefused: true });
        }
        refuse(Code.Unavailable);
        await assert.rejects(observed('home', 'door', 0, 1), /not kept/);
    });

    test('that hold reach back to the row that still says something, and no further', async () => {
        const reported = { ...CHANGES, holdMs: 30 * DAY };
        const start = 100 * DAY;
        observe([[start - 9 * DAY, 1], [start - 8 * DAY, 0], [start + HOUR, 1]]);
        const { times } = await observed('home', 'door', start, start + DAY, reported);
        assert.deepEqual(times, [start - 9 * DAY, start - 8 * DAY, start + HOUR]);
        assert.deepEqual(asked.map(([from]) => (from - start) / DAY), [0, -1, -7, -30]);
        observe([]);
        await observed('home', 'door', start, start + DAY, CHANGES);
        assert.deepEqual(asked, [[start, start + DAY], [start - 2 * HOUR, start]]);
        observe([]);
        await observed('home', 'door', start, start + DAY);
        assert.equal(asked.length, 1);
    });
});

suite('changes', () => {
    test('hold until the next row, and no longer than they may', () => {
        assert.deepEqual(pieces([[1, 1], [2, 0], [6, 1]], CHANGES, 0, 24, 7), [[1, 2, 1], [2, 4, 0], [6, 7, 1]]);
    });

    test('that say the same again are one piece, since the first of them', () => {
        assert.deepEqual(pieces([[1, 1], [2, 1], [5, 1]], CHANGES, 0, 24, 6), [[1, 4, 1], [5, 6, 1]]);
        const seen = seenOf({ times: [0, HOUR], values: [1, 1], note: '' }, CHANGES, HOUR / 2, DAY, 2 * HOUR);
        assert.equal(heldAt(seen, 1.5 * HOUR)?.since, 0);
        assert.equal(heldAt(seen, 2.5 * HOUR), undefined);
        const changed = seenOf({ times: [0, HOUR], values: [1, 0], note: '' }, CHANGES, 0, DAY, 2 * HOUR);
        assert.equal(heldAt(changed, HOUR)?.value, 0, 'at the time of a change its new value holds');
    });

    test('without a value say that nothing is known', () => {
        assert.deepEqual(pieces([[1, 1], [2, UNKNOWN], [3, 0]], CHANGES, 0, 24, 4), [[1, 2, 1], [3, 4, 0]]);
    });

    test('from before the time that is shown still hold in it', () => {
        assert.deepEqual(pieces([[9, 1], [11, 0]], CHANGES, 10, 12, 20), [[10, 11, 1], [11, 12, 0]]);
    });

    test('have the share of the hour as its mean, not the mean of the rows', () => {
        const rows = { times: [0, 45 * MINUTE, 50 * MINUTE, 2 * HOUR], values: [1, 0, 1, UNKNOWN], note: '' };
        const seen = seenOf(rows, CHANGES, 0, 4 * HOUR, 4 * HOUR);
        assert.deepEqual(averages(seen, [0, HOUR, 2 * HOUR, 3 * HOUR], 4 * HOUR), [55 / 60, 1, UNKNOWN, UNKNOWN]);
    });
});

suite('events', () => {
    test('are counted by the step, and silence is 0 as long as it says something', () => {
        assert.deepEqual(pieces([[1.2, 1], [1.9, 2], [3.5, 1]], EVENTS, 0, 24, 12.5), [[1, 2, 3], [2, 3, 0], [3, 4, 1], [4, 8, 0]]);
    });

    test('are not counted where the sensor knows nothing', () => {
        assert.deepEqual(pieces([[1.2, 1], [2.5, UNKNOWN], [5.5, 4]], EVENTS, 0, 24, 6), [[1, 2, 1], [5, 6, 4]]);
    });

    test('have as the mean of an hour their number in a step', () => {
        const quarter = { ...EVENTS, stepMs: 15 * MINUTE };
        const seen = seenOf({ times: [MINUTE, 20 * MINUTE, 21 * MINUTE], values: [1, 1, 2], note: '' }, quarter, 0, DAY, HOUR);
        assert.deepEqual(averages(seen, [0, HOUR], 2 * HOUR), [1, UNKNOWN]);
    });
});

suite('in words', () => {
    test('a state says how it is reported', () => {
        assert.equal(reportedText(undefined), 'as readings');
        assert.match(reportedText({ ...CHANGES, holdMs: 7 * DAY }), /for 7 days at most; it is learned every 5 minutes$/);
        assert.match(reportedText({ ...EVENTS, holdMs: 90_000 }), /counted every hour; silence counts as 0, for 90 seconds at most$/);
    });

    test('the durations of the wire are taken, and equal ones are one object', () => {
        const wire = (seconds: bigint) => create(StateReportingSchema, { kind: RowKind.CHANGES, holdMax: { seconds }, step: { seconds: 60n, nanos: 500_000_000 } });
        assert.deepEqual(reportedAs(wire(7200n)), { rows: RowKind.CHANGES, holdMs: 2 * HOUR, stepMs: 60_500 });
        assert.equal(reportedAs(wire(7200n)), reportedAs(wire(7200n)));
        assert.notEqual(reportedAs(wire(7200n)), reportedAs(wire(7201n)));
        assert.equal(reportedAs(create(StateReportingSchema, { kind: RowKind.SAMPLES })), undefined);
        assert.equal(reportedAs(undefined), undefined);
    });

    test('the newest row says how long it holds', () => {
        const now = Date.now();
        const text = (reported: Reported, row: number, until: number, newest = until) => heldText(reported, '1', { row, until, newest }, 'UTC');
        assert.equal(text(CHANGES, now - HOUR, now), 'its value 1 holds now');
        assert.match(text(CHANGES, 0, 2 * HOUR), /^its value 1 held until Thu 1 Jan 1970, 02:00, and is unknown since$/);
        assert.match(text(CHANGES, 0, HOUR), /^its value 1 held until Thu 1 Jan 1970, 01:00, the newest data/);
        assert.equal(text(CHANGES, HOUR, HOUR, 2 * HOUR), 'its sensor has no value since');
        assert.equal(text(CHANGES, HOUR, HOUR), 'its value is 1');
        assert.equal(heldText(CHANGES, '1', { row: HOUR, until: HOUR, newest: HOUR, hasValue: false }, 'UTC'), 'its sensor has no value since');
        assert.match(text(EVENTS, 0, HOUR), /^complete until Thu 1 Jan/);
    });

    test('whether the newest row of all has a value is asked for', async () => {
        assert.deepEqual([HOUR, 2 * HOUR].map((newest) => isDoubtful({ row: HOUR, until: HOUR, newest })), [true, false]);
        const { reconstruct } = queries;
        const has = async (values: number[]) => {
            Object.assign(queries, {
                reconstruct: async function* () {
                    yield { timesNanos: values.map(() => BigInt(HOUR) * 1_000_000n), values };
                },
            });
            return hasValueAt('home', 'door', HOUR);
        };
        assert.deepEqual([await has([0]), await has([Number.NaN]), await has([])], [true, false, undefined]);
        Object.assign(queries, { reconstruct });
    });

    test('the newest value says in short since when, or when it came', () => {
        const [now, here] = [Date.now(), { zone: 'UTC', isNarrow: false }];
        const text = (row: number, until: number, reported?: Reported, where = here) => newestText(1, { row, until, newest: now }, reported, where);
        assert.deepEqual([text(now - 2 * HOUR, now, CHANGES), text(now - 2 * HOUR, now - 2 * HOUR)], ['1 for 2.0 h', '1, 2.0 h ago']);
        assert.equal(text(now - 2 * HOUR, now - 2 * HOUR, CHANGES), 'unknown for 2.0 h');
        assert.deepEqual([text(HOUR, 2 * HOUR, CHANGES), text(HOUR, HOUR)], ['1 since 1 Jan 01:00', '1, 1 Jan 01:00']);
        assert.equal(text(HOUR, 2 * HOUR, CHANGES, { zone: 'UTC', isNarrow: true }), '1, 1 Jan');
    });

    test('rows are counted as what they are', () => {
        const text = (times: number[], reported?: Reported) => seenText({ times, values: times, note: '', pieces: reported && [] }, reported);
        assert.deepEqual([text([1]), text([1, 2]), text([1], CHANGES), text([1, 2], EVENTS)], ['1 observation as a dot', '2 observations as dots', '1 change, drawn as steps', '2 events, drawn as steps']);
    });
});

suite('means and errors', () => {
    test('of readings are those of their half-hours; where there are none is no number', () => {
        const seen = { times: [5 * MINUTE, 29 * MINUTE, 60 * MINUTE, -MINUTE, 125 * MINUTE], values: [1, 0, 0.25, 9, 9] };
        assert.deepEqual(averages(seen, [0, 1, 2, 3].map((half) => half * 30 * MINUTE), 2 * HOUR), [0.5, UNKNOWN, 0.25, UNKNOWN]);
    });

    test('compare a reading with the nearest prediction, and a piece with each that it covers', () => {
        const times = [0, 1, 2].map((hour) => hour * HOUR);
        assert.equal(errorOf({ times: [10 * MINUTE, 50 * MINUTE], values: [1, 1] }, times, [1, 0, 0]), 0.5);
        const seen = seenOf({ times: [0], values: [1], note: '' }, CHANGES, 0, DAY, 2 * HOUR);
        assert.equal(errorOf(seen, times, [1, 0, 1]), 0.5);
        assert.equal(errorOf({ times: [], values: [] }, times, [1, 1, 1]), undefined);
    });
});
