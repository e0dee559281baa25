// Names of models for people.

import { HistogramCycle, ModelKind, type ModelSelector } from '../wire/tidemap/v1/types_pb';

const NAMES: Partial<Record<ModelKind, string>> = {
    [ModelKind.AUTO]: 'auto',
    [ModelKind.MEAN]: 'mean',
    [ModelKind.LATEST]: 'latest',
    [ModelKind.SPECTRAL]: 'spectral',
    [ModelKind.PERSISTENCE]: 'persistence',
    [ModelKind.HISTOGRAM]: 'histogram',
    [ModelKind.PERGAM]: 'PerGaM',
    [ModelKind.HYPERTIME_EM]: 'hypertime (EM)',
    [ModelKind.HYPERTIME_KM]: 'hypertime (k-means)',
    [ModelKind.POISSON]: 'Poisson',
    [ModelKind.CALIBRATED]: 'calibrated',
    [ModelKind.UNIFORM]: 'uniform',
    [ModelKind.ENSEMBLE]: 'ensemble',
};
const CYCLES: Partial<Record<HistogramCycle, string>> = {
    [HistogramCycle.DAY]: 'day',
    [HistogramCycle.WEEK]: 'week',
    [HistogramCycle.WEEKDAY_WEEKEND]: 'weekday and weekend',
};

/** The kinds that the page compares. */
export const COMPARED = [
    ModelKind.AUTO,
    // The default model without the newest readings.
    ModelKind.ENSEMBLE,
    ModelKind.MEAN,
    ModelKind.SPECTRAL,
    ModelKind.HISTOGRAM,
    ModelKind.CALIBRATED,
    ModelKind.PERGAM,
    ModelKind.HYPERTIME_EM,
    ModelKind.POISSON,
];

/** Whether a request for this kind can have an order. */
export function hasOrders(kind: ModelKind): boolean {
    return kind === ModelKind.AUTO || kind === ModelKind.SPECTRAL;
}

/** The name of a kind. */
export function kindName(kind: ModelKind): string {
    return NAMES[kind] ?? `model ${kind}`;
}

/** A model with its parameters. */
export function modelName(model: ModelSelector | undefined): string {
    if (!model) return 'none';
    const parts = [kindName(model.kind)];
    if (model.kind === ModelKind.HISTOGRAM) parts.push(`of the ${CYCLES[model.cycle] ?? 'day'}`);
    if (model.order !== undefined) parts.push(`of order ${model.order}`);
    if (model.parameter !== undefined) parts.push(`(${model.parameter})`);
    return parts.join(' ');
}
