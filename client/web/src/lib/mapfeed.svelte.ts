// A map and its states, requested again while a view shows them.
//
// Invariant: a map that does not exist is reported as such, with the maps that exist; states are listed again only when
// the counters of the map show new data.

import { Code, ConnectError } from '@connectrpc/connect';

import type { Map as WireMap, State } from '../wire/tidemap/v1/map_pb';
import { addDays, DAY, HOUR, midnight, MINUTE } from './civil';
import { isLearned } from './learned';
import { link, maps, message, queries } from './rpc.svelte';
import { fromTimestamp, toNanos } from './times';
import { StateKind } from '../wire/tidemap/v1/types_pb';

/** The time between two requests for the counters of the map. */
const EVERY_MS = 4000;
/** Listing the states takes at most about this share of the time. */
const LISTING_SHARE = 0.1;
const PAGE = 10_000;
/** A step of the clock that a view opens at. */
const STEP_MS = 5 * MINUTE;

/** The time that a view opens at: now, or the time of the newest data if it is older than a day. */
export function openingTime(newest: number | undefined, now: number): number {
    const at = newest !== undefined && now - newest > DAY ? newest : now;
    // A simulated clock begins in 1970, and its first instant is no time of the daemon.
    return Math.max(MINUTE, Math.floor(at / STEP_MS) * STEP_MS);
}

/** A map with at most this many states that robots named shows their weeks. */
const FEW = 12;
const BUSY_STEP_MS = HOUR / 2;
/** Less change in half an hour, in all states together, is none. */
const BUSY_LEAST = 0.2;

/** Whether a map has few states, and no grid. */
export function hasFew(info: Pick<WireMap, 'grid'> | undefined, states: State[]): boolean {
    return !info?.grid && states.filter((state) => !state.name.includes('/')).length <= FEW;
}

/** The time of a local day at which the predictions of states change most; `undefined`: nothing changes. */
export async function busyTime(map: string, states: State[], ms: number, zone: string): Promise<number | undefined> {
    const known = states.filter((state) => isLearned(state) && [StateKind.PROBABILITY, StateKind.CATEGORICAL].includes(state.kind));
    const named = known.filter((state) => !state.name.includes('/'));
    const names = (named.length ? named : known).slice(0, FEW).map((state) => state.name);
    if (names.length === 0) return undefined;
    const times: number[] = [];
    for (let at = midnight(ms, zone), end = addDays(at, 1, zone); at < end; at += BUSY_STEP_MS) times.push(at);
    const changes = times.map(() => 0);
    for await (const { firstTimeIndex, probabilities } of queries.predictStates({ map, states: names, timesNanos: times.map(toNanos) })) {
        for (let index = 1; index < probabilities.length; index++) {
            changes[firstTimeIndex + index] = (changes[firstTimeIndex + index] ?? 0) + Math.abs((probabilities[index] ?? 0) - (probabilities[index - 1] ?? 0));
        }
    }
    const most = Math.max(...changes);
    return most < BUSY_LEAST ? undefined : times[changes.indexOf(most)];
}

/** The time of the newest observation, milliseconds; an observation later than the clock does not count. */
export function newestTime(states: { lastTime?: { seconds: bigint; nanos: number } }[], cut: number | undefined, now: number): number | undefined {
    let newest: number | undefined;
    for (const { lastTime } of states) {
        const ms = lastTime && Number(lastTime.seconds) * 1000 + lastTime.nanos / 1e6;
        if (ms !== undefined && ms <= now && ms > (newest ?? 0)) newest = ms;
    }
    // Scans have no times here; the learned scans end with the update.
    return newest ?? (cut !== undefined && cut <= now ? cut : undefined);
}

/** Rows that came this recently mean that more will come. */
const LIVE_MS = HOUR;

/** The time up to which a map can be known: now while data come, else the time of the newest observation. */
export function horizonOf(newest: number | undefined, now = Date.now()): number {
    return newest !== undefined && now - newest < LIVE_MS ? now : (newest ?? 0);
}

