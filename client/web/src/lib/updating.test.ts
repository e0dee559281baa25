// An update that the page runs: its progress, its end, and where it may not.

import assert from 'node:assert/strict';
import { afterEach, test } from 'node:test';

import { Code, ConnectError } from '@connectrpc/connect';

import { JobState } from '../wire/tidemap/v1/maintenance_pb';
import { maintenance } from './rpc.svelte';
import { Updating } from './updating.svelte';

const { runUpdate, watchJob } = maintenance;
afterEach(() => void Object.assign(maintenance, { runUpdate, watchJob }));

function answer(...jobs: { state: JobState; statesDone?: bigint; statesTotal?: bigint; error?: string }[]): number[] {
    const shares: number[] = [];
    Object.assign(maintenance, {
        runUpdate: () => Promise.resolve({ job: { id: 7n, state: JobState.WAITING } }),
        watchJob: async function* ({ id }: { id: bigint }) {
            assert.equal(id, 7n);
            for (const job of jobs) {
                yield { job };
                await Promise.resolve();
                shares.push(update.share);
            }
        },
    });
    return shares;
}
let update = new Updating();

test('an update is followed to its end', async () => {
    update = new Updating();
    const shares = answer({ state: JobState.RUNNING, statesDone: 1n, statesTotal: 4n }, { state: JobState.DONE, statesDone: 4n, statesTotal: 4n });
    const running = update.run('home');
    assert.equal(update.isRunning, true);
    assert.equal(await running, true);
    assert.deepEqual([shares, update.isRunning, update.problem], [[0.25, 1], false, '']);
});

test('an update that fails has its reason', async () => {
    update = new Updating();
    answer({ state: JobState.FAILED, statesDone: 0n, statesTotal: 0n, error: 'the disk is full' });
    assert.equal(await update.run('home'), false);
    assert.equal(update.problem, 'The update failed: the disk is full');
});

test('where the page may not change data, the command is named', async () => {
    update = new Updating();
    Object.assign(maintenance, { runUpdate: () => Promise.reject(new ConnectError('read only', Code.PermissionDenied)) });
    assert.equal(await update.run('home'), false);
    assert.match(update.problem, /tidemap update home$/);
});
