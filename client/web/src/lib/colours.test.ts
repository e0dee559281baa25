// Colours: the same as in all other pictures, free white, occupied black, unknown grey, and walls in every layer.

import assert from 'node:assert/strict';
import { suite, test } from 'node:test';

import { colourOf, entropyBits, FULL, gradient, levelsOf, occupancy, paletteOf, unknown, SURE, UNKNOWN, type Layer } from './colours';
import { SAMPLES } from './palette';
import { onPaper, setDark } from './scheme.svelte';

const LAYERS: Layer[] = ['probability', 'entropy', 'difference', 'seen'];

/** Red, green, blue and opacity as a canvas reads the pixel of a cell. */
function entry(layer: Layer, now: number, before = now, levels = SURE): number[] {
    const index = layer === 'difference' ? 256 * before + now : now;
    return [...new Uint8Array(paletteOf(layer, levels).slice(index, index + 1).buffer)];
}

suite('colours', () => {
    test('are those of the pictures of the daemon', () => {
        for (const layer of ['probability', 'entropy', 'difference'] as const) {
            for (const [value, beneath, colour] of SAMPLES[layer]) {
                assert.deepEqual(colourOf(layer, value, beneath), colour, `${layer} ${value} over ${beneath}`);
            }
        }
    });

    test('of styles are clamped to the ends', () => {
        assert.deepEqual([-3, 0, 1, 3].map(occupancy), ['rgb(255 255 255)', 'rgb(255 255 255)', 'rgb(0 0 0)', 'rgb(0 0 0)']);
        assert.equal(occupancy(Number.NaN), 'rgb(255 255 255)');
    });
});

suite('a dark ground', () => {
    test('has the same colours in the other order, and an unknown grey of its own', () => {
        const light = [0, 0.25, 0.5, 1].map(occupancy);
        const grey = unknown();
        setDark(true);
        assert.deepEqual([1, 0.75, 0.5, 0].map(occupancy), light);
        assert.deepEqual([0, FULL].map((cell) => entry('probability', cell)), [[0, 0, 0, 255], [255, 255, 255, 255]]);
        assert.ok(![occupancy(0), occupancy(1), grey].includes(unknown()));
        // Files are for white paper.
        assert.equal(onPaper(() => occupancy(1)), 'rgb(0 0 0)');
        setDark(false);
    });
});

suite('palettes', () => {
    test('show free white, occupied black and unknown grey', () => {
        for (const layer of ['probability', 'seen'] as const) {
            assert.deepEqual([0, FULL, UNKNOWN].map((cell) => entry(layer, cell)), [[255, 255, 255, 255], [0, 0, 0, 255], [205, 205, 205, 255]]);
        }
    });

    test('keep walls dark and floors white in every layer, and unknown grey', () => {
        for (const layer of LAYERS) {
            assert.deepEqual(entry(layer, 0), [255, 255, 255, 255], layer);
            assert.ok(entry(layer, FULL).slice(0, 3).every((band) => band < 64), layer);
            assert.deepEqual(entry(layer, UNKNOWN), [205, 205, 205, 255], layer);
        }
        assert.deepEqual(entry('difference', 0, UNKNOWN), [205, 205, 205, 255]);
        assert.deepEqual(entry('difference', UNKNOWN, 0), [205, 205, 205, 255]);
    });

    test('have their levels white and black where the sensor is poor', () => {
        const levels = { free: 0.3, occupied: 0.7 };
        const [low, high] = [Math.round(0.3 * FULL), Math.round(0.7 * FULL)];
        assert.deepEqual([low, high].map((cell) => entry('probability', cell, cell, levels).slice(0, 3)), [[255, 255, 255], [0, 0, 0]]);
    });

    test('know the levels of a sensor', () => {
        assert.deepEqual(levelsOf({ hit: 1, falseAlarm: 0, prior: 0 }), SURE);
        const { free, occupied } = levelsOf({ hit: 0.8, falseAlarm: 0.2, prior: 0.5 });
        assert.ok(Math.abs(free - 0.2) < 1e-12 && Math.abs(occupied - 0.8) < 1e-12);
    });

    test('show uncertainty most at one half, and a difference in the colour of its direction', () => {
        const [red = 0, , blue = 0] = entry('entropy', FULL / 2);
        assert.ok(blue > red + 100);
        const [freer, fuller] = [entry('difference', 0, FULL), entry('difference', FULL, 0)];
        assert.ok((freer[2] ?? 0) > (freer[0] ?? 0) + 100 && (fuller[0] ?? 0) > (fuller[2] ?? 0) + 100);
    });
});

test('entropy is one bit at one half, and none where all is certain', () => {
    assert.deepEqual([0, 0.5, 1, -0.1, 1.1].map(entropyBits), [0, 1, 0, 0, 0]);
    assert.ok(Math.abs(entropyBits(0.25) - 0.811278) < 1e-6);
});

test('a legend has the ends of its layer', () => {
    assert.match(gradient('probability'), /right, rgb\(255 255 255\).*rgb\(0 0 0\)\)$/);
    const ends = (layer: Layer, low: number, high: number) =>
        [low, high].map((value) => `rgb(${colourOf(layer, value, 0).join(' ')})`);
    for (const [layer, low] of [['entropy', 0], ['difference', -1]] as const) {
        const [first = '', last = ''] = ends(layer, low, 1);
        assert.ok(gradient(layer).includes(`right, ${first}`) && gradient(layer).endsWith(`${last})`), layer);
    }
});
