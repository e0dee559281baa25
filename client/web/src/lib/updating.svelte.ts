// An update that the page has started: how far it is, and why it failed.
//
// Invariant: one update at a time; the page only follows the job, which goes on when the page is closed.

import { Code, ConnectError } from '@connectrpc/connect';

import { JobState } from '../wire/tidemap/v1/maintenance_pb';
import { maintenance, message } from './rpc.svelte';

export class Updating {
    isRunning = $state(false);
    /** Share of the states that are done. */
    share = $state(0);
    problem = $state('');

    /** Updates a map; `true` once it is learned. */
    async run(map: string): Promise<boolean> {
        if (this.isRunning) return false;
        [this.isRunning, this.share, this.problem] = [true, 0, ''];
        let isDone = false;
        try {
            let { job } = await maintenance.runUpdate({ map });
            if (job) {
                for await (const answer of maintenance.watchJob({ id: job.id })) {
                    job = answer.job ?? job;
                    this.share = Number(job.statesDone) / Math.max(1, Number(job.statesTotal));
                }
                isDone = job.state === JobState.DONE;
                if (job.state === JobState.FAILED) this.problem = `The update failed: ${job.error}`;
            }
        } catch (error) {
            const isForbidden = ConnectError.from(error).code === Code.PermissionDenied;
            this.problem = isForbidden ? `This page may not change data. Run this on the robot or on the server: tidemap update ${map}` : message(error);
        }
        this.isRunning = false;
        return isDone;
    }
}
