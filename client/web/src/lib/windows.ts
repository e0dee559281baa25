// The cells to fetch for the visible part.

import type { CellBox, Grid } from '../wire/tidemap/v1/types_pb';
import type { Window2d } from './frames';
import type { Camera } from './plan';

/** A grid of at most this many columns is fetched as a whole. */
const WHOLE_MAX = 1 << 20;
/** At most this many columns are fetched at a time. */
const COLUMNS_MAX = 1 << 22;
/** Edges of windows lie on multiples of this, so that small moves need nothing new. */
const STEP = 128;
/** Heights that matter to a robot, metres above the map's z = 0; the floor and the ceiling are always occupied. */
const LOW_M = 0.1;
const HIGH_M = 1.8;
/** A grid of at most this height, metres, is shown whole: it can have all its cells in the lowest layer. */
const THIN_M = 1;

/** The window to fetch; `undefined` if too many cells are visible. */
export function visibleWindow(bounds: CellBox, grid: Grid | undefined, camera: Camera, size: { width: number; height: number }): Window2d | undefined {
    const { minX, minY, maxX, maxY } = bounds;
    const whole = { minX, minY, maxX, maxY };
    if ((maxX - minX) * (maxY - minY) <= WHOLE_MAX || !grid) return whole;
    if (!camera.scale) return undefined;
    const [halfWidth, halfHeight] = [size.width / 2 / camera.scale, size.height / 2 / camera.scale];
    const cell = (metres: number, origin: number) => (metres - origin) / grid.resolutionM;
    const down = (value: number) => Math.floor(value / STEP) * STEP;
    const up = (value: number) => Math.ceil(value / STEP) * STEP;
    const seen = {
        minX: Math.max(minX, down(cell(camera.x - halfWidth, grid.originXM))),
        maxX: Math.min(maxX, up(cell(camera.x + halfWidth, grid.originXM))),
        minY: Math.max(minY, down(cell(camera.y - halfHeight, grid.originYM))),
        maxY: Math.min(maxY, up(cell(camera.y + halfHeight, grid.originYM))),
    };
    if (seen.maxX <= seen.minX || seen.maxY <= seen.minY) return undefined;
    return (seen.maxX - seen.minX) * (seen.maxY - seen.minY) <= COLUMNS_MAX ? seen : undefined;
}

/** The heights to show at first, metres: where a robot drives, without floor and ceiling. */
export function defaultHeights(grid: Grid, bounds: CellBox): { low: number; high: number } {
    const metres = (layer: number) => grid.originZM + layer * grid.resolutionM;
    const [bottom, top] = [metres(bounds.minZ), metres(bounds.maxZ)];
    const round = (value: number) => Math.round(value * 100) / 100;
    if (grid.flat || top - bottom <= THIN_M || bottom >= HIGH_M || top <= LOW_M) return { low: round(bottom), high: round(top) };
    return { low: round(Math.max(bottom, LOW_M)), high: round(Math.min(top, HIGH_M)) };
}
