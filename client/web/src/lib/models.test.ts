// Names of models.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { create } from '@bufbuild/protobuf';

import { HistogramCycle, ModelKind, ModelSelectorSchema } from '../wire/tidemap/v1/types_pb';
import { kindName, modelName } from './models';

test('every kind of the wire has a name of its own', () => {
    const kinds = Object.values(ModelKind).filter((kind): kind is ModelKind => typeof kind === 'number' && kind !== ModelKind.UNSPECIFIED);
    const names = kinds.map(kindName);
    assert.deepEqual(names.filter((name) => name.startsWith('model ')), []);
    assert.equal(new Set(names).size, kinds.length);
});

test('a kind of a newer daemon is named by its number', () => {
    assert.equal(kindName(99 as ModelKind), 'model 99');
});

test('the name of a model says its parameters', () => {
    const name = (model: Parameters<typeof create<typeof ModelSelectorSchema>>[1]) => modelName(create(ModelSelectorSchema, model));
    assert.equal(modelName(undefined), 'none');
    assert.equal(name({ kind: ModelKind.MEAN }), 'mean');
    assert.equal(name({ kind: ModelKind.SPECTRAL, order: 3 }), 'spectral of order 3');
    assert.equal(name({ kind: ModelKind.SPECTRAL, order: 0 }), 'spectral of order 0');
    assert.equal(name({ kind: ModelKind.PERSISTENCE, parameter: 0.5 }), 'persistence (0.5)');
});

test('every cycle of a histogram has a name of its own', () => {
    const cycles = Object.values(HistogramCycle).filter((cycle): cycle is HistogramCycle => typeof cycle === 'number' && cycle !== 0);
    const names = cycles.map((cycle) => modelName(create(ModelSelectorSchema, { kind: ModelKind.HISTOGRAM, cycle })));
    assert.equal(new Set(names).size, cycles.length, names.join(', '));
    assert.ok(names.includes('histogram of the weekday and weekend'));
    assert.equal(modelName(create(ModelSelectorSchema, { kind: ModelKind.HISTOGRAM })), 'histogram of the day');
});
