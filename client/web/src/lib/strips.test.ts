// The visible rows: which are requested, and which are kept.

import assert from 'node:assert/strict';
import { afterEach, beforeEach, suite, test } from 'node:test';

import { ModelKind, RowKind } from '../wire/tidemap/v1/types_pb';
import { DAY, HOUR } from './civil';
import { columnsOf } from './rows';
import { queries } from './rpc.svelte';
import { StripFeed, type StripQuestion } from './strips.svelte';
import { fromNanos, toNanos, toTimestamp } from './times';

interface Asked {
    states: string[];
    timesNanos: bigint[];
    model?: { kind: ModelKind };
}

const AT = Date.parse('2025-03-12T10:00Z');
const { predictStates } = queries;
let asked: Asked[];

beforeEach(() => {
    asked = [];
    Object.assign(queries, {
        predictStates: async function* (request: Asked) {
            asked.push(request);
            await Promise.resolve();
            for (const stateIndex of request.states.keys()) {
                const probabilities = request.timesNanos.map((nanos) => (request.model ? -1 : fromNanos(nanos)));
                yield { stateIndex, axis: 0, probabilities };
                yield { stateIndex, axis: 2, probabilities: [7] };
            }
        },
    });
});
afterEach(() => void Object.assign(queries, { predictStates }));

async function rest(feed: StripFeed, question: Partial<StripQuestion>): Promise<void> {
    feed.ask({ map: 'home', names: ['a'], columns: columnsOf('day', AT, 'UTC'), at: AT, generation: '1', reported: new Map(), show: 'predicted', ...question });
    await new Promise((done) => setTimeout(done, 90));
}

suite('visible rows', () => {
    test('have the middles of their hours, the value of the clock and the last reading', async () => {
        const feed = new StripFeed();
        await rest(feed, {});
        const row = feed.rows.get('a');
        assert.deepEqual([row?.length, row?.[0], row?.[23]], [24, AT - 10 * HOUR + HOUR / 2, AT + 13.5 * HOUR]);
        assert.deepEqual([feed.now.get('a'), feed.last.get('a')?.value, feed.problem], [AT, -1, '']);
    });

    test('are asked for once; a step of the clock asks for its values alone', async () => {
        const feed = new StripFeed();
        await rest(feed, {});
        asked = [];
        await rest(feed, { names: ['a', 'b'] });
        assert.deepEqual(asked.map(({ states, timesNanos }) => [states, timesNanos.length]), [[['b'], 1], [['b'], 1], [['b'], 24]]);
        asked = [];
        await rest(feed, { names: ['a', 'b'], at: AT + 1 });
        assert.deepEqual(asked.map(({ states, timesNanos }) => [states, timesNanos.length]), [[['a', 'b'], 1]]);
    });

    test('are asked for anew when something was learned', async () => {
        const feed = new StripFeed();
        await rest(feed, {});
        asked = [];
        await rest(feed, { generation: '2' });
        assert.deepEqual(asked.map(({ timesNanos }) => timesNanos.length), [1, 1, 24]);
    });

    test('have those of a week before, to compare with', async () => {
        const feed = new StripFeed();
        await rest(feed, { show: 'week' });
        assert.equal((feed.rows.get('a')?.[3] ?? 0) - (feed.before.get('a')?.[3] ?? 0), 7 * DAY);
    });

    test('have what was observed, where that is wanted', async () => {
        const { reconstruct } = queries;
        Object.assign(queries, {
            reconstruct: async function* () {
                await Promise.resolve();
                yield { timesNanos: [toNanos(AT), toNanos(AT + HOUR / 2)], values: [1, 0] };
            },
        });
        const feed = new StripFeed();
        await rest(feed, { show: 'observed' });
        Object.assign(queries, { reconstruct });
        assert.deepEqual([feed.rows.get('a')?.[10], feed.rows.get('a')?.[9]], [0.5, Number.NaN]);
    });

    test('have what rows of changes stand for, up to when they are known', async () => {
        const { reconstruct } = queries;
        Object.assign(queries, {
            predictStates: async function* ({ timesNanos }: Asked) {
                await Promise.resolve();
                // The time that the daemon returns: never newer than the requested one.
                const newest = Math.min(AT + 2.5 * HOUR, fromNanos(timesNanos.at(-1) ?? 0n));
                yield { stateIndex: 0, axis: 0, probabilities: timesNanos.map(() => 0), lastTime: toTimestamp(newest) };
            },
            reconstruct: async function* ({ toTime }: { toTime: { seconds: bigint } }) {
                await Promise.resolve();
                if (Number(toTime.seconds) * 1000 > AT) yield { timesNanos: [toNanos(AT + HOUR / 4)], values: [1] };
            },
        });
        const feed = new StripFeed();
        await rest(feed, { show: 'observed', reported: new Map([['a', { rows: RowKind.CHANGES, holdMs: DAY, stepMs: HOUR / 12 }]]) });
        while (!feed.rows.has('a')) await new Promise((done) => setTimeout(done, 5));
        Object.assign(queries, { reconstruct });
        assert.deepEqual(feed.rows.get('a')?.slice(9, 14), [Number.NaN, 1, 1, 1, Number.NaN]);
    });

    test('are asked for at the last rest only', async () => {
        const feed = new StripFeed();
        for (const name of ['x', 'y']) feed.ask({ map: 'home', names: [name], columns: columnsOf('day', AT, 'UTC'), at: AT, generation: '1', reported: new Map(), show: 'predicted' });
        await rest(feed, {});
        assert.deepEqual([...feed.rows.keys()], ['a']);
        feed.ask({ map: 'home', names: ['z'], columns: columnsOf('day', AT, 'UTC'), at: AT, generation: '1', reported: new Map(), show: 'predicted' });
        feed.stop();
        await new Promise((done) => setTimeout(done, 90));
        assert.deepEqual([...feed.rows.keys()], ['a']);
    });
});
