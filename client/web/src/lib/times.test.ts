// Times of the wire.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { fromNanos, fromTimestamp, toNanos, toTimestamp } from './times';

const MS = Date.UTC(2025, 2, 4, 10, 0, 0, 123);

test('milliseconds become nanoseconds exactly, and come back', () => {
    assert.equal(toNanos(MS), 1_741_082_400_123_000_000n);
    assert.equal(fromNanos(toNanos(MS)), MS);
});

test('times before 1970 are the first instant of the wire', () => {
    assert.equal(toNanos(-5000), 1_000_000n);
    assert.equal(fromTimestamp(toTimestamp(-5000)), 1);
});

test('parts of a millisecond are rounded on the way out and cut on the way in', () => {
    assert.equal(toNanos(1.6), 2_000_000n);
    assert.equal(fromNanos(1_999_999n), 1);
});

test('milliseconds become a timestamp of seconds and nanoseconds, and come back', () => {
    const time = toTimestamp(MS + 0.4);
    assert.deepEqual([time.seconds, time.nanos], [1_741_082_400n, 123_000_000]);
    assert.equal(fromTimestamp(time), MS);
});

test('a timestamp keeps parts of a millisecond, and none is undefined', () => {
    assert.equal(fromTimestamp({ ...toTimestamp(2000), nanos: 1_500_000 }), 2001.5);
    assert.equal(fromTimestamp(undefined), undefined);
});
