// Rows by kind: what is folded, and what is not.

import assert from 'node:assert/strict';
import { suite, test } from 'node:test';

import type { State } from '../wire/tidemap/v1/map_pb';
import { keyOf, rowsOf } from './groups';

const states = (...names: string[]) => names.map((name) => ({ name })) as State[];
const doors = Array.from({ length: 11 }, (_, index) => `door-${index}`);
const edges = ['edge/a/b', 'edge/b/a', 'edge/b/c'];
const keys = (all: State[], open: [string, boolean][] = [], chosen: string[] = [], isFolded = true) =>
    rowsOf(all, new Map(open), chosen, isFolded).map(keyOf).filter((key) => !key.startsWith('door'));

suite('rows', () => {
    const all = states(...doors, ...edges, 'speed/a/b');

    test('of a kind are folded into one, few of a kind are not', () => {
        assert.deepEqual(keys(all), ['edge//', 'speed/a/b']);
        assert.deepEqual(rowsOf(all, new Map(), [], true).find(({ group }) => group)?.group, { prefix: 'edge', count: 3, isOpen: false });
    });

    test('are unfolded by hand, or because one of them is chosen', () => {
        const open = ['edge//', ...edges, 'speed/a/b'];
        assert.deepEqual(keys(all, [['edge', true]]), open);
        assert.deepEqual(keys(all, [], ['edge/b/a']), open);
        assert.deepEqual(keys(all, [['edge', false]], ['edge/b/a']), ['edge//', 'speed/a/b']);
    });

    test('of a short list, or of a search, are all there', () => {
        assert.deepEqual(keys(states(...edges)), edges);
        assert.deepEqual(keys(all, [], [], false), [...edges, 'speed/a/b']);
    });
});
