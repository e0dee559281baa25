// Replies to the newest request: older replies are dropped, whatever they contain and whenever they come.

import assert from 'node:assert/strict';
import { beforeEach, suite, test } from 'node:test';

import { latest, oneAtATime } from './latest';

/** A question whose answer the test gives. */
function question(): { ask: () => Promise<string>; answer: (text: string) => void; fail: (error: Error) => void } {
    let [answer, fail]: [(text: string) => void, (error: Error) => void] = [() => {}, () => {}];
    const promise = new Promise<string>((resolve, reject) => ([answer, fail] = [resolve, reject]));
    return { ask: () => promise, answer, fail };
}

let heard: string[];
const got = (answer: string) => void heard.push(answer);
const failed = (problem: string) => void heard.push(`problem: ${problem}`);
/** Waits until the replies have arrived. */
const settle = () => new Promise((done) => setTimeout(done));

beforeEach(() => {
    heard = [];
});

suite('the newest question', () => {
    test('has its answer', async () => {
        const { ask, answer } = question();
        latest(ask, got, failed);
        answer('open');
        await settle();
        assert.deepEqual(heard, ['open']);
    });

    test('has its problem in words', async () => {
        const { ask, fail } = question();
        latest(ask, got, failed);
        fail(new Error('there is no door'));
        await settle();
        assert.deepEqual(heard, ['problem: there is no door']);
    });

    test('is asked after a rest', async () => {
        let asked = 0;
        latest(() => Promise.resolve(String(++asked)), got, failed, 5);
        assert.equal(asked, 0);
        while (heard.length === 0) await settle();
        assert.deepEqual(heard, ['1']);
    });
});

suite('an older question', () => {
    test('has no answer, and no problem', async () => {
        const [first, second] = [question(), question()];
        const drops = [first, second].map(({ ask }) => latest(ask, got, failed));
        for (const drop of drops) drop();
        const newest = question();
        latest(newest.ask, got, failed);
        newest.answer('newest');
        first.answer('oldest');
        second.fail(new Error('too late'));
        await settle();
        assert.deepEqual(heard, ['newest']);
    });

    test('that still rests is not asked', async () => {
        let asked = 0;
        latest(() => Promise.resolve(String(++asked)), got, failed, 1)();
        latest(() => Promise.resolve('newest'), got, failed, 10);
        while (heard.length === 0) await settle();
        assert.equal(asked, 0);
    });
});

test('one question runs at a time, and of those that wait the newest', async () => {
    const asked: number[] = [];
    let answer: () => void = () => {};
    const ask = oneAtATime();
    const question = (number: number) => () => {
        asked.push(number);
        return new Promise<void>((done) => (answer = done));
    };
    for (const number of [1, 2, 3]) ask(question(number));
    assert.deepEqual(asked, [1]);
    answer();
    await new Promise((done) => setTimeout(done));
    assert.deepEqual(asked, [1, 3]);
    answer();
    await new Promise((done) => setTimeout(done));
    ask(question(4));
    assert.deepEqual(asked, [1, 3, 4]);
});
