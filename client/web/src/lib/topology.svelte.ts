// The topological map of a map, with the forecasts of its edges and of presence at a time.

import { ConnectError, Code } from '@connectrpc/connect';

import type { PredictedEdge } from '../wire/tidemap/v1/route_pb';
import { oneAtATime } from './latest';
import { placeNodes, type Plan, type PlanEdge, type PlanNode, type PlanPath } from './plan';
import { message, routes, searches, topologies } from './rpc.svelte';
import { toNanos, toTimestamp } from './times';

export type EdgeColour = 'success' | 'duration' | 'none';

/** Forecasts wait this long for the slider to rest. */
const REST_MS = 60;

export class PlanFeed {
    #nodes: PlanNode[] = $state.raw([]);
    #edges: PredictedEdge[] = $state.raw([]);
    #presence: Map<string, number> = $state.raw(new Map());
    #colour: EdgeColour = $state('success');
    /** Names of states that no update has learned: what is forecast of them is no more than a prior. */
    unlearned: ReadonlySet<string> = $state.raw(new Set());
    /** Routes and tours that panels have drawn. */
    paths: PlanPath[] = $state.raw([]);
    problem = $state('');
    #timer: ReturnType<typeof setTimeout> | undefined;
    readonly #run = oneAtATime();

    /** Whether a place has a position; else places stand on a circle, which has no scale. */
    hasPositions = $state(false);
    readonly hasNodes = $derived(this.#nodes.length > 0);
    readonly hasPresence = $derived(this.#presence.size > 0);
    readonly plan: Plan = $derived({ nodes: this.#shownNodes(), edges: this.#shownEdges(), paths: [], squares: [] });
    readonly extent = $derived.by(() => {
        const [xs, ys] = [this.#nodes.map((node) => node.x), this.#nodes.map((node) => node.y)];
        if (xs.length === 0) return undefined;
        return { minX: Math.min(...xs) - 2, maxX: Math.max(...xs) + 2, minY: Math.min(...ys) - 2, maxY: Math.max(...ys) + 2 };
    });

    async load(map: string): Promise<void> {
        try {
            const { nodes } = await topologies.getTopology({ map });
            this.#nodes = placeNodes(nodes);
            this.hasPositions = nodes.some((node) => node.pose);
            this.problem = '';
        } catch (error) {
            this.problem = message(error);
        }
    }

    /** Requests the forecasts of a time, once the slider rests on it for a moment. A change of `generation` only makes
     * a new request. */
    predict(map: string, ms: number, colour: EdgeColour, generation: string): void {
        void generation;
        this.#colour = colour;
        if (!this.hasNodes) return;
        clearTimeout(this.#timer);
        this.#timer = setTimeout(() => this.#run(() => this.#ask(map, ms)), REST_MS);
    }

    async #ask(map: string, ms: number): Promise<void> {
        try {
            const edges = routes.predictEdges({ map, time: toTimestamp(ms) });
            const presence = searches.predictPresence({ map, timesNanos: [toNanos(ms)] });
            const [edgesDone, presenceDone] = await Promise.allSettled([edges, presence]);
            if (edgesDone.status === 'rejected') throw edgesDone.reason as Error;
            this.#edges = edgesDone.value.edges;
            this.#presence = new Map();
            if (presenceDone.status === 'fulfilled') {
                const { nodes, times } = presenceDone.value;
                this.#presence = new Map(nodes.map((name, index) => [name, times[0]?.probabilities[index] ?? 0]));
            } else if (ConnectError.from(presenceDone.reason).code !== Code.FailedPrecondition) {
                this.problem = message(presenceDone.reason);
                return;
            }
            this.problem = '';
        } catch (error) {
            this.problem = message(error);
        }
    }

    #shownNodes(): PlanNode[] {
        return this.#nodes.map((node) => {
            const presence = this.unlearned.has(node.name) ? undefined : this.#presence.get(node.name);
            return presence === undefined ? node : { ...node, presence };
        });
    }

    #shownEdges(): PlanEdge[] {
        if (this.#colour === 'none') return [];
        const both = new Map<string, PlanEdge & { success: number; secs: number }>();
        const slowest = Math.max(1e-9, ...this.#edges.map((edge) => edge.durationSecs));
        for (const { edge, success, durationSecs, reports } of this.#edges) {
            if (!edge) continue;
            const { from, to } = edge;
            const key = JSON.stringify([from, to].sort());
            const other = both.get(key);
            if (this.unlearned.has(`edge/${from}/${to}`)) {
                if (!other) both.set(key, { from, to, title: `${from} – ${to}: not learned yet`, state: `edge/${from}/${to}`, reports: Number(reports), success: 1, secs: 0 });
                continue;
            }
            // Two directions are drawn as one line, with the worse value of the two.
            const [worst, longest] = [Math.min(success, other?.success ?? 1), Math.max(durationSecs, other?.secs ?? 0)];
            const title = `${from} – ${to}: success ${worst.toFixed(2)}, ${longest.toFixed(0)} s`;
            const isWorst = success <= (other?.success ?? 1);
            const state = other && !isWorst ? other.state : `edge/${from}/${to}`;
            const isAmount = this.#colour === 'duration';
            const share = isAmount ? longest / slowest : worst;
            // The prior of an edge that nobody has reported is no knowledge of it.
            const isKnown = reports > 0n || (other?.reports ?? 0) > 0;
            both.set(key, { from, to, title, ...(isKnown ? { share } : {}), ...(isAmount ? { isAmount } : {}), state, reports: Number(reports) + (other?.reports ?? 0), success: worst, secs: longest });
        }
        return [...both.values()];
    }
}
