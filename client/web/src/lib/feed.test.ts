// The feed of the map: the frame that it shows while others are on their way.

import assert from 'node:assert/strict';
import { beforeEach, mock, suite, test } from 'node:test';

import { create } from '@bufbuild/protobuf';
import { Code, ConnectError } from '@connectrpc/connect';

import { PredictGridResponseSchema } from '../wire/tidemap/v1/query_pb';
import { Feed } from './feed.svelte';
import { comingFrames, type GridQuery } from './frames';
import { queries } from './rpc.svelte';

/** Requests that wait, by their time in milliseconds. */
const open = new Map<number, { answer: (probability: number) => void; fail: (error: Error) => void }>();
mock.method(queries, 'predictGrid', async function* (request: Parameters<typeof queries.predictGrid>[0]) {
    const ms = Number(request.time?.seconds) * 1000;
    const probability = await new Promise<number>((answer, fail) => open.set(ms, { answer, fail }));
    const tile = { known: new Uint8Array(8).fill(1), values: Array<number>(8).fill(probability), allValues: true };
    yield create(PredictGridResponseSchema, { message: { case: 'page', value: { tiles: [tile] } } });
});

/** Lets everything run that waits for nothing else. */
const settle = () => new Promise((done) => setImmediate(done));

async function answer(ms: number, probability = 0): Promise<void> {
    open.get(ms)?.answer(probability);
    open.delete(ms);
    await settle();
}

let generation = 0;
let query: GridQuery;
let feed: Feed;

/** The only cell that is shown. */
function shown(): number | undefined {
    return feed.frame?.cells[0];
}

beforeEach(async () => {
    for (const ms of [...open.keys()]) await answer(ms);
    query = { map: 'home', window: { minX: 0, minY: 0, maxX: 1, maxY: 1 }, minZ: 0, maxZ: 1, isLatest: false, generation: `${generation++}` };
    feed = new Feed();
});

suite('a feed', () => {
    test('shows the frame of the wanted time once it is here', async () => {
        feed.ask(query, undefined);
        feed.show(1000);
        assert.equal(shown(), undefined);
        await answer(1000, 1);
        assert.deepEqual([shown(), feed.shownMs, feed.problem], [254, 1000, '']);
        feed.ask(undefined, undefined);
        assert.deepEqual([feed.frame, feed.hasGrid], [undefined, false]);
    });

    test('has two requests at most, and leaves out times that were passed meanwhile', async () => {
        feed.ask(query, undefined);
        for (const ms of [1000, 2000, 3000, 4000]) feed.show(ms);
        assert.deepEqual([...open.keys()], [1000, 2000]);
        await answer(1000);
        await answer(2000);
        assert.deepEqual([...open.keys()], [4000]);
        await answer(4000, 1);
        assert.deepEqual([shown(), feed.shownMs], [254, 4000]);
    });

    test('does not show the answer to another question', async () => {
        feed.ask(query, undefined);
        feed.show(1000);
        const old = open.get(1000);
        feed.ask({ ...query, minZ: 1 }, undefined);
        old?.answer(1);
        await settle();
        assert.equal(shown(), undefined);
        await answer(1000, 0.25);
        assert.equal(shown(), 64);
    });

    test('shows the difference from a base time, once both are here', async () => {
        feed.ask(query, 9000);
        feed.show(1000);
        await answer(1000, 1);
        assert.equal(shown(), undefined);
        await answer(9000, 0.25);
        assert.deepEqual([shown(), feed.frame?.before?.[0]], [254, 64]);
    });

    test('shows a time between two frames only if both are here', async () => {
        feed.ask(query, undefined);
        feed.show(1000);
        await answer(1000, 0);
        assert.equal(feed.showBetween(1000, 2000, 0.5), false);
        feed.show(2000);
        await answer(2000, 1);
        assert.equal(feed.showBetween(1000, 2000, 0.5), true);
        assert.deepEqual([shown(), feed.shownMs], [127, 1500]);
    });

    test('says what the daemon refused, and asks again when it is wanted again', async () => {
        feed.ask(query, undefined);
        feed.show(1000);
        open.get(1000)?.fail(new ConnectError('too many cells', Code.ResourceExhausted));
        open.delete(1000);
        await settle();
        assert.deepEqual([feed.problem, open.size], ['too many cells', 0]);
        feed.show(1000);
        await answer(1000, 1);
        assert.deepEqual([shown(), feed.problem], [254, '']);
    });

    test('fetches a bounded number of frames ahead, and none of the last readings', () => {
        feed.prefetch([1000]);
        feed.ask({ ...query, isLatest: true }, undefined);
        feed.prefetch([1000]);
        assert.equal(comingFrames(), 0);
        feed.ask(query, undefined);
        feed.prefetch(Array.from({ length: 20 }, (_, index) => index * 1000));
        assert.deepEqual([...open.keys()], [0, 1000, 2000, 3000, 4000, 5000]);
    });
});
