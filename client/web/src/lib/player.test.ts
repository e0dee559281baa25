// The player: time goes on at the pace of its span, and waits for frames where there is a grid.

import assert from 'node:assert/strict';
import { beforeEach, suite, test } from 'node:test';

import { DAY, HOUR, MINUTE } from './civil';
import type { Feed } from './feed.svelte';
import { Player } from './player.svelte';

const START = Date.parse('2025-06-10T10:20Z');

let waiting: ((now: number) => void) | undefined;
let clockMs = 1000;
Object.assign(globalThis, {
    requestAnimationFrame: (callback: (now: number) => void) => {
        waiting = callback;
        return 1;
    },
    cancelAnimationFrame: () => {
        waiting = undefined;
    },
});

/** Makes the browser draw this many pictures, 50 ms apart. */
function pictures(count: number): void {
    for (; count > 0; count--) {
        clockMs += 50;
        waiting?.(clockMs);
    }
}

/** A feed that has the frames up to a time. */
class Frames {
    hasGrid = true;
    until = Infinity;
    shown: [number, number, number][] = [];
    wanted: number[] = [];

    showBetween(from: number, to: number, share: number): boolean {
        if (!this.hasGrid || to > this.until) return false;
        this.shown.push([from, to, share]);
        return true;
    }

    prefetch(times: number[]): void {
        this.wanted = times;
    }
}

let feed: Frames;
let moves: number[];
let player: Player;

beforeEach(() => {
    feed = new Frames();
    moves = [];
    player = new Player(feed as unknown as Feed, (ms) => moves.push(ms));
});

suite('a player', () => {
    test('goes on by the pace of its span, between frames on whole steps', () => {
        player.start(START, 'day', 'UTC');
        // The first picture begins; twenty more take a second: two hours.
        pictures(21);
        assert.ok(Math.abs(player.ms - (START + 2 * HOUR)) < MINUTE, `${(player.ms - START) / HOUR} h`);
        assert.deepEqual(feed.shown[0], [START, START + 10 * MINUTE, 0]);
        for (const [from, to, share] of feed.shown.slice(1)) {
            assert.ok(share >= 0 && share <= 1);
            assert.equal(to % (15 * MINUTE), 0);
            assert.ok(from === START || to - from === 15 * MINUTE);
        }
    });

    test('takes days of the zone as the steps of a year', () => {
        player.start(Date.parse('2025-03-29T11:00Z'), 'year', 'Europe/Berlin');
        pictures(21);
        const [first] = feed.shown;
        assert.deepEqual(first?.slice(0, 2), [Date.parse('2025-03-29T11:00Z'), Date.parse('2025-03-30T10:00Z')]);
        assert.ok(Math.abs(player.ms - (Date.parse('2025-03-29T11:00Z') + 7 * DAY)) < HOUR);
    });

    test('waits at the last frame that is here, and goes on when the next has come', () => {
        player.start(START, 'day', 'UTC');
        feed.until = START + 25 * MINUTE;
        pictures(40);
        assert.ok(player.ms <= feed.until && player.ms >= feed.until - 7 * MINUTE, `${(player.ms - START) / MINUTE} min`);
        feed.until = Infinity;
        pictures(10);
        assert.ok(player.ms > START + 40 * MINUTE);
    });

    test('asks for frames ahead, nearest first', () => {
        player.start(START, 'week', 'UTC');
        pictures(1);
        const next = Date.parse('2025-06-10T11:00Z');
        assert.deepEqual(feed.wanted.slice(0, 4), [START, next, next + HOUR, next + 2 * HOUR]);
    });

    test('does not wait where there is no grid', () => {
        feed.hasGrid = false;
        player.start(START, 'day', 'UTC');
        pictures(41);
        assert.ok(player.ms > START + 3 * HOUR, `${(player.ms - START) / MINUTE} min`);
    });

    test('does not leap over a time in which the browser drew nothing', () => {
        player.start(START, 'day', 'UTC');
        pictures(2);
        const before = player.ms;
        clockMs += 60_000;
        pictures(1);
        assert.ok(player.ms - before <= 0.1 * 2 * HOUR);
    });

    test('says where it is at most ten times a second, and once more when it stops', () => {
        player.start(START, 'day', 'UTC');
        pictures(21);
        assert.ok(moves.length >= 5 && moves.length <= 10, `${moves.length}`);
        player.stop();
        assert.equal(moves.at(-1), player.ms);
        const { ms } = player;
        pictures(5);
        assert.deepEqual([player.ms, player.isPlaying], [ms, false]);
        const { length } = moves;
        player.stop();
        assert.equal(moves.length, length);
    });
});
