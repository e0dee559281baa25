// Pictures of a grid at times: fetched for the visible part, kept within a bound, blended while they play.
//
// Invariant: a frame is one byte a cell, rows from south to north, and does not change once it is made. All frames
// together stay below `KEPT_MAX_BYTES`.

import type { GridHeader, PredictedTile } from '../wire/tidemap/v1/query_pb';
import { ModelKind } from '../wire/tidemap/v1/types_pb';
import { FULL, UNKNOWN } from './colours';
import { queries } from './rpc.svelte';
import { eachCell, TILE } from './tiles';
import { toTimestamp } from './times';

/** Memory of all frames. */
const KEPT_MAX_BYTES = 24 * 1024 * 1024;

/** Cells from `minX`, `minY` up to but not including `maxX`, `maxY`. */
export interface Window2d {
    minX: number;
    minY: number;
    maxX: number;
    maxY: number;
}

/** The content to show, apart from the time. */
export interface GridQuery {
    map: string;
    window: Window2d;
    minZ: number;
    maxZ: number;
    /** The last readings instead of a forecast. */
    isLatest: boolean;
    /** Whether columns that no update has learned keep their forecast of one half; else they are as last seen. */
    isBare?: boolean;
    /** Changes when there is something new to show. */
    generation: string;
}

/** The probabilities of the columns of a window at a time. */
export interface Frame extends Window2d {
    cells: Uint8Array;
    /** The cells of another time, to show the difference from it. */
    before?: Uint8Array;
    /** 1 at the columns that no update has learned; absent: there are none. */
    unlearned?: Uint8Array;
}

/** The numbers of columns of a frame that no update has learned, and of those that one has. */
export function learnedCounts({ cells, unlearned }: Frame): { unlearned: number; learned: number } {
    let [without, known] = [0, 0];
    for (const cell of cells) if (cell !== UNKNOWN) known++;
    for (const mark of unlearned ?? []) without += mark;
    return { unlearned: without, learned: known - without };
}

function keyOf(query: GridQuery, ms: number): string {
    const { map, window: at, minZ, maxZ, isLatest, isBare, generation } = query;
    return JSON.stringify([map, at.minX, at.minY, at.maxX, at.maxY, minZ, maxZ, isLatest, isBare, generation, isLatest ? 0 : ms]);
}

const quantised = (value: number) => Math.round(Math.min(1, Math.max(0, value)) * FULL);

/** Paints a tile; the columns that are not learned are marked, and their number is returned. */
function paint(frame: Frame, tile: PredictedTile, unlearned: Uint8Array): number {
    const [width, height] = [frame.maxX - frame.minX, frame.maxY - frame.minY];
    const [left, bottom] = [tile.x * TILE - frame.minX, tile.y * TILE - frame.minY];
    let count = 0;
    eachCell(tile, (place, value, isLearned) => {
        const [x, y] = [left + (place % TILE), bottom + Math.floor(place / TILE)];
        if (x < 0 || x >= width || y < 0 || y >= height) return;
        frame.cells[y * width + x] = quantised(value);
        if (isLearned) return;
        unlearned[y * width + x] = 1;
        count++;
    });
    return count;
}

async function load(query: GridQuery, ms: number, signal?: AbortSignal): Promise<Frame> {
    const { window: at } = query;
    const cells = new Uint8Array((at.maxX - at.minX) * (at.maxY - at.minY)).fill(UNKNOWN);
    const frame: Frame = { ...at, cells };
    const unlearned = new Uint8Array(cells.length);
    let count = 0;
    const request = {
        map: query.map,
        time: toTimestamp(ms),
        model: query.isLatest ? { kind: ModelKind.LATEST } : undefined,
        region: { ...at, minZ: query.minZ, maxZ: query.maxZ },
        project: true,
    };
    for await (const answer of queries.predictGrid(request, { signal })) {
        if (answer.message.case === 'page') for (const tile of answer.message.value.tiles) count += paint(frame, tile, unlearned);
    }
    if (count === 0 || query.isLatest) return frame;
    frame.unlearned = unlearned;
    // A forecast of one half everywhere shows nothing: what was seen there last shows the building.
    if (!query.isBare) {
        const seen = await frameAt({ ...query, isLatest: true }, ms);
        for (const [index, mark] of unlearned.entries()) if (mark) cells[index] = seen.cells[index] ?? UNKNOWN;
    }
    return frame;
}

