import assert from 'node:assert/strict';
import { test } from 'node:test';
import { worthText } from './worth';

const rows = (judged: number) => [
    { name: 'pending_judged', value: judged }, { name: 'pending_error', value: 0.2104 }, { name: 'usual_error', value: 0.08 }, { name: 'update_gain', value: 0.1304 },
];

test('the worth of an update is told where something is judged', () => {
    assert.equal(worthText(rows(48)), 'error 0.210, usually 0.080: 0.130 to gain');
    assert.equal(worthText(rows(0)), '', 'nothing is pending');
    assert.equal(worthText(rows(48).slice(0, 2)), '', 'the daemon did not say it');
    assert.equal(worthText([]), '');
});
