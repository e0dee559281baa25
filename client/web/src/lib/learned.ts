// What no update has learned yet, of a state and in words; the daemon computes it of a map.

import type { NotLearned, State } from '../wire/tidemap/v1/map_pb';

/** Whether a state has a model: some of its observations were learned. */
export function isLearned({ observations, pending }: Pick<State, 'observations' | 'pending'>): boolean {
    return observations > pending;
}

/** What to write in place of the prediction of a state that was never learned. */
export function unlearnedText({ observations }: Pick<State, 'observations'>): string {
    return observations > 0n ? 'not learned yet' : 'never observed';
}

/** The things that wait, in words. */
export function waitingText({ observations, scans }: Pick<NotLearned, 'observations' | 'scans'>): string {
    const many = (count: bigint, what: string) => (count > 0n ? [`${count.toLocaleString('en')} ${what}${count === 1n ? '' : 's'}`] : []);
    return [...many(observations, 'observation'), ...many(scans, 'scan')].join(' and ');
}
