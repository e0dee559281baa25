// Unusual observations, in words, and the changes that come soon.

import assert from 'node:assert/strict';
import { afterEach, suite, test } from 'node:test';

import { HOUR, MINUTE } from './civil';
import { queries } from './rpc.svelte';
import { changesSoon, intervalText, plain, rangeText, runText, strongestOf, unusualLately, type Unusual } from './unusual';

const NIGHT = Date.parse('2025-03-12T01:00Z');
const { listSurprises, predictStates } = queries;
afterEach(() => void Object.assign(queries, { listSurprises, predictStates }));

suite('words', () => {
    test('for numbers have no digits that say nothing', () => {
        assert.deepEqual([1, 0.034567, 20.25, 1234567, Number.NaN].map((value) => plain(value)), ['1', '0.0346', '20.3', '1230000', '–']);
    });

    test('for a range name the day once where it is one', () => {
        assert.equal(rangeText(NIGHT, NIGHT, 'UTC'), 'Wed 12 Mar 01:00');
        assert.equal(rangeText(NIGHT, NIGHT + 4 * HOUR, 'UTC'), 'Wed 12 Mar 01:00 – 05:00');
        assert.equal(rangeText(NIGHT, NIGHT + 24 * HOUR, 'UTC'), 'Wed 12 Mar 01:00 – Thu 13 Mar 01:00');
    });

    test('for an interval never say that it is certain', () => {
        assert.deepEqual([[0.1234, 0.9, 0.9], [0.00123, 1, 0.9981]].map(([lower = 0, upper = 0, mass = 0]) => intervalText(lower, upper, mass)), ['90 % interval 0.12 – 0.9', 'over 99 % interval 0.0012 – 1']);
    });

    test('for a run say what was seen and what was predicted', () => {
        const run: Unusual = { state: 'door', from: NIGHT, to: NIGHT + HOUR, observations: 3, isAbove: true, value: 1, probability: 0.031, bits: 9 };
        assert.equal(runText(run, 'UTC', true), 'was 1 on Wed 12 Mar 01:00 – 02:00, predicted 0.031');
        assert.match(runText({ ...run, value: 0, probability: 0.9998 }, 'UTC', true), /, predicted over 0.99$/);
        assert.match(runText({ ...run, probability: 0.00002 }, 'UTC', true), /, predicted under 0.001$/);
        assert.equal(runText({ ...run, value: 22.5 }, 'UTC', false), 'was 22.5 on Wed 12 Mar 01:00 – 02:00, above the prediction');
    });
});

test('each state has its strongest run, and a number of others', () => {
    const run = (state: string, bits: number): Unusual => ({ state, bits, from: 0, to: 0, observations: 1, isAbove: true, value: 1, probability: 0 });
    const found = strongestOf([run('door', 9), run('lamp', 8), run('door', 7), run('door', 6)]);
    assert.deepEqual(found.map(({ run, more }) => [run.state, run.bits, more]), [['door', 9, 2], ['lamp', 8, 0]]);
});

test('lately is the week before the newest data, both included', async () => {
    let asked: { fromTime?: { seconds: bigint }; toTime?: { seconds: bigint; nanos: number } } = {};
    Object.assign(queries, {
        listSurprises: (request: typeof asked) => {
            asked = request;
            return Promise.resolve({ surprises: [{ state: 'door', firstTime: { seconds: 5n, nanos: 0 }, observations: 2n, above: true, value: 1, probability: 0.1, bits: 7 }] });
        },
    });
    const [run] = await unusualLately('home', NIGHT);
    assert.deepEqual([run?.from, run?.to, run?.observations, run?.bits], [5000, 5000, 2, 7]);
    assert.equal(Number(asked.toTime?.seconds) - Number(asked.fromTime?.seconds), 7 * 24 * 3600);
    assert.equal(asked.toTime?.nanos, 1_000_000);
});

test('what changes soon is the first crossing within a day; states without one are left out', async () => {
    Object.assign(queries, {
        predictStates: async function* ({ timesNanos }: { timesNanos: bigint[] }) {
            yield { stateIndex: 0, axis: 0, probabilities: timesNanos.map(() => 0.2) };
            yield { stateIndex: 1, axis: 0, probabilities: timesNanos.map((_, index) => (index < 2 ? 0 : 1)) };
        },
    });
    const found = await changesSoon('home', ['still', 'door'], NIGHT);
    assert.deepEqual([...found], [['door', { ms: NIGHT + 30 * MINUTE, isUp: true }]]);
});
