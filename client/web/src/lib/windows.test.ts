// The cells to fetch, and their heights.

import assert from 'node:assert/strict';
import { suite, test } from 'node:test';

import { create } from '@bufbuild/protobuf';

import { CellBoxSchema, GridSchema } from '../wire/tidemap/v1/types_pb';
import { defaultHeights, visibleWindow } from './windows';

const grid = create(GridSchema, { resolutionM: 0.5, originXM: 10, originYM: -20, originZM: 0 });
const large = create(CellBoxSchema, { minX: -5000, minY: -5000, maxX: 5000, maxY: 5000, minZ: 0, maxZ: 8 });
const size = { width: 400, height: 200 };

suite('the visible window', () => {
    test('of a small grid is all of it, wherever the camera is', () => {
        const bounds = create(CellBoxSchema, { minX: -3, minY: 4, maxX: 1021, maxY: 1028 });
        const whole = { minX: -3, minY: 4, maxX: 1021, maxY: 1028 };
        assert.deepEqual(visibleWindow(bounds, grid, { x: 9e9, y: 0, scale: 1 }, size), whole);
        assert.deepEqual(visibleWindow(bounds, grid, { x: 0, y: 0, scale: 0 }, size), whole);
        assert.deepEqual(visibleWindow({ ...bounds, maxY: 1029 }, grid, { x: 10, y: -20, scale: 1 }, size), { minX: -3, minY: 4, maxX: 512, maxY: 256 });
    });

    test('of a large grid holds what the camera sees, on multiples of 128', () => {
        // From x = -190 m to 210 m and y = -120 m to 80 m: cells -400 to 400 and -200 to 200.
        assert.deepEqual(visibleWindow(large, grid, { x: 10, y: -20, scale: 1 }, size), { minX: -512, minY: -256, maxX: 512, maxY: 256 });
    });

    test('stays as it is while the camera moves a little, and moves with it at last', () => {
        const seen = (x: number) => visibleWindow(large, grid, { x, y: -20, scale: 1 }, size);
        assert.deepEqual(seen(12), seen(10));
        assert.deepEqual(seen(74), { minX: -384, minY: -256, maxX: 640, maxY: 256 });
    });

    test('is cut where the grid ends', () => {
        const seen = visibleWindow(large, grid, { x: 10 + 2500, y: -20 + 2500, scale: 1 }, size);
        assert.deepEqual(seen, { minX: 4480, minY: 4736, maxX: 5000, maxY: 5000 });
    });

    test('is none beside the grid, without a size, and where too much is visible', () => {
        assert.equal(visibleWindow(large, grid, { x: 90_000, y: 0, scale: 1 }, size), undefined);
        assert.equal(visibleWindow(large, grid, { x: 10, y: -20, scale: 0 }, size), undefined);
        assert.equal(visibleWindow(large, grid, { x: 10, y: -20, scale: 0.05 }, size), undefined);
    });
});

suite('heights at first', () => {
    const heights = (originZM: number, minZ: number, maxZ: number, isFlat = false) =>
        defaultHeights({ ...grid, originZM, flat: isFlat }, { ...large, minZ, maxZ });

    test('leave out the floor and the ceiling', () => {
        assert.deepEqual(heights(-0.5, 0, 8), { low: 0.1, high: 1.8 });
        assert.deepEqual(heights(0.25, 0, 2), { low: 0.25, high: 1.25 });
    });

    test('are all of a grid that is flat, thin, or lies elsewhere', () => {
        assert.deepEqual(heights(0, 0, 2), { low: 0, high: 1 });
        assert.deepEqual(heights(0, 0, 1, true), { low: 0, high: 0.5 });
        assert.deepEqual(heights(3, 0, 8), { low: 3, high: 7 });
        assert.deepEqual(heights(-4, 0, 8), { low: -4, high: 0 });
    });
});
