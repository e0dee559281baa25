// The hours of four weeks: columns are hours of the clock, also where clocks are changed.

import assert from 'node:assert/strict';
import { afterEach, suite, test } from 'node:test';

import { HOUR, MINUTE } from './civil';
import { queries } from './rpc.svelte';
import { hoursOfDay, loadStrip } from './strip';
import { fromNanos } from './times';

const { predictStates, reconstruct } = queries;
afterEach(() => void Object.assign(queries, { predictStates, reconstruct }));
const at = (text: string) => Date.parse(text);
const clocks = (day: string, zone: string) =>
    hoursOfDay(at(day), zone).map((ms) => new Intl.DateTimeFormat('en-GB', { timeZone: zone, hour: '2-digit', minute: '2-digit' }).format(ms));

suite('hours of a day', () => {
    test('are 24, each where the clock shows it', () => {
        assert.deepEqual(clocks('2025-03-29T00:00Z', 'Europe/London').slice(0, 3), ['00:00', '01:00', '02:00']);
        assert.equal(hoursOfDay(at('2025-03-29T00:00Z'), 'Europe/London').length, 24);
    });

    test('that the clock leaves out begin as the next one', () => {
        assert.deepEqual(clocks('2025-03-30T00:00Z', 'Europe/London').slice(0, 4), ['00:00', '02:00', '02:00', '03:00']);
        // This day begins at one o'clock.
        assert.deepEqual(clocks('2025-09-07T04:00Z', 'America/Santiago').slice(0, 3), ['01:00', '01:00', '02:00']);
    });

    test('that come twice are one of two hours', () => {
        const starts = hoursOfDay(at('2025-10-25T23:00Z'), 'Europe/London');
        assert.deepEqual([1, 2, 3].map((hour) => (starts[hour] ?? 0) - (starts[hour - 1] ?? 0)), [HOUR, 2 * HOUR, HOUR]);
    });
});

test('a strip has what was predicted and observed in the column of its hour', async () => {
    const noon = at('2025-03-30T12:00+01:00');
    let asked: number[] = [];
    Object.assign(queries, {
        predictStates: async function* ({ timesNanos }: { timesNanos: bigint[] }) {
            asked = timesNanos.map(fromNanos);
            yield { stateIndex: 0, axis: 0, probabilities: asked.map((ms) => Number(ms === noon + 30 * MINUTE)) };
        },
        reconstruct: async function* () {
            yield { timesNanos: [BigInt(noon + 5 * MINUTE) * 1_000_000n], values: [1] };
        },
    });
    const strip = await loadStrip('home', 'door', noon, 'Europe/London');
    const day = 24 * 27;
    assert.equal(strip.predicted.findIndex((value) => value === 1), day + 12);
    assert.equal(strip.observed.findIndex((value) => value === 1), day + 12);
    // The hour after one o'clock is left out, and no other.
    assert.deepEqual(strip.predicted.flatMap((value, index) => (value === undefined ? [index] : [])), [day + 1]);
    assert.deepEqual(strip.observed.filter((value) => value !== undefined), [1]);
});
