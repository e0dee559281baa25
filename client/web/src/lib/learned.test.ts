// What waits for an update, and how it is written.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { isLearned, unlearnedText, waitingText } from './learned';

test('a state is learned once an update has learned some of its observations', () => {
    assert.deepEqual([[0n, 0n], [5n, 5n], [5n, 4n]].map(([observations = 0n, pending = 0n]) => isLearned({ observations, pending })), [false, false, true]);
    assert.deepEqual([0n, 5n].map((observations) => unlearnedText({ observations, pending: observations } as never)), ['never observed', 'not learned yet']);
});

test('what waits is counted in words', () => {
    assert.equal(waitingText({ observations: 1234n, scans: 1n }), '1,234 observations and 1 scan');
    assert.equal(waitingText({ observations: 0n, scans: 2n }), '2 scans');
});
