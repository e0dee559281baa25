// The tasks of a map and the kept plan of a day, in words.
//
// Invariant: times of tasks are seconds of the local day; times of plans are instants.

import { Code, ConnectError } from '@connectrpc/connect';

import type { GetPlanResponse, Task } from '../wire/tidemap/v1/task_pb';
import { tasks } from './rpc.svelte';
import { toTimestamp } from './times';

const DAYS = ['Mon', 'Tue', 'Wed', 'Thu', 'Fri', 'Sat', 'Sun'];

/** Seconds of a day as `08:00`. */
export function clockOfSecs(secs: number): string {
    const two = (value: number) => String(value).padStart(2, '0');
    return `${two(Math.floor(secs / 3600))}:${two(Math.floor((secs % 3600) / 60))}`;
}

/** A length of time as `20 min` or `1.5 h`. */
export function lengthOfSecs(secs: number): string {
    return secs < 60 ? `${secs} s` : secs < 3600 ? `${Number((secs / 60).toFixed(1))} min` : `${Number((secs / 3600).toFixed(1))} h`;
}

/** The days on which a task is done, as `Mon–Fri`. */
export function daysText({ date, weekdays }: Pick<Task, 'date' | 'weekdays'>): string {
    if (date) return date;
    const on = DAYS.map((_, index) => (weekdays & (1 << index)) !== 0);
    if (!weekdays || on.every(Boolean)) return 'every day';
    const runs: string[] = [];
    for (let first = 0; first < 7; first++) {
        if (!on[first]) continue;
        let last = first;
        while (on[last + 1]) last++;
        runs.push(last === first ? (DAYS[first] ?? '') : `${DAYS[first]}${last === first + 1 ? ', ' : '–'}${DAYS[last]}`);
        first = last;
    }
    return runs.join(', ');
}

/** When a task may be done. */
export function windowText(task: Pick<Task, 'fromSecs' | 'untilSecs' | 'everySecs' | 'date' | 'weekdays'>): string {
    const every = task.everySecs ? `, once in each ${lengthOfSecs(task.everySecs)}` : '';
    return `${clockOfSecs(task.fromSecs)}–${clockOfSecs(task.untilSecs || 86_400)}, ${daysText(task)}${every}`;
}

/** The plan that was kept for a local date, `undefined` if none was. */
export async function keptPlan(map: string, date: string, ms: number): Promise<GetPlanResponse | undefined> {
    try {
        return await tasks.getPlan({ map, date, time: toTimestamp(ms) });
    } catch (error) {
        if (ConnectError.from(error).code === Code.NotFound) return undefined;
        throw error;
    }
}
