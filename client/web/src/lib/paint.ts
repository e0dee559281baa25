// Draws a frame and a plan on canvases.

import { amount, gain, occupancy, unknown, type Palette } from './colours';
import { arrowsOf, flowExtent, type FlowLayer } from './flow';
import { learnedCounts, type Frame } from './frames';
import type { Camera, Plan } from './plan';

/** The place of a grid: its corner and its cells, in metres. */
export interface GridPlace {
    originX: number;
    originY: number;
    resolution: number;
}

/** A name, the middle of its base line, and its width, in pixels. */
export interface Label {
    text: string;
    x: number;
    y: number;
    width: number;
}

const LABEL_PX = 13;
/** A name whose place is further outside cannot be seen. */
const LABEL_EDGE_PX = 150;

/** The labels that cover none before them. */
export function apart<T extends Label>(labels: T[]): T[] {
    const kept: T[] = [];
    const covers = (one: Label, other: Label) => Math.abs(one.x - other.x) < (one.width + other.width) / 2 && Math.abs(one.y - other.y) < LABEL_PX;
    for (const label of labels) if (!kept.some((other) => covers(label, other))) kept.push(label);
    return kept;
}

/** A shorter piece of a way has no arrow. */
const ARROW_PX = 18;

let sheet: HTMLCanvasElement | undefined;
let image: ImageData | undefined;

function sheetOf(frame: Frame, palette: Palette): HTMLCanvasElement {
    const [width, height] = [frame.maxX - frame.minX, frame.maxY - frame.minY];
    sheet ??= document.createElement('canvas');
    const brush = sheet.getContext('2d');
    if (!image || image.width !== width || image.height !== height) {
        [sheet.width, sheet.height] = [width, height];
        image = new ImageData(width, height);
    }
    const pixels = new Uint32Array(image.data.buffer);
    const { cells } = frame;
    // While a layer is changed, the frame may still be the frame of the other layer.
    const before = palette.length > 256 ? (frame.before ?? cells) : undefined;
    for (let row = 0; row < height; row++) {
        // Rows of a frame go north, rows of a picture go south.
        let to = (height - 1 - row) * width;
        for (let from = row * width, end = from + width; from < end; from++, to++) {
            const now = cells[from] as number;
            pixels[to] = palette[before ? 256 * (before[from] as number) + now : now] as number;
        }
    }
    brush?.putImageData(image, 0, 0);
    return sheet;
}

/** Between two lines of the hatching, pixels of the screen. */
const HATCH_PX = 7;

/** Hatches the columns that no update has learned, within a rectangle of the canvas. */
function hatch(brush: CanvasRenderingContext2D, frame: Frame, unlearned: Uint8Array, [left, top, width, height]: number[], colour: string, ratio: number): void {
    const [columns, rows] = [frame.maxX - frame.minX, frame.maxY - frame.minY];
    const [mask, veil] = [document.createElement('canvas'), document.createElement('canvas')];
    [mask.width, mask.height, veil.width, veil.height] = [columns, rows, brush.canvas.width, brush.canvas.height];
    const [stencil, lines] = [mask.getContext('2d'), veil.getContext('2d')];
    if (!stencil || !lines) return;
    const marks = new ImageData(columns, rows);
    for (let row = 0; row < rows; row++) {
        for (let column = 0; column < columns; column++) {
            if (unlearned[row * columns + column]) marks.data[4 * ((rows - 1 - row) * columns + column) + 3] = 255;
        }
    }
    stencil.putImageData(marks, 0, 0);
    lines.strokeStyle = colour;
    lines.lineWidth = 1.2 * ratio;
    for (let x = -veil.height; x < veil.width; x += HATCH_PX * ratio) {
        lines.moveTo(x, veil.height);
        lines.lineTo(x + veil.height, 0);
    }
    lines.stroke();
    lines.globalCompositeOperation = 'destination-in';
    lines.imageSmoothingEnabled = false;
    lines.drawImage(mask, left ?? 0, top ?? 0, width ?? 0, height ?? 0);
    brush.drawImage(veil, 0, 0);
}

/** Draws a frame. `hatching` is the colour of the lines over what is not learned, where other columns are; `ratio` is
 * the number of pixels of the canvas for one pixel of the screen. */
export function paintFrame(canvas: HTMLCanvasElement, frame: Frame | undefined, palette: Palette, place: GridPlace, camera: Camera, ratio: number, hatching = '#000'): void {
    const brush = canvas.getContext('2d');
    if (!brush) return;
    brush.setTransform(1, 0, 0, 1, 0, 0);
    brush.clearRect(0, 0, canvas.width, canvas.height);
    if (!frame) return;
    const scale = camera.scale * ratio;
    const left = (place.originX + frame.minX * place.resolution - camera.x) * scale + canvas.width / 2;
    const top = canvas.height / 2 - (place.originY + frame.maxY * place.resolution - camera.y) * scale;
    brush.imageSmoothingEnabled = place.resolution * scale < 1;
    const [width, height] = [frame.maxX - frame.minX, frame.maxY - frame.minY];
    const box: [number, number, number, number] = [left, top, width * place.resolution * scale, height * place.resolution * scale];
    brush.drawImage(sheetOf(frame, palette), ...box);
    if (frame.unlearned && learnedCounts(frame).learned) hatch(brush, frame, frame.unlearned, box, hatching, ratio);
}

