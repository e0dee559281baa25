import assert from 'node:assert/strict';
import { test } from 'node:test';

import { complaint, isMapName, LineReader, mapNameOf, pathFor } from './recordings';

test('a map is named after its file', () => {
    const names = { 'drive.bag': 'drive', 'Office Tour_2.mcap': 'office-tour_2', 'a.mcap.zstd': 'a', 'Büro.db3': 'buro', '2025-01-06_10.30.bag': '2025-01-06_10-30', '__.bag': 'recording', '漢.mcap': 'recording' };
    for (const [file, name] of Object.entries(names)) {
        assert.equal(mapNameOf(file), name);
        assert.ok(isMapName(name));
    }
    assert.equal(mapNameOf(`${'x'.repeat(100)}.bag`).length, 63);
    for (const text of ['', '-a', 'A', 'a b', 'x'.repeat(64)]) assert.ok(!isMapName(text), text);
});

test('what is no recording is named', () => {
    assert.equal(complaint([{ name: 'A.BAG', isFolder: false }, { name: 'b.mcap.zstd', isFolder: false }]), '');
    assert.match(complaint([{ name: 'rosbag2_1', isFolder: true }]), /rosbag2_1 is a folder.*\.mcap or \.db3.*tidemap import/);
    assert.match(complaint([{ name: 'a.bag', isFolder: false }, { name: 'notes.txt', isFolder: false }]), /notes\.txt is no recording/);
    assert.match(complaint([]), /no file/);
});

test('lines are read once, and only when they are whole', () => {
    const reader = new LineReader();
    assert.deepEqual(reader.next('{"line":"a"}\n{"li'), [{ line: 'a' }]);
    assert.deepEqual(reader.next('{"line":"a"}\n{"line":"b"}'), []);
    assert.deepEqual(reader.next('{"line":"a"}\n{"line":"b"}\n{"done":true,"exit":0}\n'), [{ line: 'b' }, { done: true, exit: 0 }]);
});

test('a path keeps every name whole', () => {
    assert.equal(pathFor('room', 'a b/ü.bag', { producer: 'robot 1+2' }), '/api/v1/maps/room/recordings/a%20b%2F%C3%BC.bag?producer=robot%201%2B2');
    assert.equal(pathFor('room', 'u\u0308.bag', {}), '/api/v1/maps/room/recordings/%C3%BC.bag?');
});
