// Drawings on canvases, by the calls that a canvas receives.

import assert from 'node:assert/strict';
import { beforeEach, suite, test } from 'node:test';

import { amount, gain, occupancy, paletteOf, SURE, unknown } from './colours';
import { apart, paintFrame, paintPlan } from './paint';
import type { Plan } from './plan';

interface Call {
    name: string;
    values: unknown[];
    /** The properties of the brush at that moment. */
    brush: Record<string, unknown>;
}

/** A canvas that keeps the drawing calls. */
class Canvas {
    width = 200;
    height = 100;
    calls: Call[] = [];
    #brush = new Proxy({} as Record<string, unknown>, {
        get: (brush, name: string) => brush[name] ?? ((...values: unknown[]) => {
            this.calls.push({ name, values, brush: { ...brush } });
            return name === 'measureText' ? { width: 6 * String(values[0]).length } : undefined;
        }),
    });

    getContext(): unknown {
        return this.#brush;
    }

    named(name: string): Call[] {
        return this.calls.filter((call) => call.name === name);
    }
}

let canvas: Canvas;
const sheets: Canvas[] = [];
const drawn = () => canvas as unknown as HTMLCanvasElement;

Object.assign(globalThis, {
    document: { createElement: () => sheets[sheets.push(new Canvas()) - 1] },
    ImageData: class {
        data: Uint8ClampedArray;
        constructor(readonly width: number, readonly height: number) {
            this.data = new Uint8ClampedArray(width * height * 4);
        }
    },
});

beforeEach(() => {
    canvas = new Canvas();
});

suite('a frame', () => {
    const palette = paletteOf('probability', SURE);
    const frame = { minX: 2, minY: -1, maxX: 4, maxY: 2, cells: Uint8Array.of(0, 10, 20, 30, 254, 255) };
    const place = { originX: 1, originY: 2, resolution: 0.5 };

    test('has its north at the top, in the colours of the palette', () => {
        paintFrame(drawn(), frame, palette, place, { x: 0, y: 0, scale: 10 }, 1);
        const image = sheets.at(-1)?.named('putImageData').at(-1)?.values[0] as ImageData;
        assert.deepEqual([image.width, image.height], [2, 3]);
        const pixels = [...new Uint32Array(image.data.buffer)];
        assert.deepEqual(pixels, [254, 255, 20, 30, 0, 10].map((index) => palette[index]));
    });

    test('of a difference has the colours of both times', () => {
        const both = paletteOf('difference', SURE);
        paintFrame(drawn(), { ...frame, before: Uint8Array.of(254, 10, 255, 0, 0, 255) }, both, place, { x: 0, y: 0, scale: 10 }, 1);
        const image = sheets.at(-1)?.named('putImageData').at(-1)?.values[0] as ImageData;
        const pairs = [[254, 0], [255, 255], [20, 255], [30, 0], [0, 254], [10, 10]] as const;
        assert.deepEqual([...new Uint32Array(image.data.buffer)], pairs.map(([now, before]) => both[256 * before + now]));
    });

    test('of another layer than the palette is painted as far as it goes', () => {
        paintFrame(drawn(), { ...frame, before: new Uint8Array(6) }, palette, place, { x: 0, y: 0, scale: 10 }, 1);
        const pixels = () => {
            const image = sheets.at(-1)?.named('putImageData').at(-1)?.values[0] as ImageData;
            return [...new Uint32Array(image.data.buffer)];
        };
        assert.deepEqual(pixels(), [254, 255, 20, 30, 0, 10].map((index) => palette[index]));
        const both = paletteOf('difference', SURE);
        paintFrame(drawn(), frame, both, place, { x: 0, y: 0, scale: 10 }, 1);
        assert.deepEqual(pixels(), [254, 255, 20, 30, 0, 10].map((index) => both[257 * index]));
    });

    test('lies where its cells are, seen by the camera', () => {
        paintFrame(drawn(), frame, palette, place, { x: 1, y: 2, scale: 10 }, 2);
        // 20 pixels a metre; the corner at (2, 3) m is 1 m right and 1 m above the middle of the canvas.
        assert.deepEqual(canvas.named('drawImage')[0]?.values.slice(1), [120, 30, 20, 30]);
    });

    test('is smooth only where cells are smaller than pixels', () => {
        for (const [scale, isSmooth] of [[1.9, true], [2, false]] as const) {
            paintFrame(drawn(), frame, palette, place, { x: 0, y: 0, scale }, 1);
            assert.equal(canvas.named('drawImage').at(-1)?.brush.imageSmoothingEnabled, isSmooth);
        }
    });

    test('that is not there leaves an empty canvas', () => {
        paintFrame(drawn(), undefined, palette, place, { x: 0, y: 0, scale: 10 }, 1);
        assert.deepEqual(canvas.calls.map(({ name }) => name), ['setTransform', 'clearRect']);
    });
});

