// Frames: how tiles are read, which are kept, and how two frames become one.

import assert from 'node:assert/strict';
import { mock, suite, test } from 'node:test';

import { create, type MessageInitShape } from '@bufbuild/protobuf';

import { PredictGridResponseSchema, type PredictedTileSchema } from '../wire/tidemap/v1/query_pb';
import { ModelKind } from '../wire/tidemap/v1/types_pb';
import { FULL, UNKNOWN } from './colours';
import { blend, comingFrames, frameAt, gridHeader, keptFrame, learnedCounts, valueAt, type Frame, type GridQuery } from './frames';
import { queries } from './rpc.svelte';

type Tile = MessageInitShape<typeof PredictedTileSchema>;
type Request = Parameters<typeof queries.predictGrid>[0];

const NONE = new Uint8Array(8);
const bytes = (...rows: number[]) => Uint8Array.of(...rows, ...NONE).slice(0, 8);

/** Makes the daemon answer with pages of tiles; returns its requests. */
function answer(...pages: Tile[][]): Request[] {
    const asked: Request[] = [];
    mock.method(queries, 'predictGrid', async function* (request: Request) {
        asked.push(request);
        await Promise.resolve();
        yield create(PredictGridResponseSchema, { message: { case: 'header', value: { tiles: 7n } } });
        for (const tiles of pages) yield create(PredictGridResponseSchema, { message: { case: 'page', value: { tiles } } });
    });
    return asked;
}

let generation = 0;
function query(changes: Partial<GridQuery> = {}): GridQuery {
    const window = { minX: 0, minY: 0, maxX: 8, maxY: 8 };
    return { map: 'home', window, minZ: 0, maxZ: 4, isLatest: false, generation: `${generation++}`, ...changes };
}

/** The cells of a frame that are known, as `[x, y, value]`. */
function known(frame: Frame): number[][] {
    const width = frame.maxX - frame.minX;
    return [...frame.cells.entries()]
        .filter(([, value]) => value !== UNKNOWN)
        .map(([index, value]) => [frame.minX + (index % width), frame.minY + Math.floor(index / width), value]);
}

function frame(...cells: number[]): Frame {
    return { minX: 0, minY: 0, maxX: cells.length, maxY: 1, cells: Uint8Array.from(cells) };
}

