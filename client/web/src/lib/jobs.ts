// Jobs in groups: an import of history runs an update for each of its nights.

import { JobState, type Job } from '../wire/tidemap/v1/maintenance_pb';

export interface JobGroup {
    /** The newest first; one job, or several that were done one after another for one map and one cause. */
    jobs: Job[];
    observations: bigint;
    secs: number;
}

/** Length of a job, seconds. */
export function secsOf(job: Job): number {
    return Number(job.elapsed?.seconds ?? 0n) + (job.elapsed?.nanos ?? 0) / 1e9;
}

/** Neighbours that are done, of one map and cause, as one; jobs that run, wait or failed stay single. */
export function grouped(jobs: Job[]): JobGroup[] {
    const groups: JobGroup[] = [];
    for (const job of jobs) {
        const last = groups.at(-1);
        const [other] = last?.jobs ?? [];
        const isSame = job.state === JobState.DONE && other?.state === JobState.DONE && other.map === job.map && other.cause === job.cause;
        if (last && isSame) {
            last.jobs.push(job);
            last.observations += job.observations;
            last.secs += secsOf(job);
        } else {
            groups.push({ jobs: [job], observations: job.observations, secs: secsOf(job) });
        }
    }
    return groups;
}
