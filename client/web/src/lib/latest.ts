// Answers to the newest question of a view.
//
// Invariant of `latest`: after an effect has asked anew or has ended, nothing of an older question arrives, neither its
// answer nor its problem.

import { message } from './rpc.svelte';

/**
 * Asks, and hands over the answer or what is wrong with it, in words. Returns what drops both; for an effect, which
 * returns it. With `restMs` it asks only after so long, so that a slider which moves asks once.
 */
export function latest<T>(ask: () => Promise<T>, got: (answer: T) => void, failed: (problem: string) => void, restMs = 0): () => void {
    let isDropped = false;
    const run = () => {
        ask().then(
            (answer) => {
                if (!isDropped) got(answer);
            },
            (error: unknown) => {
                if (!isDropped) failed(message(error));
            },
        );
    };
    const timer = restMs > 0 ? setTimeout(run, restMs) : undefined;
    if (timer === undefined) run();
    return () => {
        isDropped = true;
        clearTimeout(timer);
    };
}

/**
 * Runs one question at a time; while it waits, the newest of further ones is kept, and the others are never asked. For
 * what changes all the time: `latest` would drop each answer before it comes.
 */
export function oneAtATime(): (ask: () => Promise<void>) => void {
    const waiting: (() => Promise<void>)[] = [];
    let isAsking = false;
    const runAll = async () => {
        isAsking = true;
        for (let run = waiting.pop(); run; run = waiting.pop()) await run();
        isAsking = false;
    };
    return (ask) => {
        waiting.splice(0, 1, ask);
        if (!isAsking) void runAll();
    };
}
