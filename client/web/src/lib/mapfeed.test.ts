// The opening time of a view, the order of states, and the offers for a name that does not exist.

import assert from 'node:assert/strict';
import { afterEach, beforeEach, suite, test } from 'node:test';

import { Code, ConnectError } from '@connectrpc/connect';

import { DAY, HOUR } from './civil';
import { byName, horizonOf, likeNames, MapFeed, newestTime, openingTime } from './mapfeed.svelte';
import { maps } from './rpc.svelte';

const NOON = Date.parse('2025-03-12T12:03Z');
const seen = (ms: number) => ({ lastTime: { seconds: BigInt(Math.floor(ms / 1000)), nanos: 0 } });

suite('a view', () => {
    test('opens now, or at the newest data if they are older than a day', () => {
        assert.equal(openingTime(NOON - DAY / 2, NOON), Date.parse('2025-03-12T12:00Z'));
        assert.equal(openingTime(undefined, NOON), Date.parse('2025-03-12T12:00Z'));
        assert.equal(openingTime(NOON - 3 * DAY, NOON), Date.parse('2025-03-09T12:00Z'));
    });

    test('takes the newest data that are not ahead of the clock, and without states what was learned', () => {
        assert.equal(newestTime([seen(1000), seen(5000), seen(3000), {}, seen(NOON + DAY)], 9000, NOON), 5000);
        assert.equal(newestTime([{}], 9000, NOON), 9000);
        assert.equal(newestTime([], NOON + DAY, NOON), undefined);
    });
});

suite('a map', () => {
    const { getMap, listMaps, listStates } = maps;
    const answer = (method: 'getMap' | 'listMaps' | 'listStates', body: () => unknown) => Object.assign(maps, { [method]: () => Promise.resolve().then(body) });
    let listings: number;
    let observations: bigint;
    beforeEach(() => {
        [listings, observations] = [0, 1n];
        answer('getMap', () => ({ map: { name: 'home', observations, states: 2n } }));
        answer('listStates', () => (listings++, { states: [{ name: 'edge/a/b' }, { name: 'door-10' }, { name: 'door-2' }], nextPageToken: '' }));
    });
    afterEach(() => void Object.assign(maps, { getMap, listMaps, listStates }));

    test('has its states by name, those of edges last', async () => {
        const feed = new MapFeed('home');
        await feed.load();
        assert.deepEqual([feed.isReady, feed.isListed, feed.others], [true, true, undefined]);
        assert.deepEqual(feed.states.map(({ name }) => name), ['door-2', 'door-10', 'edge/a/b']);
        assert.deepEqual(byName(feed.states), feed.states);
    });

    test('is listed again only when something came', async () => {
        const feed = new MapFeed('home');
        await feed.load();
        await feed.load();
        assert.equal(listings, 1);
        observations = 2n;
        await new Promise((done) => setTimeout(done, 200));
        await feed.load();
        assert.equal(listings, 2);
    });

    test('that does not exist is told with those that do', async () => {
        answer('getMap', () => {
            throw new ConnectError('there is no map', Code.NotFound);
        });
        answer('listMaps', () => ({ maps: [{ name: 'home' }, { name: 'office' }] }));
        const feed = new MapFeed('hone');
        await feed.load();
        assert.deepEqual([feed.others, feed.problem, feed.isReady], [['home', 'office'], '', false]);
    });
});

test('names that are like another come first', () => {
    const names = ['kitchen-door', 'garage-door', 'kitchen-window', 'attic'];
    assert.deepEqual(likeNames('kitchen', names), ['kitchen-door', 'kitchen-window']);
    assert.deepEqual(likeNames('zzz', names), []);
});

test('a map is known up to now while data come, else up to the newest', () => {
    assert.deepEqual([undefined, 0, 1].map((newest) => horizonOf(newest, HOUR)), [0, 0, HOUR]);
});
