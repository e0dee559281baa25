// Flows of people: which states make one, its scale, its arrows, and its words.

import assert from 'node:assert/strict';
import { suite, test } from 'node:test';

import { create } from '@bufbuild/protobuf';

import { StateSchema } from '../wire/tidemap/v1/map_pb';
import { StateKind } from '../wire/tidemap/v1/types_pb';
import { arrowsOf, cellText, countText, directionStates, flowAt, flowExtent, flowTotal, likeliest, positionStates, proposedDirections, scaleTop, type Flow, type FlowCell } from './flow';

const state = (name: string, kind: StateKind) => create(StateSchema, { name, kind });
const states = [
    state('door', StateKind.PROBABILITY), state('heading', StateKind.ANGLE), state('people', StateKind.VECTOR),
    state('velocity', StateKind.VECTOR), state('wind', StateKind.ANGLE),
];

const cell = (column: number, row: number, count: number, shares = [1, 0, 0, 0]): FlowCell => ({ column, row, count, shares });
const flowOf = (...cells: FlowCell[]): Flow => ({ lowX: -2, lowY: 1, edge: 0.5, columns: 8, rows: 4, detections: 9n, cells });

suite('the states of a flow', () => {
    test('are vectors as positions, those that look like directions last', () => {
        const all = [state('motion', StateKind.VECTOR), ...states];
        assert.deepEqual(positionStates(all), ['people', 'motion', 'velocity']);
    });

    test('are angles and other vectors as directions', () => {
        assert.deepEqual(directionStates(states, 'people'), ['heading', 'velocity', 'wind']);
        assert.deepEqual(directionStates(states, 'velocity'), ['heading', 'people', 'wind']);
    });

    test('are proposed by a name that says heading, direction, velocity or motion', () => {
        for (const name of ['Heading', 'direction-2', 'people velocity', 'MOTION']) assert.equal(proposedDirections(['wind', name]), name);
        assert.equal(proposedDirections(['wind', 'people']), '');
    });
});

suite('the scale', () => {
    test('ends at a round number that no cell exceeds', () => {
        const tops = [0.3, 0.31, 1.01, 2.12, 5, 99, 100, 101].map((count) => scaleTop([cell(0, 0, 0), cell(1, 0, count)]));
        assert.deepEqual(tops, [0.3, 0.5, 1.5, 3, 5, 100, 100, 150]);
    });

    test('stays where it is when nobody is expected', () => {
        assert.deepEqual([scaleTop([]), scaleTop([cell(0, 0, 0.0001)])], [0.1, 0.1]);
    });
});

suite('arrows', () => {
    const layer = (...cells: FlowCell[]) => ({ flow: flowOf(...cells), top: 10, isAlone: false });

    test('have the likeliest direction, from -π to below π', () => {
        assert.deepEqual(likeliest([0.1, 0.7, 0.1, 0.1]), { angle: Math.PI / 2, share: 0.7 });
        assert.deepEqual(likeliest([0, 0, 1, 0]), { angle: -Math.PI, share: 1 });
        assert.deepEqual(likeliest([0, 0, 0.4, 0.6]), { angle: -Math.PI / 2, share: 0.6 });
    });

    test('stand in the middle of their cells', () => {
        assert.deepEqual(arrowsOf(layer(cell(3, 1, 10)), 1), [{ x: -0.25, y: 1.75, size: 0.5, angle: 0, share: 1 }]);
    });

    test('are left out where hardly anybody is expected', () => {
        assert.equal(arrowsOf(layer(cell(0, 0, 0.49), cell(1, 0, 0.51), cell(2, 0, 0)), 1).length, 1);
    });

    test('of small cells are one, where their detections are, by the sum of their directions', () => {
        const [arrow, ...others] = arrowsOf(layer(cell(0, 0, 1, [1, 0, 0, 0]), cell(1, 1, 3, [0, 1, 0, 0]), cell(2, 0, 0.1)), 2);
        assert.deepEqual([arrow, others], [{ x: -1.375, y: 1.625, size: 1, angle: Math.PI / 2, share: 0.75 }, []]);
    });
});

suite('a flow', () => {
    const flow = flowOf(cell(0, 0, 1.25), cell(7, 3, 30, [0, 0, 0.02, 0.98]));

    test('covers its raster', () => {
        assert.deepEqual(flowExtent(flow), { minX: -2, minY: 1, maxX: 2, maxY: 3 });
    });

    test('has the cell at a point, if anybody is expected there', () => {
        assert.deepEqual([flowAt(flow, -1.51, 1.49), flowAt(flow, 1.5, 2.5)], flow.cells);
        assert.equal(flowAt(flow, -1.49, 1.2), undefined);
    });

    test('is said in numbers that can be read', () => {
        assert.deepEqual([1.25, 31.25, 1234.5].map(countText), ['1.25', '31.3', '1,235']);
        assert.equal(flowTotal(flow), 31.25);
        assert.deepEqual(flow.cells.map(cellText), ['1.25 detections, → 100 %', '30.0 detections, ↓ 98 %']);
        assert.match(cellText(cell(0, 0, 1, [0, 0, 1, 0])), /←/);
    });
});
