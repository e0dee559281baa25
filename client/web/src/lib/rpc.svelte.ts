// The daemon's services by gRPC-Web, and whether it answers.
//
// Invariant: every call goes through here, so `link` has the outcome of the last calls. The token stays in this tab.

import { Code, ConnectError, createClient, type Interceptor } from '@connectrpc/connect';
import { createGrpcWebTransport } from '@connectrpc/connect-web';

import { ExplorationService } from '../wire/tidemap/v1/exploration_pb';
import { LandmarkService } from '../wire/tidemap/v1/landmark_pb';
import { MaintenanceService } from '../wire/tidemap/v1/maintenance_pb';
import { MapService } from '../wire/tidemap/v1/map_pb';
import { QueryService } from '../wire/tidemap/v1/query_pb';
import { RouteService } from '../wire/tidemap/v1/route_pb';
import { SearchService } from '../wire/tidemap/v1/search_pb';
import { TaskService } from '../wire/tidemap/v1/task_pb';
import { TopologyService } from '../wire/tidemap/v1/topology_pb';

const TOKEN_KEY = 'tidemap-token';
const FIRST_RETRY_MS = 500;
const RETRY_MAX_MS = 5000;

/** The outcome of the last calls. `epoch` grows whenever the daemon is back or a token was given: views then load
 * again. */
export const link = $state({ isAway: false, needsToken: false, refusal: '', epoch: 0 });

function stored(): string {
    try {
        return sessionStorage.getItem(TOKEN_KEY) ?? '';
    } catch {
        return '';
    }
}

let token = stored();

/** Keeps the token for this tab, and tries again with it. */
export function setToken(given: string): void {
    token = given.trim();
    try {
        sessionStorage.setItem(TOKEN_KEY, token);
    } catch {
        // Without a store the token lasts until the page is loaded again.
    }
    link.needsToken = false;
    link.refusal = '';
    link.epoch++;
}

/** The headers of a request that does not use the services. */
export function authorization(): Record<string, string> {
    return token ? { authorization: `Bearer ${token}` } : {};
}

/** Calls of a daemon that has fallen silent are given up together. */
let calls = new AbortController();
/** The time of the last reply. */
let heardAt = 0;

/** An answer of a proxy in front of a daemon that is away. */
const AWAY_STATUS = [502, 504];
/** A daemon that sends nothing for this long is away. */
const SILENT_MS = 10_000;

async function ready(silentMs: number): Promise<Response> {
    const answer = await fetch('/readyz', { cache: 'no-store', signal: AbortSignal.timeout(silentMs) });
    if (AWAY_STATUS.includes(answer.status)) throw new TypeError(answer.statusText);
    heardAt = performance.now();
    return answer;
}

let probing = false;

/** Sends requests until the daemon is back. */
async function probe(): Promise<void> {
    if (probing) return;
    probing = true;
    for (let wait = FIRST_RETRY_MS; ; wait = Math.min(wait * 1.5, RETRY_MAX_MS)) {
        await new Promise((done) => setTimeout(done, wait));
        try {
            if ((await ready(SILENT_MS)).ok) break;
        } catch {
            // Still away.
        }
    }
    probing = false;
    link.isAway = false;
    link.epoch++;
}

/** The time between two requests whether the daemon is there, if no other request is sent. */
const BEAT_EVERY_MS = 3000;

/**
 * Checks now and then whether the daemon is there, so that each view shows it; calling the result stops this. A daemon
 * that hangs, or a network that is gone, breaks no connection: requests that still wait are given up, and sent again
 * later.
 */
export function heartbeat(everyMs = BEAT_EVERY_MS, silentMs = SILENT_MS): () => void {
    let isWaiting = false;
    const beat = async () => {
        const begun = performance.now();
        isWaiting = true;
        try {
            await ready(silentMs);
        } catch {
            // If other calls are answered, this one only waits for a free connection.
            if (heardAt < begun) {
                link.isAway = true;
                calls.abort();
                calls = new AbortController();
                void probe();
            }
        }
        isWaiting = false;
    };
    const timer = setInterval(() => document.hidden || link.isAway || isWaiting || void beat(), everyMs);
    return () => clearInterval(timer);
}

const watchful: Interceptor = (next) => async (request) => {
    if (token) request.header.set('authorization', `Bearer ${token}`);
    try {
        // Old browsers wait.
        const signal = 'any' in AbortSignal ? AbortSignal.any([request.signal, calls.signal]) : request.signal;
        const answer = await next({ ...request, signal });
        heardAt = performance.now();
        return answer;
    } catch (error) {
        notice(error);
        throw error;
    }
};

/** Takes from an error, also from one in the middle of a stream, what it means for the daemon. */
export function notice(error: unknown): void {
    const found = ConnectError.from(error);
    if (found.code === Code.Unauthenticated) {
        link.needsToken = true;
        link.refusal = token ? found.rawMessage : '';
    } else if (isAway(found)) {
        link.isAway = true;
        void probe();
    }
}

function isAway(error: ConnectError): boolean {
    // A connection that cannot be made or breaks has no code of its own: fetch fails with a TypeError.
    return error.code === Code.Unavailable || (error.code === Code.Unknown && error.cause instanceof TypeError);
}

/** The text to show for an error; empty for errors that the page shows elsewhere or for which nobody waits. */
export function message(error: unknown): string {
    const found = ConnectError.from(error);
    notice(found);
    if (found.code === Code.Canceled || found.code === Code.Unauthenticated || isAway(found)) return '';
    return found.rawMessage;
}

const transport = createGrpcWebTransport({ baseUrl: window.location.origin, interceptors: [watchful] });

export const maps = createClient(MapService, transport);
export const queries = createClient(QueryService, transport);
export const topologies = createClient(TopologyService, transport);
export const landmarks = createClient(LandmarkService, transport);
export const routes = createClient(RouteService, transport);
export const searches = createClient(SearchService, transport);
export const exploration = createClient(ExplorationService, transport);
export const tasks = createClient(TaskService, transport);
export const maintenance = createClient(MaintenanceService, transport);
