// Plays time: frames are fetched at steps in advance, and times between them are blended.
//
// Invariant: time goes on only where both frames around it are here, so that nothing is shown that was not predicted.

import { addDays, DAY } from './civil';
import type { Feed } from './feed.svelte';
import { SPANS, type SpanName } from './spans';

/** Number of frames to fetch in advance. */
const AHEAD = 8;
/** The least time between two calls of `onmove` while it plays. */
const MOVE_EVERY_MS = 100;

export class Player {
    isPlaying = $state(false);
    /** The time that is shown, milliseconds. */
    ms = $state(0);
    #feed: Feed;
    #onmove: (ms: number) => void;
    #request = 0;

    constructor(feed: Feed, onmove: (ms: number) => void) {
        this.#feed = feed;
        this.#onmove = onmove;
    }

    /** Plays from a time on; `speed` is how many times as fast as the span's own pace. */
    start(at: number, span: SpanName, zone: string, speed = 1): void {
        const { frameMs } = SPANS[span];
        const pace = SPANS[span].pace * speed;
        const step = (ms: number, count: number) => (frameMs === DAY ? addDays(ms, count, zone) : ms + count * frameMs);
        this.isPlaying = true;
        this.ms = at;
        // The frames around the time that is shown.
        let [from, to] = [at, frameMs === DAY ? step(at, 1) : (Math.floor(at / frameMs) + 1) * frameMs];
        let before: number | undefined;
        let movedAt = 0;
        // Without a grid there is nothing to wait for.
        const isShown = (earlier: number, later: number, share: number) =>
            !this.#feed.hasGrid || this.#feed.showBetween(earlier, later, share);
        const tick = (now: number) => {
            if (!this.isPlaying) return;
            this.#request = requestAnimationFrame(tick);
            const passed = Math.min(100, now - (before ?? now));
            before = now;
            const next = this.ms + (passed / 1000) * pace;
            if (next >= to) {
                const [reached, later] = [to, step(to, 1)];
                if (isShown(reached, later, 0)) [from, to, this.ms] = [reached, later, Math.min(next, later)];
            } else if (isShown(from, to, (next - from) / (to - from))) {
                this.ms = next;
            }
            this.#feed.prefetch([from, ...Array.from({ length: AHEAD }, (_, index) => step(to, index))]);
            if (now - movedAt > MOVE_EVERY_MS) {
                movedAt = now;
                this.#onmove(this.ms);
            }
        };
        this.#request = requestAnimationFrame(tick);
    }

    stop(): void {
        if (!this.isPlaying) return;
        this.isPlaying = false;
        cancelAnimationFrame(this.#request);
        this.#onmove(this.ms);
    }
}
