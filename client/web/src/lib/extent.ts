// Rectangles on a map, in metres.

/** A rectangle, metres. */
export interface Extent {
    minX: number;
    minY: number;
    maxX: number;
    maxY: number;
}
