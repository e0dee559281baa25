// Tasks in words, and the kept plan of a day.

import assert from 'node:assert/strict';
import { afterEach, test } from 'node:test';

import { Code, ConnectError } from '@connectrpc/connect';

import { tasks } from './rpc.svelte';
import { daysText, keptPlan, lengthOfSecs, windowText } from './tasks';

const { getPlan } = tasks;
afterEach(() => void Object.assign(tasks, { getPlan }));

test('days of a task are ranges', () => {
    const of = (weekdays: number, date = '') => daysText({ weekdays, date });
    assert.deepEqual([0, 127, 0b11111, 0b1000001, 0b0110101, 0b0000011].map((days) => of(days)), ['every day', 'every day', 'Mon–Fri', 'Mon, Sun', 'Mon, Wed, Fri, Sat', 'Mon, Tue']);
    assert.equal(of(0, '2016-02-02'), '2016-02-02');
});

test('the window of a task ends with the day where no end is stated', () => {
    const task = { fromSecs: 30_600, untilSecs: 0, everySecs: 18_000, date: '', weekdays: 31 };
    assert.equal(windowText(task), '08:30–24:00, Mon–Fri, once in each 5 h');
    assert.deepEqual([45, 1200, 5400, 9000].map(lengthOfSecs), ['45 s', '20 min', '1.5 h', '2.5 h']);
});

test('a day without a kept plan is no problem', async () => {
    const refuse = (code: Code) => Object.assign(tasks, { getPlan: () => Promise.reject(new ConnectError('none', code)) });
    refuse(Code.NotFound);
    assert.equal(await keptPlan('home', '2016-02-02', 0), undefined);
    refuse(Code.Internal);
    await assert.rejects(keptPlan('home', '2016-02-02', 0));
});
