// Colours: the ends, what is not known, and that they can be told apart by their lightness.

import assert from 'node:assert/strict';
import { suite, test } from 'node:test';

import { entropyBits, FULL, gradient, PALETTES, UNKNOWN, viridis } from './colours';

type Layer = keyof typeof PALETTES;

/** Red, green, blue and opacity as a canvas reads an entry. */
function entry(layer: Layer, index: number): number[] {
    return [...new Uint8Array(PALETTES[layer].slice(index, index + 1).buffer)];
}

/** Relative luminance, as WCAG defines it. */
function luminance(layer: Layer, index: number): number {
    const [red = 0, green = 0, blue = 0] = entry(layer, index).map((value) => {
        const share = value / 255;
        return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
    });
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue;
}

/** Whether the lightness of entries only grows, or falls, from one index to another. */
function isMonotone(layer: Layer, from: number, to: number, sign: 1 | -1): boolean {
    for (let index = from + 1; index <= to; index++) {
        if (sign * (luminance(layer, index) - luminance(layer, index - 1)) < -1e-3) return false;
    }
    return sign * (luminance(layer, to) - luminance(layer, from)) > 0.3;
}

const LAYERS = Object.keys(PALETTES) as Layer[];

suite('palettes', () => {
    test('are transparent for what is not known, and for nothing else', () => {
        for (const layer of LAYERS) {
            assert.equal(PALETTES[layer].length, 256);
            assert.deepEqual(entry(layer, UNKNOWN), [0, 0, 0, 0], layer);
            for (let index = 0; index <= FULL; index++) assert.equal(entry(layer, index)[3], 255, `${layer} ${index}`);
        }
    });

    test('begin and end with the ends of their colour maps', () => {
        assert.deepEqual([entry('probability', 0), entry('probability', FULL)], [[68, 1, 84, 255], [253, 231, 37, 255]]);
        assert.deepEqual([entry('seen', 0), entry('seen', FULL)], [[68, 1, 84, 255], [253, 231, 37, 255]]);
        assert.deepEqual([entry('difference', 0), entry('difference', FULL)], [[33, 102, 172, 255], [179, 88, 6, 255]]);
    });

    test('of probability grow lighter with it', () => {
        assert.ok(isMonotone('probability', 0, FULL, 1));
        assert.ok(isMonotone('seen', 0, FULL, 1));
    });

    test('of entropy are lightest at one half, and equal on both sides of it', () => {
        assert.ok(isMonotone('entropy', 0, FULL / 2, 1));
        assert.ok(isMonotone('entropy', FULL / 2, FULL, -1));
        assert.deepEqual(entry('entropy', FULL / 2), [255, 234, 70, 255]);
        assert.deepEqual(entry('entropy', 20), entry('entropy', FULL - 20));
    });

    test('of a difference are grey where there is none', () => {
        assert.deepEqual(entry('difference', FULL / 2), [200, 200, 200, 255]);
    });
});

test('entropy is one bit at one half, and none where all is certain', () => {
    assert.deepEqual([0, 0.5, 1, -0.1, 1.1].map(entropyBits), [0, 1, 0, 0, 0]);
    assert.ok(Math.abs(entropyBits(0.25) - 0.811278) < 1e-6);
});

test('colours of styles are clamped to the ends', () => {
    assert.deepEqual([-3, 0, 0.5, 1, 3].map(viridis), [
        'rgb(68 1 84)', 'rgb(68 1 84)', 'rgb(33 144 141)', 'rgb(253 231 37)', 'rgb(253 231 37)',
    ]);
});

test('a legend has the colours of its layer', () => {
    for (const layer of ['probability', 'seen', 'difference'] as const) {
        for (const index of [0, FULL / 2, FULL]) {
            assert.ok(gradient(layer).includes(`rgb(${entry(layer, index).slice(0, 3).join(' ')})`), `${layer} ${index}`);
        }
    }
    assert.ok(gradient('entropy').endsWith('rgb(255 234 70))'));
});
