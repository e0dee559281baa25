// Elements of a map besides the grid: flows, places, edges, routes and tours, in metres.

import type { Extent } from './extent';
import type { FlowLayer } from './flow';

export type { Extent } from './extent';

/** A place of the topological map. */
export interface PlanNode {
    name: string;
    x: number;
    y: number;
    /** Probability of presence, if it is known. */
    presence?: number;
}

/** An edge, both directions as one. */
export interface PlanEdge {
    from: string;
    to: string;
    /** The value that its colour shows, 0 to 1: the probability that it is passed, or with `isAmount` the share of its
     * duration in the longest one; absent: nothing is known. */
    share?: number;
    isAmount?: boolean;
    /** Number of reported traversals. */
    reports: number;
    title: string;
    /** The state of its success, of the worse direction. */
    state: string;
}

/** A way over the plan. */
export interface PlanPath {
    kind: 'route' | 'tour';
    points: { x: number; y: number; label?: string | undefined }[];
}

/** A position of something that moves. */
export interface PlanMark {
    name: string;
    x: number;
    y: number;
    title: string;
}

/** A square that stands out more with more information gain. */
export interface PlanSquare {
    x: number;
    y: number;
    size: number;
    /** 0 to 1. */
    share: number;
}

export interface Plan {
    nodes: PlanNode[];
    edges: PlanEdge[];
    paths: PlanPath[];
    squares: PlanSquare[];
    marks?: PlanMark[];
    flow?: FlowLayer | undefined;
}

/** The part of the plane that a canvas shows: its middle in metres, and pixels of the screen for a metre. */
export interface Camera {
    x: number;
    y: number;
    scale: number;
}

/** The rectangle around both, or the only one. */
export function around(one: Extent | undefined, other: Extent | undefined): Extent | undefined {
    if (!one || !other) return one ?? other;
    return {
        minX: Math.min(one.minX, other.minX), minY: Math.min(one.minY, other.minY),
        maxX: Math.max(one.maxX, other.maxX), maxY: Math.max(one.maxY, other.maxY),
    };
}

/** The element at a point of the map. */
export type Found = { node: PlanNode } | { edge: PlanEdge } | { mark: PlanMark } | undefined;

/** The element at a point, in metres, if one is near enough: positions before nodes, and nodes before edges. */
export function planAt(plan: Plan, x: number, y: number, nearNodeM: number, nearEdgeM: number): Found {
    const distance = (node: { x: number; y: number }) => Math.hypot(node.x - x, node.y - y);
    const [mark] = (plan.marks ?? []).filter((one) => distance(one) < nearNodeM).sort((a, b) => distance(a) - distance(b));
    if (mark) return { mark };
    const [node] = plan.nodes.filter((one) => distance(one) < nearNodeM).sort((a, b) => distance(a) - distance(b));
    if (node) return { node };
    const places = new Map(plan.nodes.map((one) => [one.name, one]));
    let best: { edge: PlanEdge; away: number } | undefined;
    for (const edge of plan.edges) {
        const [from, to] = [places.get(edge.from), places.get(edge.to)];
        if (!from || !to) continue;
        const [dx, dy] = [to.x - from.x, to.y - from.y];
        const share = Math.max(0, Math.min(1, ((x - from.x) * dx + (y - from.y) * dy) / (dx * dx + dy * dy || 1)));
        const away = Math.hypot(from.x + share * dx - x, from.y + share * dy - y);
        if (away < nearEdgeM && away < (best?.away ?? Infinity)) best = { edge, away };
    }
    return best && { edge: best.edge };
}

/** The length of a scale bar, metres, of at most `mostPx` pixels: 1, 2 or 5 of a power of ten. */
export function scaleBar(scale: number, mostPx = 110): number {
    const most = mostPx / scale;
    const power = 10 ** Math.floor(Math.log10(most));
    return ([5, 2, 1].find((step) => step * power <= most) ?? 1) * power;
}

/** Places nodes without a position on a circle around the others. */
export function placeNodes(nodes: { name: string; pose?: { xM: number; yM: number } }[]): PlanNode[] {
    const posed = nodes.filter((node) => node.pose);
    const [xs, ys] = [posed.map((node) => node.pose?.xM ?? 0), posed.map((node) => node.pose?.yM ?? 0)];
    const middle = (values: number[]) => (values.length ? (Math.min(...values) + Math.max(...values)) / 2 : 0);
    const spread = (values: number[]) => (values.length ? Math.max(...values) - Math.min(...values) : 0);
    const radius = posed.length ? Math.hypot(spread(xs), spread(ys)) * 0.6 + 2 : Math.max(6, nodes.length);
    const loose = nodes.length - posed.length;
    let next = 0;
    return nodes.map((node) => {
        if (node.pose) return { name: node.name, x: node.pose.xM, y: node.pose.yM };
        const angle = Math.PI / 2 - (2 * Math.PI * next++) / loose;
        return { name: node.name, x: middle(xs) + radius * Math.cos(angle), y: middle(ys) + radius * Math.sin(angle) };
    });
}