interface Style {
    text: string;
    ground: string;
    /** Edges of which nothing is known. */
    soft: string;
    /** Routes and selected elements: blue, which is no colour of a probability. */
    way: string;
}

function arrow(brush: CanvasRenderingContext2D, x1: number, y1: number, x2: number, y2: number): void {
    const angle = Math.atan2(y2 - y1, x2 - x1);
    const [x, y] = [(x1 + x2) / 2, (y1 + y2) / 2];
    brush.beginPath();
    for (const turn of [2.6, -2.6]) {
        brush.moveTo(x + 5 * Math.cos(angle), y + 5 * Math.sin(angle));
        brush.lineTo(x + 9 * Math.cos(angle + turn), y + 9 * Math.sin(angle + turn));
    }
    brush.stroke();
}

/** The least room for the arrow of a flow: where cells are smaller, some share one. */
const FLOW_ARROW_PX = 14;
type ToScreen = (point: { x: number; y: number }) => [number, number];

function paintFlow(brush: CanvasRenderingContext2D, layer: FlowLayer, at: ToScreen, scale: number, style: Style): void {
    const { flow, top } = layer;
    const edge = flow.edge * scale;
    /** Whole pixels: half ones would show seams. */
    const fill = (minX: number, minY: number, maxX: number, maxY: number) => {
        const [[left, bottom], [right, high]] = [at({ x: minX, y: minY }), at({ x: maxX, y: maxY })].map((ends) => ends.map(Math.round)) as [[number, number], [number, number]];
        brush.fillRect(left, high, right - left, bottom - high);
    };
    if (layer.isAlone) {
        const { minX, minY, maxX, maxY } = flowExtent(flow);
        brush.fillStyle = style.ground;
        fill(minX, minY, maxX, maxY);
    }
    for (const { column, row, count } of flow.cells) {
        const [x, y] = [flow.lowX + column * flow.edge, flow.lowY + row * flow.edge];
        brush.fillStyle = gain(count / top);
        fill(x, y, x + flow.edge, y + flow.edge);
    }
    const arrows = arrowsOf(layer, Math.max(1, Math.ceil(FLOW_ARROW_PX / edge)));
    for (const isRim of [true, false]) {
        brush.lineWidth = isRim ? 4 : 1.8;
        brush.strokeStyle = isRim ? style.ground : style.text;
        for (const arrow of arrows) {
            const [x, y] = at(arrow);
            // The length is the share of the direction.
            const half = 0.45 * arrow.size * scale * arrow.share;
            const [dx, dy] = [half * Math.cos(arrow.angle), -half * Math.sin(arrow.angle)];
            const [tipX, tipY, head] = [x + dx, y + dy, Math.min(9, Math.max(3, 0.6 * half))];
            brush.beginPath();
            brush.moveTo(x - dx, y - dy);
            brush.lineTo(tipX, tipY);
            for (const turn of [2.6, -2.6]) {
                brush.moveTo(tipX, tipY);
                brush.lineTo(tipX + head * Math.cos(turn - arrow.angle), tipY + head * Math.sin(turn - arrow.angle));
            }
            brush.stroke();
        }
    }
}

