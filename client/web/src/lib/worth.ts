// Whether an update of a map is worth it.

import type { Statistic } from '../wire/tidemap/v1/maintenance_pb';

/** The daemon's counts of pending observations, in words; empty if nothing is pending that can be judged. */
export function worthText(statistics: readonly Pick<Statistic, 'name' | 'value'>[]): string {
    const of = (name: string) => statistics.find((one) => one.name === name)?.value;
    const [judged, error, usual, gain] = [of('pending_judged'), of('pending_error'), of('usual_error'), of('update_gain')];
    if (!judged || error === undefined || usual === undefined || gain === undefined) return '';
    return `error ${error.toFixed(3)}, usually ${usual.toFixed(3)}: ${gain.toFixed(3)} to gain`;
}
