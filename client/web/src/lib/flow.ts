// Flows of people: how many detections are expected in the cells of a raster, and where they go.
//
// Invariant: directions are radians from the x axis, counter-clockwise, from -π to below π.

import type { State } from '../wire/tidemap/v1/map_pb';
import { StateKind } from '../wire/tidemap/v1/types_pb';
import type { Extent } from './extent';

/** The states of a flow: positions, and their directions. */
export interface FlowStates {
    positions: string;
    directions: string;
}

/** A cell with detections. */
export interface FlowCell {
    column: number;
    row: number;
    /** Expected number of detections. */
    count: number;
    /** Probabilities of the directions. */
    shares: number[];
}

/** The expected flow at a time. */
export interface Flow {
    /** Lower corner of the raster, and the edge of its cells, metres. */
    lowX: number;
    lowY: number;
    edge: number;
    columns: number;
    rows: number;
    /** Number of detections that the model was trained on. */
    detections: bigint;
    cells: FlowCell[];
}

/** The likeliest direction of a part of a flow. */
export interface FlowArrow {
    /** The mean position of its detections, and its edge, metres. */
    x: number;
    y: number;
    size: number;
    angle: number;
    share: number;
}

/** The parameters of drawing a flow. */
export interface FlowLayer {
    flow: Flow;
    /** The number of detections that has the darkest shade. */
    top: number;
    /** Whether nothing lies below it. */
    isAlone: boolean;
}

/** The smallest value for the darkest shade: nights without people stay light. */
const TOP_MIN = 0.1;
/** A cell with less than this share of the darkest shade has no arrow. */
const ARROW_MIN = 0.05;
const DIRECTIONAL = /heading|direction|velocity|motion/i;

/** Vectors that can be the positions of a flow; those with values like directions come last. */
export function positionStates(states: State[]): string[] {
    const names = states.filter((state) => state.kind === StateKind.VECTOR).map((state) => state.name);
    return names.sort((a, b) => Number(DIRECTIONAL.test(a)) - Number(DIRECTIONAL.test(b)));
}

/** States that can be the directions of positions. */
export function directionStates(states: State[], positions: string): string[] {
    const kinds = [StateKind.VECTOR, StateKind.ANGLE];
    return states.filter((state) => kinds.includes(state.kind) && state.name !== positions).map((state) => state.name);
}

/** The name of the state that probably has the directions; empty if no name shows this. */
export function proposedDirections(candidates: string[]): string {
    return candidates.find((name) => DIRECTIONAL.test(name)) ?? '';
}

/** A round number that no cell exceeds: a scale that stays constant while numbers change a little. */
export function scaleTop(cells: FlowCell[]): number {
    const highest = cells.reduce((high, cell) => Math.max(high, cell.count), TOP_MIN);
    const power = Math.floor(Math.log10(highest) + 1e-9);
    const steps = [1, 1.5, 2, 3, 5, 7, 10].map((step) => Number(`${step}e${power}`));
    return steps.find((step) => highest <= step * (1 + 1e-9)) ?? highest;
}

/** The likeliest of some directions, and its probability. */
export function likeliest(shares: number[]): { angle: number; share: number } {
    const share = shares.reduce((high, one) => Math.max(high, one), 0);
    const angle = (2 * Math.PI * Math.max(0, shares.lastIndexOf(share))) / Math.max(1, shares.length);
    return { angle: angle < Math.PI ? angle : angle - 2 * Math.PI, share };
}

/** Arrows of a flow, one for each square of `along` cells along its edge. */
export function arrowsOf({ flow, top }: FlowLayer, along: number): FlowArrow[] {
    const squares = new Map<string, { x: number; y: number; highest: number; counts: number[] }>();
    for (const cell of flow.cells) {
        const { count, shares } = cell;
        const { x, y } = middleOf(flow, cell);
        const key = `${Math.floor(cell.column / along)} ${Math.floor(cell.row / along)}`;
        const square = squares.get(key) ?? { x: 0, y: 0, highest: 0, counts: shares.map(() => 0) };
        square.highest = Math.max(square.highest, count);
        [square.x, square.y] = [square.x + count * x, square.y + count * y];
        for (const [index, share] of shares.entries()) square.counts[index] = (square.counts[index] ?? 0) + count * share;
        squares.set(key, square);
    }
    const size = along * flow.edge;
    return [...squares.values()]
        .filter(({ highest }) => highest >= ARROW_MIN * top)
        .map(({ x, y, counts }) => {
            const all = counts.reduce((sum, count) => sum + count, 0);
            return { x: x / all, y: y / all, size, ...likeliest(counts.map((count) => count / all)) };
        });
}

/** The middle of a cell, metres. */
export function middleOf({ lowX, lowY, edge }: Flow, { column, row }: FlowCell): { x: number; y: number } {
    return { x: lowX + (column + 0.5) * edge, y: lowY + (row + 0.5) * edge };
}

/** The cell at a point in metres, if any detections are expected there. */
export function flowAt(flow: Flow, x: number, y: number): FlowCell | undefined {
    const [column, row] = [Math.floor((x - flow.lowX) / flow.edge), Math.floor((y - flow.lowY) / flow.edge)];
    return flow.cells.find((cell) => cell.column === column && cell.row === row);
}

/** The number of detections of all cells. */
export function flowTotal(flow: Flow): number {
    return flow.cells.reduce((sum, cell) => sum + cell.count, 0);
}

/** A number of detections in few digits. */
export function countText(count: number): string {
    return count >= 100 ? Math.round(count).toLocaleString('en') : count >= 10 ? count.toFixed(1) : count.toFixed(2);
}

/** The expectation in a cell, in words. */
export function cellText({ count, shares }: FlowCell): string {
    const { angle, share } = likeliest(shares);
    const arrow = [...'→↗↑↖←↙↓↘'][(Math.round(angle / (Math.PI / 4)) + 8) % 8];
    return `${countText(count)} detections, ${arrow} ${(share * 100).toFixed(0)} %`;
}

/** The rectangle of the raster, metres. */
export function flowExtent({ lowX, lowY, edge, columns, rows }: Flow): Extent {
    return { minX: lowX, minY: lowY, maxX: lowX + columns * edge, maxY: lowY + rows * edge };
}
