// Jobs in groups.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { JobCause, JobState, type Job } from '../wire/tidemap/v1/maintenance_pb';
import { grouped } from './jobs';

test('jobs that are done one after another for one map and cause are one group; others stand alone', () => {
    let id = 9n;
    const job = (map: string, state: JobState, cause = JobCause.DATA_TIME) =>
        ({ id: id--, map, state, cause, observations: 10n, elapsed: { seconds: 1n, nanos: 500_000_000 } }) as Job;
    const groups = grouped([
        job('home', JobState.RUNNING), job('home', JobState.DONE), job('home', JobState.DONE), job('home', JobState.FAILED),
        job('home', JobState.DONE), job('home', JobState.DONE, JobCause.REQUEST), job('office', JobState.DONE, JobCause.REQUEST),
    ]);
    assert.deepEqual(groups.map(({ jobs }) => jobs.map((one) => Number(one.id))), [[9], [8, 7], [6], [5], [4], [3]]);
    assert.deepEqual([groups[1]?.observations, groups[1]?.secs], [20n, 3]);
});