/** Frames by their content, the least used first. */
const kept = new Map<string, Frame>();
const coming = new Map<string, Promise<Frame>>();
let keptBytes = 0;

function keep(key: string, frame: Frame): void {
    kept.set(key, frame);
    keptBytes += frame.cells.length;
    for (const [oldest, old] of kept) {
        if (keptBytes <= KEPT_MAX_BYTES || oldest === key) break;
        kept.delete(oldest);
        keptBytes -= old.cells.length;
    }
}

/** A frame that is here already. */
export function keptFrame(query: GridQuery, ms: number): Frame | undefined {
    const key = keyOf(query, ms);
    const found = kept.get(key);
    if (found) {
        kept.delete(key);
        kept.set(key, found);
    }
    return found;
}

/** A frame, from here or from the daemon. Requests for the same frame become one. */
export function frameAt(query: GridQuery, ms: number): Promise<Frame> {
    const found = keptFrame(query, ms);
    if (found) return Promise.resolve(found);
    const key = keyOf(query, ms);
    let answer = coming.get(key);
    if (!answer) {
        answer = load(query, ms)
            .then((frame) => {
                keep(key, frame);
                return frame;
            })
            .finally(() => coming.delete(key));
        coming.set(key, answer);
    }
    return answer;
}

/** Number of frames that were requested and have not come. */
export function comingFrames(): number {
    return coming.size;
}

/** The header that the daemon sends for a whole grid, without the cells. */
export async function gridHeader(map: string, ms: number): Promise<GridHeader | undefined> {
    for await (const answer of queries.predictGrid({ map, time: toTimestamp(ms), estimateOnly: true })) {
        if (answer.message.case === 'header') return answer.message.value;
    }
    return undefined;
}

/** The frame between two, at `share` of the way. */
export function blend(from: Frame, to: Frame, share: number, into?: Uint8Array): Frame {
    const cells = into?.length === from.cells.length ? into : new Uint8Array(from.cells.length);
    const [a, b] = [from.cells, to.cells];
    const weight = Math.round(share * 256);
    for (let index = 0; index < cells.length; index++) {
        const low = a[index] as number;
        const high = b[index] as number;
        cells[index] = low === high || high === UNKNOWN ? low : low === UNKNOWN ? high : low + (((high - low) * weight) >> 8);
    }
    return { ...from, cells };
}

/**
 * The probability of the column at a cell, or how much more probable it is than before where the frame shows that;
 * `undefined` where nothing is known.
 */
export function valueAt(frame: Frame, x: number, y: number): number | undefined {
    if (x < frame.minX || x >= frame.maxX || y < frame.minY || y >= frame.maxY) return undefined;
    const index = (y - frame.minY) * (frame.maxX - frame.minX) + x - frame.minX;
    const [now, before] = [frame.cells[index] ?? UNKNOWN, frame.before ? (frame.before[index] ?? UNKNOWN) : 0];
    return now === UNKNOWN || before === UNKNOWN ? undefined : (now - before) / FULL;
}

/** Gives each known column of a frame to `take`, with the result of `valueAt`. */
export function eachKnown(frame: Frame, take: (x: number, y: number, value: number) => void): void {
    for (let y = frame.minY; y < frame.maxY; y++) {
        for (let x = frame.minX; x < frame.maxX; x++) {
            const value = valueAt(frame, x, y);
            if (value !== undefined) take(x, y, value);
        }
    }
}
