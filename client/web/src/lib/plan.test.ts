// Content of a plan: places without a position, the element at a point, and the scale bar.

import assert from 'node:assert/strict';
import { suite, test } from 'node:test';

import { around, placeNodes, planAt, scaleBar, type Plan } from './plan';

const near = (found: number, expected: number) => assert.ok(Math.abs(found - expected) < 1e-9, `${found}, not ${expected}`);

test('nodes with a position stay there, in their order', () => {
    assert.deepEqual(placeNodes([{ name: 'b', pose: { xM: 3, yM: -1 } }, { name: 'a', pose: { xM: 0, yM: 2 } }]), [
        { name: 'b', x: 3, y: -1 }, { name: 'a', x: 0, y: 2 },
    ]);
    assert.deepEqual(placeNodes([]), []);
});

test('nodes without one lie evenly on a circle that holds all others', () => {
    const posed = [[10, 10], [16, 18], [12, 11]].map(([xM = 0, yM = 0], index) => ({ name: `at${index}`, pose: { xM, yM } }));
    const loose = ['one', 'two', 'three', 'four'].map((name) => ({ name }));
    const placed = placeNodes([...posed, ...loose]).slice(posed.length);
    for (const node of placed) {
        near(Math.hypot(node.x - 13, node.y - 14), 8);
        for (const { pose } of posed) assert.ok(Math.hypot(pose.xM - 13, pose.yM - 14) < 8 - 1);
    }
    const [one, two, three] = placed;
    assert.ok(one && two && three);
    near(one.y, 22);
    near(two.x, 21);
    near(three.y, 6);
});

test('a map without any position is a circle around its origin', () => {
    const placed = placeNodes(Array.from({ length: 20 }, (_, index) => ({ name: `${index}` })));
    for (const node of placed) near(Math.hypot(node.x, node.y), 20);
    assert.equal(new Set(placed.map((node) => `${node.x.toFixed(3)} ${node.y.toFixed(3)}`)).size, 20);
    assert.equal(placeNodes([{ name: 'only' }])[0]?.y, 6);
});

suite('what lies at a point', () => {
    const edge = { from: 'a', to: 'b', reports: 1, title: '', state: 'edge/a/b' };
    const plan: Plan = { nodes: [{ name: 'a', x: 0, y: 0 }, { name: 'b', x: 10, y: 0 }], edges: [edge, { ...edge, to: 'attic' }], paths: [], squares: [] };
    const at = (x: number, y: number) => {
        const found = planAt(plan, x, y, 1, 0.5);
        return found && ('node' in found ? found.node.name : 'mark' in found ? found.mark.name : found.edge.state);
    };

    test('is the nearest node, else the edge beside it, else nothing', () => {
        assert.deepEqual([at(0.4, 0.2), at(9.5, 0), at(5, 0.4), at(5, 0.6), at(-2, 0)], ['a', 'b', 'edge/a/b', undefined, undefined]);
        plan.marks = [{ name: 'robot', x: 0.5, y: 0, title: '' }];
        assert.equal(at(0.4, 0.2), 'robot');
    });
});

test('the scale bar is 1, 2 or 5 of a power of ten, and not longer than asked', () => {
    assert.deepEqual([10, 11, 25, 60, 0.02, 400].map((scale) => scaleBar(scale, 110)), [10, 10, 2, 1, 5000, 0.2]);
});

test('the rectangle around two, one or none', () => {
    const [one, other] = [{ minX: 0, minY: -2, maxX: 4, maxY: 1 }, { minX: -1, minY: 0, maxX: 3, maxY: 5 }];
    assert.deepEqual(around(one, other), { minX: -1, minY: -2, maxX: 4, maxY: 5 });
    assert.deepEqual([around(one, undefined), around(undefined, other), around(undefined, undefined)], [one, other, undefined]);
});
