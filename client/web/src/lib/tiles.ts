// The cells of a predicted tile.
//
// Invariant: this is the only reader of tiles in the page; each known cell has one value. A cell that no update has
// learned is one half, and is told apart from a learned one: that is one half only where it has changed.

import type { PredictedTile } from '../wire/tidemap/v1/query_pb';

/** Cells along an edge of a tile. */
export const TILE = 8;

/** A cell that was seen, and that no update has learned. */
const UNLEARNED = 0.5;

/** Gives each known cell of a tile to `take`: its place, x fastest, then y, then z, its value, and whether an update
 * has learned it. */
export function eachCell(tile: PredictedTile, take: (place: number, value: number, isLearned: boolean) => void): void {
    const { known, changed, high, values, allValues, staticLow, staticHigh } = tile;
    let next = 0;
    for (let row = 0; row < known.length; row++) {
        const bits = known[row] ?? 0;
        if (bits === 0) continue;
        const [moving, above] = [changed[row] ?? 0, high[row] ?? 0];
        for (let column = 0; column < TILE; column++) {
            const bit = 1 << column;
            if ((bits & bit) === 0) continue;
            const value = allValues || moving & bit ? (values[next++] ?? 0) : above & bit ? staticHigh : staticLow;
            take(row * TILE + column, value, !allValues || (moving & bit) !== 0 || value !== UNLEARNED);
        }
    }
}
