// The frame that the map shows: the frame of the wanted time as soon as it is here, and its neighbours in advance.
//
// Invariant: at most `REQUESTS_MAX` requests run for the frames that are wanted now. Frames that were wanted before are
// not waited for.

import { blend, comingFrames, frameAt, keptFrame, type Frame, type GridQuery } from './frames';
import { message } from './rpc.svelte';

const REQUESTS_MAX = 2;
const AHEAD = 6;

export class Feed {
    /** The frame to draw. */
    frame: Frame | undefined = $state.raw();
    /** The time of that frame, milliseconds. */
    shownMs = $state(Number.NaN);
    problem = $state('');
    #query: GridQuery | undefined;
    #wanted = Number.NaN;
    #base: number | undefined;
    #requests = 0;
    #mixed: Uint8Array | undefined;

    /** Whether there is a grid to show. */
    get hasGrid(): boolean {
        return this.#query !== undefined;
    }

    /** Changes the shown content; `baseMs` is the time that differences are taken from. */
    ask(query: GridQuery | undefined, baseMs: number | undefined): void {
        const isSame = JSON.stringify(query) === JSON.stringify(this.#query) && baseMs === this.#base;
        if (isSame) return;
        [this.#query, this.#base] = [query, baseMs];
        if (!query) this.frame = undefined;
        else this.#pump();
    }

    /** Shows a time, exactly. */
    show(ms: number): void {
        this.#wanted = ms;
        this.#pump();
    }

    /** Shows a time between two frames, if both are here. */
    showBetween(fromMs: number, toMs: number, share: number): boolean {
        const [from, to] = [this.#made(fromMs), this.#made(toMs)];
        if (!from || !to || from.cells.length !== to.cells.length) return false;
        this.frame = blend(from, to, share, this.#mixed);
        this.#mixed = this.frame.cells;
        this.shownMs = fromMs + (toMs - fromMs) * share;
        return true;
    }

    /** Fetches frames that will be wanted, nearest first, as long as not too many are on their way. */
    prefetch(times: number[]): void {
        const query = this.#query;
        if (!query || query.isLatest) return;
        for (const ms of times) {
            if (comingFrames() >= AHEAD) return;
            if (!keptFrame(query, ms)) void frameAt(query, ms).catch(() => {});
        }
    }

    #made(ms: number): Frame | undefined {
        if (!this.#query) return undefined;
        const frame = keptFrame(this.#query, ms);
        if (!frame || this.#base === undefined) return frame;
        const base = keptFrame(this.#query, this.#base);
        return base && { ...frame, before: base.cells };
    }

    #pump(): void {
        const [query, ms, base] = [this.#query, this.#wanted, this.#base];
        if (!query || Number.isNaN(ms)) return;
        const made = this.#made(ms);
        if (made) {
            [this.frame, this.shownMs, this.problem] = [made, ms, ''];
            return;
        }
        if (this.#requests >= REQUESTS_MAX) return;
        this.#requests++;
        const both = base === undefined ? [ms] : [ms, base];
        Promise.all(both.map((time) => frameAt(query, time)))
            .then(() => {
                // A frame on the way to the wanted one is worth showing, too.
                if (query === this.#query && base === this.#base) {
                    const frame = this.#made(ms);
                    if (frame) [this.frame, this.shownMs, this.problem] = [frame, ms, ''];
                }
            })
            .catch((error: unknown) => {
                this.problem = message(error);
                if (this.#wanted === ms) this.#wanted = Number.NaN;
            })
            .finally(() => {
                this.#requests--;
                if (this.#wanted !== ms || this.#query !== query || this.#base !== base) this.#pump();
            });
    }
}