/** Draws a plan over the frame. */
export function paintPlan(canvas: HTMLCanvasElement, plan: Plan, marked: { x: number; y: number; size: number } | undefined, chosen: string[], camera: Camera, ratio: number, style: Style): void {
    const brush = canvas.getContext('2d');
    if (!brush) return;
    brush.setTransform(ratio, 0, 0, ratio, 0, 0);
    const [width, height] = [canvas.width / ratio, canvas.height / ratio];
    brush.clearRect(0, 0, width, height);
    const at: ToScreen = (point) => [
        (point.x - camera.x) * camera.scale + width / 2,
        height / 2 - (point.y - camera.y) * camera.scale,
    ];
    for (const square of plan.squares) {
        const [x, y] = at(square);
        const edge = square.size * camera.scale;
        brush.fillStyle = gain(square.share);
        brush.fillRect(x - edge / 2, y - edge / 2, edge, edge);
    }
    if (plan.flow) paintFlow(brush, plan.flow, at, camera.scale, style);
    const places = new Map(plan.nodes.map((node) => [node.name, node]));
    for (const edge of plan.edges) {
        const [from, to] = [places.get(edge.from), places.get(edge.to)];
        if (!from || !to) continue;
        for (const isRim of [true, false]) {
            brush.beginPath();
            brush.moveTo(...at(from));
            brush.lineTo(...at(to));
            // The rim shows a line whose colour is that of the floor.
            brush.lineWidth = isRim ? 6.5 : 4;
            const isUnknown = edge.share === undefined;
            brush.strokeStyle = isRim ? (isUnknown ? style.ground : style.text) : edge.share === undefined ? style.soft : edge.isAmount ? amount(edge.share) : occupancy(edge.share);
            brush.setLineDash(!isRim && isUnknown ? [7, 5] : []);
            brush.stroke();
        }
    }
    brush.setLineDash([]);
    for (const path of plan.paths) {
        brush.strokeStyle = brush.fillStyle = style.way;
        brush.lineWidth = 3;
        for (let step = 1; step < path.points.length; step++) {
            const [from, to] = [path.points[step - 1], path.points[step]];
            if (!from || !to) continue;
            const [[x1, y1], [x2, y2]] = [at(from), at(to)];
            brush.beginPath();
            brush.moveTo(x1, y1);
            brush.lineTo(x2, y2);
            brush.stroke();
            if (Math.hypot(x2 - x1, y2 - y1) > ARROW_PX) arrow(brush, x1, y1, x2, y2);
        }
    }
    brush.font = '600 11px system-ui, sans-serif';
    brush.textAlign = 'center';
    const label = (text: string, x: number, y: number) => {
        brush.lineWidth = 3;
        brush.strokeStyle = style.ground;
        brush.lineJoin = 'round';
        brush.strokeText(text, x, y);
        brush.fillStyle = style.text;
        brush.fillText(text, x, y);
    };
    for (const node of plan.nodes) {
        const [x, y] = at(node);
        const isChosen = chosen.includes(node.name);
        brush.beginPath();
        brush.arc(x, y, isChosen ? 12 : 9, 0, 2 * Math.PI);
        brush.fillStyle = style.ground;
        brush.fill();
        brush.beginPath();
        brush.arc(x, y, isChosen ? 9 : 6.5, 0, 2 * Math.PI);
        brush.fillStyle = node.presence === undefined ? unknown() : occupancy(node.presence);
        brush.fill();
        brush.lineWidth = isChosen ? 3.5 : 2;
        brush.strokeStyle = isChosen ? style.way : style.text;
        brush.stroke();
    }
    if (camera.scale > 9 || plan.nodes.length < 40) {
        // A selected node has its name even beside others.
        const nodes = [...plan.nodes].sort((a, b) => Number(chosen.includes(b.name)) - Number(chosen.includes(a.name)));
        const labels = nodes.flatMap((node) => {
            const [x, y] = at(node);
            const isInside = x > -LABEL_EDGE_PX && x < width + LABEL_EDGE_PX && y > -LABEL_EDGE_PX && y < height + LABEL_EDGE_PX;
            return isInside ? [{ text: node.name, x, y: y + 20, width: brush.measureText(node.name).width + 4 }] : [];
        });
        for (const { text, x, y } of apart(labels)) label(text, x, y);
    }
    for (const { name, x: east, y: north } of plan.marks ?? []) {
        const [x, y] = at({ x: east, y: north });
        const size = chosen.includes(name) ? 9 : 7;
        brush.beginPath();
        brush.moveTo(x, y - size);
        for (const [dx, dy] of [[size, 0], [0, size], [-size, 0]] as const) brush.lineTo(x + dx, y + dy);
        brush.closePath();
        brush.fillStyle = style.way;
        brush.fill();
        brush.lineWidth = 2;
        brush.strokeStyle = style.ground;
        brush.stroke();
    }
    const marks = (plan.marks ?? []).map((mark) => {
        const [x, y] = at(mark);
        return { text: mark.name, x, y: y - 13, width: brush.measureText(mark.name).width + 4 };
    });
    for (const { text, x, y } of apart(marks.sort((a, b) => Number(chosen.includes(b.text)) - Number(chosen.includes(a.text))))) label(text, x, y);
    for (const path of plan.paths) {
        for (const point of path.points) {
            if (!point.label) continue;
            const [x, y] = at(point);
            brush.beginPath();
            brush.arc(x, y, Math.max(9, 3 + brush.measureText(point.label).width / 2), 0, 2 * Math.PI);
            brush.fillStyle = style.way;
            brush.fill();
            brush.fillStyle = style.ground;
            brush.fillText(point.label, x, y + 4);
        }
    }
    if (marked) {
        const [x, y] = at(marked);
        const edge = Math.max(6, marked.size * camera.scale);
        brush.lineWidth = 4;
        brush.strokeStyle = '#000';
        brush.strokeRect(x - edge / 2, y - edge / 2, edge, edge);
        brush.lineWidth = 2;
        brush.strokeStyle = '#fff';
        brush.strokeRect(x - edge / 2, y - edge / 2, edge, edge);
    }
}
