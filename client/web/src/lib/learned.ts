// What no update has learned yet: of a state, of a map, and in words.
//
// Invariant: observations that wait because they lie in the future are not counted, since an update leaves them.

import type { Map as WireMap, State } from '../wire/tidemap/v1/map_pb';

/** Whether a state has a model: some of its observations were learned. */
export function isLearned({ observations, pending }: Pick<State, 'observations' | 'pending'>): boolean {
    return observations > pending;
}

/** What to write in place of the prediction of a state that was never learned. */
export function unlearnedText({ observations }: Pick<State, 'observations'>): string {
    return observations > 0n ? 'not learned yet' : 'never observed';
}

/** The observations and scans of a map that an update would learn. */
export interface Waiting {
    observations: bigint;
    scans: bigint;
    /** Whether no update has learned anything of the map. */
    isAll: boolean;
}

/** What an update of a map would learn; `undefined`: nothing. */
export function waitingOf(map: Pick<WireMap, 'pendingObservations' | 'aheadObservations' | 'gridSummary' | 'lastUpdate'> | undefined): Waiting | undefined {
    if (!map) return undefined;
    const observations = map.pendingObservations - map.aheadObservations;
    const scans = (map.gridSummary?.pendingScans ?? 0n) - (map.gridSummary?.aheadScans ?? 0n);
    return observations > 0n || scans > 0n ? { observations, scans, isAll: (map.lastUpdate?.generation ?? 0n) === 0n } : undefined;
}

/** The things that wait, in words. */
export function waitingText({ observations, scans }: Waiting): string {
    const many = (count: bigint, what: string) => (count > 0n ? [`${count.toLocaleString('en')} ${what}${count === 1n ? '' : 's'}`] : []);
    return [...many(observations, 'observation'), ...many(scans, 'scan')].join(' and ');
}