suite('tiles', () => {
    test('give unchanged cells the value of their side, and changed ones their own, in the order of places', async () => {
        // Row 0: places 0 to 3 are known, 1 and 3 have changed, 2 is high. Row 2: place 7 is known and has changed.
        const tile = {
            x: 0, y: 0, known: bytes(0b1111, 0, 0x80), changed: bytes(0b1010, 0, 0x80), high: bytes(0b0100),
            staticHigh: 1, staticLow: 0, values: [0.5, 0.25, 0.75],
        };
        answer([tile]);
        const found = await frameAt(query(), 0);
        assert.deepEqual(known(found), [[0, 0, 0], [1, 0, 127], [2, 0, FULL], [3, 0, 64], [7, 2, 191]]);
    });

    test('with all values take each known cell from them', async () => {
        const tile = {
            x: 0, y: 0, known: bytes(0b101), changed: NONE, high: bytes(0b1), staticHigh: 1, values: [0.5, 1], allValues: true,
        };
        answer([tile]);
        assert.deepEqual(known(await frameAt(query(), 0)), [[0, 0, 127], [2, 0, FULL]]);
    });

    test('that no update has learned are as last seen, and marked', async () => {
        // Places 0 to 3 are known. The forecast of 0 and 2 is one half, and 2 has changed: only 0 was never learned.
        const forecast = { x: 0, y: 0, known: bytes(0b1111), changed: bytes(0b0100), values: [0.5, 1, 0.5, 0.25], allValues: true };
        const seen = { x: 0, y: 0, known: bytes(0b1111), changed: bytes(0b0100), high: bytes(0b0001), staticHigh: 1, staticLow: 0, values: [1] };
        const asked: Request[] = [];
        mock.method(queries, 'predictGrid', async function* (request: Request) {
            asked.push(request);
            await Promise.resolve();
            const tiles = [request.model?.kind === ModelKind.LATEST ? seen : forecast];
            yield create(PredictGridResponseSchema, { message: { case: 'page', value: { tiles } } });
        });
        const mixed = query();
        const found = await frameAt(mixed, 0);
        assert.deepEqual(known(found), [[0, 0, FULL], [1, 0, FULL], [2, 0, 127], [3, 0, 64]]);
        assert.deepEqual([asked.length, learnedCounts(found)], [2, { unlearned: 1, learned: 3 }]);
        // The uncertainty of what was not learned is that of one half.
        const bare = await frameAt({ ...mixed, isBare: true }, 0);
        assert.deepEqual([known(bare)[0], bare.unlearned?.[0]], [[0, 0, 127], 1]);
        // Another time has the same last readings.
        await frameAt(mixed, 1000);
        assert.equal(asked.length, 4);
    });

    test('that are all learned need one request, and have no marks', async () => {
        const asked = answer([{ x: 0, y: 0, known: bytes(0b11), values: [0.25, 1], allValues: true }]);
        const found = await frameAt(query(), 0);
        assert.deepEqual([asked.length, found.unlearned, learnedCounts(found)], [1, undefined, { unlearned: 0, learned: 2 }]);
    });

    test('are clipped to the window, and each lies at its place', async () => {
        const full = new Uint8Array(8).fill(0xff);
        const tiles = (values: [number, number, number][]) =>
            values.map(([x, y, staticLow]) => ({ x, y, known: full, changed: NONE, high: NONE, staticLow }));
        // Two pages around the corner of four tiles.
        answer(tiles([[-1, -1, 0], [0, -1, 0.25]]), tiles([[-1, 0, 0.5], [0, 0, 1], [5, 5, 0.9]]));
        const found = await frameAt(query({ window: { minX: -2, minY: -1, maxX: 1, maxY: 2 } }), 0);
        assert.deepEqual([...found.cells], [0, 0, 64, 127, 127, FULL, 127, 127, FULL]);
    });

    test('of a window that cuts a tile skip the values of cells outside', async () => {
        const tile = { x: 0, y: 0, known: bytes(0b1111), changed: bytes(0b1111), high: NONE, values: [0, 0.25, 0.5, 1] };
        answer([tile]);
        const found = await frameAt(query({ window: { minX: 2, minY: 0, maxX: 3, maxY: 1 } }), 0);
        assert.deepEqual(known(found), [[2, 0, 127]]);
    });

    test('without known cells leave the frame unknown, and values beyond 0 to 1 are clamped', async () => {
        answer([{ x: 0, y: 0 }]);
        assert.deepEqual(known(await frameAt(query(), 0)), []);
        answer([{ x: 0, y: 0, known: bytes(0b11), values: [-0.2, 1.2], allValues: true }]);
        assert.deepEqual(known(await frameAt(query(), 0)), [[0, 0, 0], [1, 0, FULL]]);
    });
});

