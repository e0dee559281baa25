// The opening time of a view, the order of states, and the offers for a name that does not exist.

import assert from 'node:assert/strict';
import { afterEach, beforeEach, suite, test } from 'node:test';

import { Code, ConnectError } from '@connectrpc/connect';

import { DAY, HOUR } from './civil';
import { busyTime, byName, hasFew, horizonOf, likeNames, MapFeed, newestTime, openingTime } from './mapfeed.svelte';
import { maps, queries } from './rpc.svelte';
import type { State } from '../wire/tidemap/v1/map_pb';
import { StateKind } from '../wire/tidemap/v1/types_pb';

const NOON = Date.parse('2025-03-12T12:03Z');
const seen = (ms: number) => ({ lastTime: { seconds: BigInt(Math.floor(ms / 1000)), nanos: 0 } });

suite('a view', () => {
    test('opens now, or at the newest data if they are older than a day', () => {
        assert.equal(openingTime(NOON - DAY / 2, NOON), Date.parse('2025-03-12T12:00Z'));
        assert.equal(openingTime(undefined, NOON), Date.parse('2025-03-12T12:00Z'));
        assert.equal(openingTime(NOON - 3 * DAY, NOON), Date.parse('2025-03-09T12:00Z'));
        assert.equal(openingTime(35_000, NOON), 60_000);
    });

    test('takes the newest data that are not ahead of the clock, and without states what was learned', () => {
        assert.equal(newestTime([seen(1000), seen(5000), seen(3000), {}, seen(NOON + DAY)], 9000, NOON), 5000);
        assert.equal(newestTime([{}], 9000, NOON), 9000);
        assert.equal(newestTime([], NOON + DAY, NOON), undefined);
    });
});

suite('a map of few states', () => {
    const { predictStates } = queries;
    afterEach(() => void Object.assign(queries, { predictStates }));
    const state = (name: string, kind = StateKind.PROBABILITY, pending = 0n) => ({ name, kind, observations: 9n, pending }) as State;

    test('has no grid, and few states that robots named', () => {
        const many = Array.from({ length: 13 }, (_, index) => state(`door-${index}`));
        assert.deepEqual([many, many.slice(1), [...many.slice(1), state('edge/a/b')]].map((states) => hasFew({}, states)), [false, true, true]);
        assert.equal(hasFew({ grid: {} as never }, []), false);
    });

    test('opens at the half hour at which most changes, of what was learned', async () => {
        const asked: string[][] = [];
        Object.assign(queries, {
            predictStates: async function* ({ states, timesNanos }: { states: string[]; timesNanos: bigint[] }) {
                asked.push(states);
                await Promise.resolve();
                const hours = timesNanos.map((_, index) => index / 2);
                yield { firstTimeIndex: 0, probabilities: hours.map((hour) => Number(hour >= 8 && hour < 17)) };
                yield { firstTimeIndex: 0, probabilities: hours.map((hour) => 0.3 * Number(hour >= 17)) };
            },
        });
        const states = [state('door'), state('lamp'), state('new', StateKind.PROBABILITY, 9n), state('heat', StateKind.CONTINUOUS), state('edge/a/b')];
        assert.equal(await busyTime('home', states, NOON, 'UTC'), Date.parse('2025-03-12T17:00Z'));
        assert.deepEqual(asked, [['door', 'lamp']]);
        assert.equal(await busyTime('home', [state('new', StateKind.PROBABILITY, 9n)], NOON, 'UTC'), undefined);
        Object.assign(queries, { predictStates: async function* () { yield await Promise.resolve({ firstTimeIndex: 0, probabilities: [0.5, 0.6, 0.5] }); } });
        assert.equal(await busyTime('home', states, NOON, 'UTC'), undefined);
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
