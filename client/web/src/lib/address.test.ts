// The address of the page: paths of views, and the parameters that are read from them.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { address, go, pathOf, setParams } from './address.svelte';

test('paths of views name a map, with percent signs where they are needed', () => {
    assert.deepEqual([pathOf('maps'), pathOf('states'), pathOf('operations')], ['/', '/states', '/operations']);
    assert.equal(pathOf('maps', 'home'), '/maps/home');
    assert.equal(pathOf('states', 'floor 1/a%'), '/states/floor%201%2Fa%25');
});

test('an address brings its view back', () => {
    for (const name of ['home', 'floor 1/a%', 'Büro?x=1#y']) {
        go(`${pathOf('states', name)}?at=5&layer=entropy`);
        assert.deepEqual({ ...address }, { view: 'states', map: name, params: { at: '5', layer: 'entropy' } });
    }
    go('/operations');
    assert.deepEqual({ ...address }, { view: 'operations', map: '', params: {} });
});

test('an address that is no view is the list of maps, and a broken name is taken as it is', () => {
    go('/nonsense');
    assert.deepEqual([address.view, address.map], ['maps', '']);
    go('/maps/50%');
    assert.equal(address.map, '50%');
});

test('parameters are written into the address at once, further changes after a moment, and empty ones never', async () => {
    go('/maps/home?at=5&layer=seen');
    setParams({ at: '7', layer: '', span: 'week' });
    assert.deepEqual({ ...address.params }, { at: '7', span: 'week' });
    assert.equal(window.location.search, '?at=7&span=week');
    setParams({ at: '8' });
    setParams({ at: '9' });
    assert.equal(window.location.search, '?at=7&span=week');
    while (window.location.search === '?at=7&span=week') await new Promise((done) => setTimeout(done, 20));
    assert.equal(window.location.search, '?at=9&span=week');
});

test('the way back in the history is followed', () => {
    go('/maps/home');
    Object.assign(window.location, { pathname: '/states/lab', search: '?at=1' });
    window.dispatchEvent(new Event('popstate'));
    assert.deepEqual({ ...address }, { view: 'states', map: 'lab', params: { at: '1' } });
});