suite('frames', () => {
    test('are asked for with window, heights and time, and only the last readings with a model', async () => {
        const asked = answer();
        await frameAt(query({ minZ: 2, maxZ: 9 }), 1500);
        await frameAt(query({ isLatest: true }), 1500);
        const [forecast, latest] = asked;
        assert.deepEqual(forecast?.region, { minX: 0, minY: 0, maxX: 8, maxY: 8, minZ: 2, maxZ: 9 });
        assert.deepEqual([forecast?.time?.seconds, forecast?.time?.nanos, forecast?.project], [1n, 500_000_000, true]);
        assert.deepEqual([forecast?.model, latest?.model?.kind], [undefined, ModelKind.LATEST]);
    });

    test('are fetched once, also if they are wanted twice at the same time', async () => {
        const asked = answer();
        const wanted = query();
        assert.equal(keptFrame(wanted, 0), undefined);
        const both = [frameAt(wanted, 0), frameAt({ ...wanted }, 0)];
        assert.equal(comingFrames(), 1);
        const [one, other] = await Promise.all(both);
        assert.equal(one, other);
        assert.equal(keptFrame(wanted, 0), one);
        assert.equal(await frameAt(wanted, 0), one);
        assert.deepEqual([asked.length, comingFrames()], [1, 0]);
    });

    test('of another time, generation, height or window are others', async () => {
        const asked = answer();
        const first = query();
        await frameAt(first, 0);
        await frameAt(first, 1);
        for (const change of [{ generation: 'new' }, { minZ: 1 }, { maxZ: 5 }, { map: 'other' }, { window: { ...first.window, maxX: 9 } }]) {
            await frameAt({ ...first, ...change }, 0);
        }
        assert.equal(asked.length, 7);
    });

    test('of the last readings are the same at every time', async () => {
        const latest = query({ isLatest: true });
        answer();
        assert.equal(await frameAt(latest, 1), await frameAt(latest, 2));
    });

    test('that could not be had are asked for again', async () => {
        const wanted = query();
        mock.method(queries, 'predictGrid', () => {
            throw new Error('broken');
        });
        await assert.rejects(frameAt(wanted, 0), /broken/);
        assert.equal(comingFrames(), 0);
        answer();
        assert.equal((await frameAt(wanted, 0)).cells.length, 64);
    });

    test('that were used least go first when there are too many', async () => {
        answer();
        // 24 MiB are kept: three of 8 MiB.
        const wanted = query({ window: { minX: 0, minY: 0, maxX: 4096, maxY: 2048 } });
        for (const ms of [1, 2, 3]) await frameAt(wanted, ms);
        assert.ok(keptFrame(wanted, 1), 'used again');
        await frameAt(wanted, 4);
        assert.deepEqual([1, 2, 3, 4].map((ms) => keptFrame(wanted, ms) !== undefined), [true, false, true, true]);
    });

    test('have a header that says what they would be', async () => {
        const asked = answer();
        assert.equal((await gridHeader('home', 0))?.tiles, 7n);
        assert.equal(asked[0]?.estimateOnly, true);
    });
});

suite('two frames', () => {
    const [from, to] = [frame(0, 200, 10, UNKNOWN, 50, UNKNOWN), frame(100, 100, 10, 60, UNKNOWN, UNKNOWN)];

    test('blend from one to the other; a cell that only one knows is as there', () => {
        assert.deepEqual([...blend(from, to, 0).cells], [0, 200, 10, 60, 50, UNKNOWN]);
        assert.deepEqual([...blend(from, to, 0.5).cells], [50, 150, 10, 60, 50, UNKNOWN]);
        assert.deepEqual([...blend(from, to, 1).cells], [100, 100, 10, 60, 50, UNKNOWN]);
    });

    test('blend into given memory if it has the size, and never change themselves', () => {
        const memory = new Uint8Array(6);
        assert.equal(blend(from, to, 0.5, memory).cells, memory);
        assert.notEqual(blend(from, to, 0.5, new Uint8Array(5)).cells.length, 5);
        assert.deepEqual([from.cells[0], to.cells[0]], [0, 100]);
    });

    test('differ from -1 to 1, and only where both know', () => {
        const both = { ...frame(FULL, 0, 70, 3, UNKNOWN), before: frame(0, FULL, 70, UNKNOWN, 3).cells };
        assert.deepEqual([0, 1, 2, 3, 4].map((x) => valueAt(both, x, 0)), [1, -1, 0, undefined, undefined]);
    });

    test('blend with what they are compared with', () => {
        const before = from.cells;
        assert.equal(blend({ ...from, before }, { ...to, before }, 0.5).before, before);
    });
});

test('the value of a cell is that of its column, and none outside or where nothing is known', () => {
    const shown: Frame = { minX: -1, minY: 5, maxX: 1, maxY: 7, cells: Uint8Array.of(0, FULL, 127, UNKNOWN) };
    assert.deepEqual([valueAt(shown, -1, 5), valueAt(shown, 0, 5), valueAt(shown, -1, 6), valueAt(shown, 0, 6)], [0, 1, 0.5, undefined]);
    for (const [x, y] of [[-2, 5], [1, 5], [0, 4], [0, 7]] as const) assert.equal(valueAt(shown, x, y), undefined);
});
