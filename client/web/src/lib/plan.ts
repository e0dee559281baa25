// What lies on a map besides the grid: places, edges, routes and tours, in metres.

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
    /** What its colour shows, 0 to 1, the greater the darker; absent: nothing is known. */
    share?: number;
    /** Number of reported traversals. */
    reports: number;
    title: string;
}

/** A way over the plan. */
export interface PlanPath {
    kind: 'route' | 'tour';
    points: { x: number; y: number; label?: string }[];
}

export interface Plan {
    nodes: PlanNode[];
    edges: PlanEdge[];
    paths: PlanPath[];
}

/** The part of the plane that a canvas shows: its middle in metres, and pixels of the screen for a metre. */
export interface Camera {
    x: number;
    y: number;
    scale: number;
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
