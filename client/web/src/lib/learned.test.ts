// What waits for an update, and how it is written.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { isLearned, unlearnedText, waitingOf, waitingText } from './learned';

const map = { pendingObservations: 12n, aheadObservations: 2n, gridSummary: undefined, lastUpdate: undefined };

test('a state is learned once an update has learned some of its observations', () => {
    assert.deepEqual([[0n, 0n], [5n, 5n], [5n, 4n]].map(([observations = 0n, pending = 0n]) => isLearned({ observations, pending })), [false, false, true]);
    assert.deepEqual([0n, 5n].map((observations) => unlearnedText({ observations, pending: observations } as never)), ['never observed', 'not learned yet']);
});

test('observations that lie in the future do not wait for an update', () => {
    assert.equal(waitingText(waitingOf(map)!), '10 observations');
    assert.equal(waitingOf({ ...map, aheadObservations: 12n }), undefined);
    assert.equal(waitingOf(undefined), undefined);
});

test('scans wait, too, and a map that had an update is not all new', () => {
    const gridSummary = { pendingScans: 3n, aheadScans: 2n } as never;
    const waiting = waitingOf({ ...map, gridSummary, lastUpdate: { generation: 1n } as never });
    assert.deepEqual([waiting?.isAll, waitingOf({ ...map, lastUpdate: { generation: 0n } as never })?.isAll], [false, true]);
    assert.equal(waitingText(waiting!), '10 observations and 1 scan');
});