suite('a plan', () => {
    const style = { text: 'text', ground: 'ground', soft: 'soft', way: 'way' };
    const nodes = [{ name: 'hall', x: 0, y: 0 }, { name: 'lab', x: 3, y: 2, presence: 0.5 }];
    const empty: Plan = { nodes: [], edges: [], paths: [], squares: [] };

    function paint(plan: Partial<Plan>, chosen: string[] = [], scale = 10, marked?: { x: number; y: number; size: number }): void {
        paintPlan(drawn(), { ...empty, ...plan }, marked, chosen, { x: 0, y: 0, scale }, 1, style);
    }

    test('has nodes at their place, y upwards, in the colour of presence', () => {
        paint({ nodes });
        const discs = canvas.named('arc').map(({ values }) => values.slice(0, 3));
        assert.deepEqual(discs, [[100, 50, 9], [100, 50, 6.5], [130, 30, 9], [130, 30, 6.5]]);
        assert.deepEqual(canvas.named('fill').map(({ brush }) => brush.fillStyle), ['ground', unknown(), 'ground', occupancy(0.5)]);
        assert.deepEqual(canvas.named('fillText').map(({ values }) => values), [['hall', 100, 70], ['lab', 130, 50]]);
    });

    test('has larger nodes where they are chosen', () => {
        paint({ nodes }, ['lab']);
        assert.deepEqual(canvas.named('arc').map(({ values }) => values[2]), [9, 6.5, 12, 9]);
    });

    test('has no names where many nodes are small', () => {
        const many = Array.from({ length: 40 }, (_, index) => ({ name: `${index}`, x: 2 * (index % 5), y: 2 * (4 - Math.floor(index / 5)) }));
        paint({ nodes: many }, [], 9);
        assert.equal(canvas.named('fillText').length, 0);
        paint({ nodes: many }, [], 9.1);
        assert.equal(canvas.named('fillText').length, 40);
    });

    test('has edges in the colour of a probability or an amount, grey and dashed where nothing is known', () => {
        const edge = { from: 'hall', to: 'lab', title: '', state: 'edge/a/b' };
        paint({ nodes, edges: [{ ...edge, share: 0.25, reports: 3 }, { ...edge, reports: 0 }, { ...edge, share: 0.25, isAmount: true, reports: 3 }] });
        const lines = canvas.named('stroke').filter(({ brush }) => brush.lineWidth === 4).map(({ brush }) => brush.strokeStyle);
        assert.deepEqual(lines, [occupancy(0.25), 'soft', amount(0.25)]);
        assert.deepEqual(canvas.named('setLineDash').map(({ values }) => (values[0] as number[]).length), [0, 0, 0, 2, 0, 0, 0]);
        assert.deepEqual([canvas.named('moveTo')[0]?.values, canvas.named('lineTo')[0]?.values], [[100, 50], [130, 30]]);
    });

    test('leaves out edges of nodes that are not there', () => {
        paint({ nodes, edges: [{ from: 'hall', to: 'attic', reports: 1, title: '', state: 'edge/a/b' }] });
        assert.equal(canvas.named('lineTo').length, 0);
    });

    test('has ways as lines, with an arrow where they are long, and the numbers of a tour', () => {
        paint({ paths: [{ kind: 'tour', points: [{ x: 0, y: 0, label: '1' }, { x: 2, y: 0 }, { x: 2, y: 1, label: '2' }] }] });
        // A line for each step, and two strokes of an arrow for the longer one.
        assert.deepEqual(canvas.named('lineTo').length, 2 + 2);
        assert.deepEqual(canvas.named('fillText').map(({ values }) => values[0]), ['1', '2']);
    });

    test('has flows as shades of their cells, with arrows as long as their share', () => {
        const cells = [{ column: 0, row: 0, count: 4, shares: [0.5, 0.25, 0.25, 0] }, { column: 1, row: 1, count: 0.1, shares: [1, 0, 0, 0] }];
        const flow = { lowX: 0, lowY: 0, edge: 2, columns: 2, rows: 2, detections: 9n, cells };
        paint({ flow: { flow, top: 8, isAlone: false } });
        const shades = canvas.named('fillRect').map(({ values, brush }) => [...values, brush.fillStyle]);
        assert.deepEqual(shades, [[100, 30, 20, 20, gain(0.5)], [120, 10, 20, 20, gain(0.0125)]]);
        // The rim and the line of the only cell with many people: 0.9 of half its edge.
        const lines = canvas.named('lineTo').filter((_, index) => index % 3 === 0).map(({ values }) => values);
        assert.deepEqual([lines, canvas.named('moveTo')[0]?.values], [[[104.5 + 10, 40], [104.5 + 10, 40]], [105.5, 40]]);
    });

    test('has an arrow of a flow that points up for π/2', () => {
        const cells = [{ column: 0, row: 0, count: 4, shares: [0, 1, 0, 0] }];
        const flow = { lowX: 0, lowY: 0, edge: 2, columns: 1, rows: 1, detections: 9n, cells };
        paint({ flow: { flow, top: 8, isAlone: false } });
        const [from, to] = [canvas.named('moveTo')[0], canvas.named('lineTo')[0]].map((call) => call?.values.map((value) => Math.round(Number(value))));
        assert.deepEqual([from, to], [[110, 49], [110, 31]]);
        // The head lies below the tip.
        assert.ok(canvas.named('lineTo').slice(1, 3).every(({ values }) => Number(values[1]) > 31));
    });

    test('has a light ground below a flow that nothing else lies under', () => {
        const flow = { lowX: 0, lowY: 0, edge: 2, columns: 2, rows: 1, detections: 0n, cells: [] };
        paint({ flow: { flow, top: 8, isAlone: true } });
        assert.deepEqual(canvas.named('fillRect').map(({ values }) => values), [[100, 30, 40, 20]]);
    });

    test('has one arrow for several cells where they are small', () => {
        const cells = [0, 1, 2, 3].map((column) => ({ column, row: 0, count: 1, shares: [1, 0, 0, 0] }));
        const flow = { lowX: 0, lowY: 0, edge: 1, columns: 4, rows: 1, detections: 9n, cells };
        const strokes = (scale: number) => {
            canvas = new Canvas();
            paint({ flow: { flow, top: 1, isAlone: false } }, [], scale);
            return canvas.named('stroke').length / 2;
        };
        assert.deepEqual([strokes(14), strokes(7), strokes(3)], [4, 2, 1]);
    });

    test('marks a cell by a square that can be seen from afar', () => {
        paint({}, [], 10, { x: 1, y: 1, size: 2 });
        assert.deepEqual(canvas.named('strokeRect')[0]?.values, [100, 30, 20, 20]);
        paint({}, [], 1, { x: 0, y: 0, size: 2 });
        assert.deepEqual(canvas.named('strokeRect').at(-1)?.values, [97, 47, 6, 6]);
    });
});

test('a label that would cover one before it is left out', () => {
    const label = (text: string, x: number, y = 0) => ({ text, x, y, width: 10 });
    assert.deepEqual(apart([label('a', 0), label('b', 9), label('c', 11), label('d', 9, 14)]).map(({ text }) => text), ['a', 'c', 'd']);
});
