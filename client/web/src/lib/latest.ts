// Answers to the newest question of a view.
//
// Invariant of `latest`: after an effect has sent a new request or has ended, nothing of an older request arrives,
// neither its reply nor its problem.

import { message } from './rpc.svelte';

/**
 * Sends a request, and hands over the reply or its problem, in words. Returns a function that drops both; an effect
 * returns this function. With `restMs` the request is sent only after this time, so that a moving slider sends one.
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
 * Runs one request at a time; while it waits, the newest of further requests is kept, and the others are never sent.
 * For values that change all the time: `latest` would drop each reply before it comes.
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