export class MapFeed {
    info: WireMap | undefined = $state.raw();
    states: State[] = $state.raw([]);
    /** Whether all states are here. */
    isListed = $state(false);
    /** Whether some states, or the lack of any, are known: enough to open. */
    isReady = $state(false);
    /** Names of the maps that exist, if this one does not. */
    others: string[] | undefined = $state.raw();
    problem = $state('');
    /** Milliseconds; when the view opens. */
    opening = $state(Number.NaN);
    newest: number | undefined = $state();
    #map: string;
    #counters = '';
    #listAfter = 0;
    #isBusy = false;

    constructor(map: string) {
        this.#map = map;
    }

    /** Sends requests now and then; calling the result stops this. For an effect. */
    follow(): () => void {
        void link.epoch;
        void this.load();
        const timer = setInterval(() => document.hidden || link.isAway || void this.load(), EVERY_MS);
        return () => clearInterval(timer);
    }

    async load(): Promise<void> {
        if (this.#isBusy) return;
        this.#isBusy = true;
        try {
            this.info = (await maps.getMap({ name: this.#map })).map;
            const info = this.info;
            const counters = `${info?.states} ${info?.observations} ${info?.pendingObservations} ${info?.lastUpdate?.generation}`;
            if (counters !== this.#counters && performance.now() >= this.#listAfter) {
                await this.#list();
                this.#counters = counters;
            }
            [this.problem, this.others] = ['', undefined];
        } catch (error) {
            await this.#explain(error);
        }
        this.#isBusy = false;
    }

    async #list(): Promise<void> {
        const begun = performance.now();
        const all: State[] = [];
        for (let pageToken = ''; ; ) {
            const answer = await maps.listStates({ map: this.#map, pageSize: PAGE, pageToken });
            all.push(...answer.states);
            pageToken = answer.nextPageToken;
            if (!this.isReady) await this.#open(all);
            if (!pageToken) break;
            if (!this.isListed) this.states = [...all];
        }
        this.states = byName(all);
        this.newest = newestTime(all, fromTimestamp(this.info?.lastUpdate?.cut), Date.now());
        this.isListed = true;
        this.#listAfter = performance.now() + (performance.now() - begun) / LISTING_SHARE;
    }

    async #open(states: State[]): Promise<void> {
        const now = Date.now();
        this.newest = newestTime(states, fromTimestamp(this.info?.lastUpdate?.cut), now);
        let opening = openingTime(this.newest, now);
        // A view of old data does not open at an hour when nothing happens.
        if (now - opening > DAY && hasFew(this.info, states)) {
            opening = (await busyTime(this.#map, states, opening, this.info?.timeZone ?? 'UTC').catch(() => undefined)) ?? opening;
        }
        this.opening = opening;
        this.isReady = true;
    }

    async #explain(error: unknown): Promise<void> {
        if (ConnectError.from(error).code !== Code.NotFound) {
            this.problem = message(error);
            return;
        }
        try {
            this.others = (await maps.listMaps({ pageSize: 1000 })).maps.map((map) => map.name);
        } catch (other) {
            this.problem = message(other);
        }
    }
}

const collator = new Intl.Collator('en', { numeric: true });

/** States by name; states that the daemon derives from traversals come after states that robots named. */
export function byName(states: State[]): State[] {
    return [...states].sort((a, b) => Number(a.name.includes('/')) - Number(b.name.includes('/')) || collator.compare(a.name, b.name));
}

/** Names that are similar to a name that does not exist, the most similar first. */
export function likeNames(name: string, names: string[], most = 5): string[] {
    const pairs = (text: string) => new Set(Array.from({ length: Math.max(0, text.length - 1) }, (_, at) => text.slice(at, at + 2)));
    const wanted = pairs(name.toLowerCase());
    const likeness = (other: string) => {
        const theirs = pairs(other.toLowerCase());
        let both = 0;
        for (const pair of wanted) if (theirs.has(pair)) both++;
        return (2 * both) / Math.max(1, wanted.size + theirs.size);
    };
    return names
        .map((other) => ({ other, share: likeness(other) }))
        .filter(({ share }) => share > 0.2)
        .sort((a, b) => b.share - a.share)
        .slice(0, most)
        .map(({ other }) => other);
}
