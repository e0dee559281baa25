// The feed of a flow: how a reply is read, when it is requested, and what is dropped.

import assert from 'node:assert/strict';
import { mock, suite, test } from 'node:test';

import { create, type MessageInitShape } from '@bufbuild/protobuf';
import { Code, ConnectError } from '@connectrpc/connect';

import { PredictFlowResponseSchema } from '../wire/tidemap/v1/query_pb';
import { FlowFeed } from './flowfeed.svelte';
import { queries } from './rpc.svelte';

type Request = Parameters<typeof queries.predictFlow>[0];
type Piece = MessageInitShape<typeof PredictFlowResponseSchema>['message'];

const PEOPLE = { positions: 'people', directions: 'heading' };
const header: Piece = { case: 'header', value: { lowM: [-1, 2], resolutionM: 0.5, counts: [3, 2], directions: 2, detections: 7n } };
const pieces: Piece[] = [
    header,
    { case: 'cells', value: { indices: [0, 4], expectedCounts: [1.5, 2], shares: [0.25, 0.75, 1, 0] } },
    { case: 'cells', value: { indices: [5], expectedCounts: [3], shares: [0, 1] } },
];

/** Makes the daemon answer with pieces, after `gate`; returns its requests. */
function answer(all: Piece[], gate: (request: Request) => Promise<unknown> = () => Promise.resolve()): Request[] {
    const asked: Request[] = [];
    mock.method(queries, 'predictFlow', async function* (request: Request) {
        asked.push(request);
        await gate(request);
        for (const message of all) yield create(PredictFlowResponseSchema, { message });
    });
    return asked;
}

/** Longer than a question waits for the slider to rest. */
const rest = () => new Promise((done) => setTimeout(done, 150));

suite('a flow', () => {
    test('is asked for by the names of both states, and read from all pieces', async () => {
        const asked = answer(pieces);
        const feed = new FlowFeed();
        feed.ask('hall', PEOPLE, 5000, '');
        await rest();
        assert.deepEqual(asked, [{ map: 'hall', source: { state: 'people', motionState: 'heading' }, timesNanos: [5_000_000_000n] }]);
        const cells = [
            { column: 0, row: 0, count: 1.5, shares: [0.25, 0.75] },
            { column: 1, row: 1, count: 2, shares: [1, 0] },
            { column: 2, row: 1, count: 3, shares: [0, 1] },
        ];
        assert.deepEqual(feed.flow, { lowX: -1, lowY: 2, edge: 0.5, columns: 3, rows: 2, detections: 7n, cells });
        assert.deepEqual([feed.shownMs, feed.problem], [5000, '']);
    });

    test('is asked for once the slider rests, for the last time it was at', async () => {
        const asked = answer(pieces);
        const feed = new FlowFeed();
        for (const ms of [1000, 2000, 3000]) feed.ask('hall', PEOPLE, ms, '');
        await rest();
        assert.deepEqual(asked.map((request) => request.timesNanos), [[3_000_000_000n]]);
    });

    test('stays until that of the next time is here, and is gone with other states or none', async () => {
        answer(pieces);
        const feed = new FlowFeed();
        feed.ask('hall', PEOPLE, 1000, '');
        await rest();
        feed.ask('hall', PEOPLE, 2000, '');
        assert.equal(feed.shownMs, 1000);
        await rest();
        assert.equal(feed.shownMs, 2000);
        feed.ask('hall', { ...PEOPLE, directions: 'velocity' }, 2000, '');
        assert.equal(feed.flow, undefined);
        await rest();
        assert.equal(feed.flow !== undefined, true);
        feed.ask('hall', undefined, 2000, '');
        assert.equal(feed.flow, undefined);
    });

    test('of states that were chosen before does not arrive', async () => {
        let open: () => void = () => {};
        const gate = new Promise<void>((done) => (open = done));
        answer(pieces, (request) => (request.source?.motionState === 'heading' ? gate : Promise.resolve()));
        const feed = new FlowFeed();
        feed.ask('hall', PEOPLE, 1000, '');
        await rest();
        feed.ask('hall', undefined, 1000, '');
        open();
        await rest();
        assert.deepEqual([feed.flow, feed.problem], [undefined, '']);
    });

    test('of states that were chosen before is asked for no more, and its problem does not arrive', async () => {
        let fail: (error: Error) => void = () => {};
        const gate = new Promise<void>((_, failed) => (fail = failed));
        const asked = answer(pieces, () => gate);
        const feed = new FlowFeed();
        for (const ms of [1000, 2000]) {
            feed.ask('hall', PEOPLE, ms, '');
            await rest();
        }
        feed.ask('hall', undefined, 2000, '');
        fail(new ConnectError('too many', Code.ResourceExhausted));
        await rest();
        assert.deepEqual([asked.length, feed.problem], [1, '']);
    });

    test('that cannot be is replaced by what the daemon says, until it can', async () => {
        answer(pieces);
        const feed = new FlowFeed();
        feed.ask('hall', PEOPLE, 1000, '');
        await rest();
        answer([], () => Promise.reject(new ConnectError('no update has learned it', Code.FailedPrecondition)));
        feed.ask('hall', PEOPLE, 2000, '');
        await rest();
        assert.deepEqual([feed.flow, feed.problem], [undefined, 'no update has learned it']);
        answer(pieces);
        feed.ask('hall', PEOPLE, 2000, 'learned');
        await rest();
        assert.deepEqual([feed.shownMs, feed.problem], [2000, '']);
    });

    test('stays while the daemon is away', async () => {
        answer(pieces);
        const feed = new FlowFeed();
        feed.ask('hall', PEOPLE, 1000, '');
        await rest();
        answer([], () => Promise.reject(new ConnectError('canceled', Code.Canceled)));
        feed.ask('hall', PEOPLE, 2000, '');
        await rest();
        assert.deepEqual([feed.shownMs, feed.problem], [1000, '']);
    });

    test('without detections has a raster and no cells', async () => {
        answer([header]);
        const feed = new FlowFeed();
        feed.ask('hall', PEOPLE, 1000, '');
        await rest();
        assert.deepEqual([feed.flow?.columns, feed.flow?.cells], [3, []]);
    });
});
