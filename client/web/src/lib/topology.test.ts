// The feed of the plan: places, presence and edges as the daemon forecasts them.

import assert from 'node:assert/strict';
import { beforeEach, mock, suite, test } from 'node:test';

import { create, type MessageInitShape } from '@bufbuild/protobuf';
import { Code, ConnectError } from '@connectrpc/connect';

import { PredictEdgesResponseSchema, type PredictedEdgeSchema } from '../wire/tidemap/v1/route_pb';
import { PredictPresenceResponseSchema } from '../wire/tidemap/v1/search_pb';
import { GetTopologyResponseSchema } from '../wire/tidemap/v1/topology_pb';
import { routes, searches, topologies } from './rpc.svelte';
import { PlanFeed, type EdgeColour } from './topology.svelte';

const edges: MessageInitShape<typeof PredictedEdgeSchema>[] = [
    { edge: { from: 'hall', to: 'lab' }, success: 0.9, durationSecs: 10, reports: 3n },
    { edge: { from: 'lab', to: 'hall' }, success: 0.4, durationSecs: 5, reports: 4n },
    { edge: { from: 'lab', to: 'dock' }, success: 1, durationSecs: 40, reports: 0n },
    { success: 0.1, durationSecs: 1 },
];
let asked: number[];

beforeEach(() => {
    asked = [];
    mock.method(topologies, 'getTopology', () =>
        Promise.resolve(create(GetTopologyResponseSchema, {
            nodes: [{ name: 'hall', pose: { xM: 1, yM: 2 } }, { name: 'lab', pose: { xM: 5, yM: -3 } }],
        })));
    mock.method(routes, 'predictEdges', (request: Parameters<typeof routes.predictEdges>[0]) => {
        asked.push(Number(request.time?.seconds));
        return Promise.resolve(create(PredictEdgesResponseSchema, { edges }));
    });
    mock.method(searches, 'predictPresence', () =>
        Promise.resolve(create(PredictPresenceResponseSchema, { nodes: ['lab'], times: [{ probabilities: [0.25] }] })));
});

/** Longer than a forecast waits for the slider to rest. */
const rest = () => new Promise((done) => setTimeout(done, 150));

async function loaded(colour: EdgeColour): Promise<PlanFeed> {
    const feed = new PlanFeed();
    await feed.load('home');
    feed.predict('home', 5000, colour, '');
    await rest();
    return feed;
}

suite('a plan', () => {
    test('has the nodes of the map, with presence where it is known', async () => {
        const feed = await loaded('success');
        assert.deepEqual(feed.plan.nodes, [{ name: 'hall', x: 1, y: 2 }, { name: 'lab', x: 5, y: -3, presence: 0.25 }]);
        assert.deepEqual(feed.extent, { minX: -1, maxX: 7, minY: -5, maxY: 4 });
    });

    test('has both directions of an edge as one, by the worse, with all reports', async () => {
        const { plan } = await loaded('success');
        const shown = plan.edges.map(({ share, reports, title }) => ({ share, reports, title }));
        assert.deepEqual(shown, [
            { share: 0.4, reports: 7, title: 'lab – hall: success 0.40, 10 s' },
            { share: undefined, reports: 0, title: 'lab – dock: success 1.00, 40 s' },
        ]);
    });

    test('has neither presence nor colours that no update has learned', async () => {
        const feed = await loaded('success');
        feed.unlearned = new Set(['lab', 'edge/lab/hall', 'edge/lab/dock']);
        assert.equal(feed.plan.nodes[1]?.presence, undefined);
        assert.deepEqual(feed.plan.edges.map(({ share, title }) => [share?.toFixed(2), title]), [
            ['0.90', 'hall – lab: success 0.90, 10 s'], [undefined, 'lab – dock: not learned yet'],
        ]);
    });

    test('colours durations as shares of the longest, or nothing', async () => {
        assert.deepEqual((await loaded('duration')).plan.edges.map(({ share, isAmount }) => [share, isAmount]), [[0.25, true], [undefined, true]]);
        assert.deepEqual((await loaded('none')).plan.edges, []);
    });

    test('asks once the slider rests, for the last time it was at', async () => {
        const feed = new PlanFeed();
        await feed.load('home');
        for (const ms of [1000, 2000, 3000]) feed.predict('home', ms, 'success', '');
        await rest();
        assert.deepEqual(asked, [3]);
    });

    test('asks nothing of a map without nodes, which has no extent', async () => {
        mock.method(topologies, 'getTopology', () => Promise.resolve(create(GetTopologyResponseSchema, {})));
        const feed = await loaded('success');
        assert.deepEqual([feed.hasNodes, feed.extent, asked], [false, undefined, []]);
    });

    test('does without presence where there are no observations of it, and says other errors', async () => {
        const refuse = (code: Code) => mock.method(searches, 'predictPresence', () => Promise.reject(new ConnectError('no presence', code)));
        refuse(Code.FailedPrecondition);
        const quiet = await loaded('success');
        assert.deepEqual([quiet.problem, quiet.plan.nodes[1]?.presence, quiet.plan.edges.length], ['', undefined, 2]);
        refuse(Code.Internal);
        assert.equal((await loaded('success')).problem, 'no presence');
    });
});
