// The texts of the page for errors, and when it takes the daemon to be away.

import assert from 'node:assert/strict';
import { beforeEach, suite, test } from 'node:test';

import { Code, ConnectError } from '@connectrpc/connect';

import { heartbeat, link, maps, message, setToken } from './rpc.svelte';

let headers: Headers[];
let isReady: boolean;

beforeEach(() => {
    headers = [];
    isReady = false;
    globalThis.fetch = (input, init) => {
        if (input === '/readyz') return isReady ? Promise.resolve(new Response('ok')) : Promise.reject(new TypeError('refused'));
        headers.push(new Headers(init?.headers));
        return Promise.resolve(new Response(null, { status: 500 }));
    };
    Object.assign(link, { isAway: false, needsToken: false, refusal: '' });
});

suite('errors', () => {
    test('are shown in the words of the daemon', () => {
        assert.equal(message(new ConnectError('there is no map', Code.NotFound)), 'there is no map');
        assert.equal(message(new Error('broken')), 'broken');
        assert.deepEqual([link.isAway, link.needsToken], [false, false]);
    });

    test('of what nobody waits for any more are not shown', () => {
        assert.equal(message(new ConnectError('stopped', Code.Canceled)), '');
    });

    test('of a missing token ask for one, and say what was wrong with the one that was given', () => {
        setToken('');
        assert.equal(message(new ConnectError('no token', Code.Unauthenticated)), '');
        assert.deepEqual([link.needsToken, link.refusal], [true, '']);
        const { epoch } = link;
        setToken(' secret \n');
        assert.deepEqual([link.needsToken, link.epoch], [false, epoch + 1]);
        message(new ConnectError('the token has expired', Code.Unauthenticated));
        assert.deepEqual([link.needsToken, link.refusal], [true, 'the token has expired']);
    });

    test('of a broken connection mean that the daemon is away, until it is ready again', async () => {
        const { epoch } = link;
        isReady = true;
        assert.equal(message(new TypeError('fetch failed')), '');
        assert.equal(message(new ConnectError('gone', Code.Unknown, undefined, undefined, new TypeError('fetch failed'))), '');
        assert.deepEqual([link.isAway, link.epoch], [true, epoch]);
        while (link.isAway) await new Promise((done) => setTimeout(done, 20));
        assert.equal(link.epoch, epoch + 1);
    });
});

test('calls carry the token as it was given, without the space around it', async () => {
    setToken(' secret \n');
    await assert.rejects(maps.listMaps({}));
    setToken('');
    await assert.rejects(maps.listMaps({}));
    assert.deepEqual(headers.map((given) => given.get('authorization')), ['Bearer secret', null]);
});

suite('a daemon that hangs', () => {
    let canAnswer: boolean;
    beforeEach(() => {
        canAnswer = false;
        Object.assign(globalThis, { document: { hidden: false } });
        globalThis.fetch = (input, init) =>
            new Promise((done, failed) => {
                if (input === '/readyz' && canAnswer) done(new Response('ok'));
                init?.signal?.addEventListener('abort', () => failed(init.signal?.reason as Error));
            });
    });

    test('is away, and nothing waits for it, until it answers', async () => {
        const { epoch } = link;
        const stop = heartbeat(5, 20);
        const call = maps.listMaps({});
        await assert.rejects(call, (error) => message(error) === '');
        assert.ok(link.isAway);
        canAnswer = true;
        while (link.isAway) await new Promise((done) => setTimeout(done, 20));
        assert.equal(link.epoch, epoch + 1);
        stop();
    });

    test('behind a proxy is away, too', async () => {
        globalThis.fetch = () => Promise.resolve(new Response(null, { status: 502 }));
        const stop = heartbeat(5, 20);
        while (!link.isAway) await new Promise((done) => setTimeout(done, 5));
        stop();
        globalThis.fetch = () => Promise.resolve(new Response('ok'));
        while (link.isAway) await new Promise((done) => setTimeout(done, 20));
    });
});
