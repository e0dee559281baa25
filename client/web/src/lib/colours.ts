// The painter of the page: the same colours by the same rule as all pictures of the daemon and the command line.
//
// Invariant: a colour means one probability that something is 1, wherever it is: a cell, an edge, a place, an hour of a
// row. On a light ground 0 is white and 1 is black; on a dark ground the same colours are in the other order. What is
// unknown is grey. Cells are bytes: 255 is unknown, 0 to 254 are probabilities from 0 to 1.

import { FREER, FULLER, MUTED, OCCUPANCY, UNCERTAIN, UNKNOWN_COLOUR, type Colour } from './palette';
import { isDark } from './scheme.svelte';

/** The colour of unknown values on a dark ground. */
const UNKNOWN_DARK: Colour = [66, 73, 82];

/** The byte of a cell that is not known. */
export const UNKNOWN = 255;
/** The byte of the value 1. */
export const FULL = 254;

export type Layer = 'probability' | 'entropy' | 'difference' | 'seen' | 'look';

/** The probabilities after a free and after an occupied reading of the map's sensor. */
export interface Levels {
    free: number;
    occupied: number;
}

/** The levels of a sensor; a prior of 0 on the wire is 0.5. */
export function levelsOf({ hit, falseAlarm, prior }: { hit: number; falseAlarm: number; prior: number }): Levels {
    const before = prior || 0.5;
    const posterior = (ifOccupied: number, ifFree: number) =>
        (ifOccupied * before) / (ifOccupied * before + ifFree * (1 - before));
    return { free: posterior(1 - hit, 1 - falseAlarm), occupied: posterior(hit, falseAlarm) };
}

/** Levels of a sensor that is always right. */
export const SURE: Levels = { free: 0, occupied: 1 };

/**
 * Pixels as canvas keeps them: at the byte of a cell, or for differences at `256 * before + now`.
 */
export type Palette = Uint32Array;

function blend(from: Colour, to: Colour, share: number): Colour {
    const band = (index: 0 | 1 | 2) => Math.floor(from[index] + (to[index] - from[index]) * share + 0.5);
    return [band(0), band(1), band(2)];
}

/** A value from 0 to 1; NaN is 0. */
const within = (value: number) => Math.max(0, Math.min(1, value || 0));

function mix(stops: Colour[], share: number): Colour {
    const at = within(isDark() ? 1 - within(share) : share) * (stops.length - 1);
    const low = Math.min(stops.length - 2, Math.floor(at));
    return blend(stops[low] ?? UNKNOWN_COLOUR, stops[low + 1] ?? UNKNOWN_COLOUR, at - low);
}

/** Entropy of a probability, bits. */
export function entropyBits(probability: number): number {
    if (probability <= 0 || probability >= 1) return 0;
    return -(probability * Math.log2(probability) + (1 - probability) * Math.log2(1 - probability));
}

/** The colour of the value of a cell in a layer, over the map with this share of the way from free to occupied. */
export function colourOf(layer: Layer, value: number, beneath: number): Colour {
    // The information gain lies over the map.
    if (layer === 'look') return mix(MUTED, beneath);
    if (layer === 'entropy') return blend(mix(MUTED, beneath), UNCERTAIN, within(value));
    if (layer === 'difference') return blend(mix(MUTED, beneath), value < 0 ? FREER : FULLER, within(Math.abs(value)));
    return mix(OCCUPANCY, beneath);
}

const style = (colour: Colour) => `rgb(${colour.join(' ')})`;

/** The colour of a probability, for styles. */
export function occupancy(value: number): string {
    return style(mix(OCCUPANCY, value));
}

/** The colour of the share of a number in its range, for styles: no colour of a probability. */
export function amount(share: number): string {
    const grey = Math.round(235 - 170 * (isDark() ? 1 - within(share) : within(share)));
    return style([grey, grey + 4, Math.min(255, grey + 12)]);
}

const unknownColour = () => (isDark() ? UNKNOWN_DARK : UNKNOWN_COLOUR);

/** The colour of unknown values, for styles. */
export const unknown = () => style(unknownColour());

function pixel([red, green, blue]: Colour): number {
    return ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
}

/** The value of a cell in a layer, for a cell that was `before` at another time. */
function valueOf(layer: Layer, now: number, before: number): number {
    return layer === 'entropy' ? entropyBits(now) : layer === 'difference' ? now - before : now;
}

function paint(layer: Layer, { free, occupied }: Levels, now: number, before: number): number {
    if (now === UNKNOWN || before === UNKNOWN) return pixel(unknownColour());
    // Levels as bytes have them, so that what never changes is white or black.
    const [low, high] = [Math.round(free * FULL), Math.round(occupied * FULL)];
    return pixel(colourOf(layer, valueOf(layer, now / FULL, before / FULL), (now - low) / (high - low)));
}

/** The colours of the cells of a map in a layer. */
export function paletteOf(layer: Layer, levels: Levels): Palette {
    if (layer !== 'difference') return Uint32Array.from({ length: 256 }, (_, now) => paint(layer, levels, now, now));
    return Uint32Array.from({ length: 1 << 16 }, (_, index) => paint(layer, levels, index & 255, index >> 8));
}

/** The colour of an information gain, over the map, for styles; the greatest gain is 1. */
export function gain(value: number): string {
    return `rgb(${isDark() ? '107 171 255' : '26 79 163'} / ${(0.08 + 0.72 * within(value)).toFixed(3)})`;
}

/** The colours of a number from the least to the greatest, as a gradient for a legend. */
export function amounts(): string {
    return `linear-gradient(to right, ${amount(0)}, ${amount(1)})`;
}

/** The colours of a layer from its lowest value to its highest over free cells, as a gradient for a legend. */
export function gradient(layer: Layer): string {
    const steps = Array.from({ length: 33 }, (_, step) => step / 32);
    if (layer === 'look') return `linear-gradient(to right, ${gain(0)}, ${gain(1)})`;
    const colour = (share: number) => {
        if (layer === 'difference') return colourOf(layer, 2 * share - 1, 0);
        return colourOf(layer, share, layer === 'entropy' ? 0 : share);
    };
    return `linear-gradient(to right, ${steps.map((share) => style(colour(share))).join(', ')})`;
}
