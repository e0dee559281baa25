// The places with most information: the requested places.

import assert from 'node:assert/strict';
import { afterEach, suite, test } from 'node:test';

import { exploration } from './rpc.svelte';
import { LookFeed, placesOf } from './look.svelte';

suite('places', () => {
    test('lie a metre apart in a small box, in the middles of their squares', () => {
        const { size, places } = placesOf({ minX: 2, minY: 5, maxX: 4, maxY: 6 });
        assert.deepEqual([size, places], [1, [{ x: 2.5, y: 5.5 }, { x: 3.5, y: 5.5 }]]);
    });

    test('are at most 400 in a large one, of any shape', () => {
        for (const [maxX, maxY] of [[100, 100], [10_000, 3], [20.5, 19.5]] as const) {
            const { places } = placesOf({ minX: 0, minY: 0, maxX, maxY });
            assert.ok(places.length > 100 && places.length <= 400, `${maxX} x ${maxY}: ${places.length}`);
        }
    });
});

suite('looks', () => {
    const { evaluateViews } = exploration;
    afterEach(() => void Object.assign(exploration, { evaluateViews }));

    test('are those of places from which something is seen', async () => {
        Object.assign(exploration, {
            evaluateViews: async function* () {
                await Promise.resolve();
                yield { viewpoint: 0, informationBits: [], reason: 'inside a wall' };
                yield { viewpoint: 1, informationBits: [2.5], reason: '' };
            },
        });
        const feed = new LookFeed();
        feed.ask('home', { minX: 0, minY: 0, maxX: 2, maxY: 1 }, 5000);
        await new Promise((done) => setTimeout(done, 200));
        assert.deepEqual(feed.looks, [{ x: 1.5, y: 0.5, size: 1, bits: 2.5 }]);
        feed.ask('home', undefined, 5000);
        assert.deepEqual(feed.looks, []);
    });

    test('are asked for again when the map has learned, and not before', async () => {
        let asked = 0;
        Object.assign(exploration, {
            evaluateViews: async function* () {
                asked++;
                await Promise.resolve();
                yield { viewpoint: 0, informationBits: [asked], reason: '' };
            },
        });
        const feed = new LookFeed();
        const ask = async (generation: string) => {
            feed.ask('home', { minX: 0, minY: 0, maxX: 1, maxY: 1 }, 5000, generation);
            await new Promise((done) => setTimeout(done, 200));
            return feed.looks.map((look) => look.bits);
        };
        assert.deepEqual([await ask('1'), await ask('1'), await ask('2')], [[1], [1], [2]]);
    });
});
