// Colour maps that colour-blind people can read, as tables of 256 colours.
//
// Invariant: entry 255 is for what is not known, and is transparent; entries 0 to 254 stand for 0 to 1.

/** The index of a value that is not known. */
export const UNKNOWN = 255;
/** The index that stands for 1. */
export const FULL = 254;

/** A table of colours: 256 pixels, as canvas keeps them. */
export type Palette = Uint32Array;

const VIRIDIS = [
    [68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129], [92, 200, 99], [170, 220, 50],
    [253, 231, 37],
];
const CIVIDIS = [
    [0, 32, 77], [0, 51, 111], [57, 72, 107], [87, 93, 109], [112, 113, 115], [138, 134, 120], [166, 157, 117], [196, 182, 108],
    [255, 234, 70],
];
// Blue to orange by way of grey: the two ends stay apart in every common colour blindness.
const CHANGE = [
    [33, 102, 172], [67, 147, 195], [146, 197, 222], [197, 205, 212], [200, 200, 200], [222, 208, 190], [253, 184, 99],
    [224, 130, 20], [179, 88, 6],
];

function mix(stops: number[][], share: number): [number, number, number] {
    const at = Math.min(1, Math.max(0, share)) * (stops.length - 1);
    const low = Math.min(stops.length - 2, Math.floor(at));
    const [from, to] = [stops[low] ?? [0, 0, 0], stops[low + 1] ?? [0, 0, 0]];
    const channel = (index: number) => Math.round((from[index] ?? 0) + ((to[index] ?? 0) - (from[index] ?? 0)) * (at - low));
    return [channel(0), channel(1), channel(2)];
}

function table(colour: (share: number) => [number, number, number]): Palette {
    const palette = new Uint32Array(256);
    for (let index = 0; index <= FULL; index++) {
        const [red, green, blue] = colour(index / FULL);
        palette[index] = ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
    }
    return palette;
}

/** Entropy of a probability, bits. */
export function entropyBits(probability: number): number {
    if (probability <= 0 || probability >= 1) return 0;
    return -(probability * Math.log2(probability) + (1 - probability) * Math.log2(1 - probability));
}

/** What a layer shows of a probability. */
export const PALETTES = {
    probability: table((share) => mix(VIRIDIS, share)),
    entropy: table((share) => mix(CIVIDIS, entropyBits(share))),
    seen: table((share) => mix(VIRIDIS, share)),
    /** Of (difference + 1) / 2. */
    difference: table((share) => mix(CHANGE, share)),
} as const;

/** A colour of viridis for styles. */
export function viridis(share: number): string {
    return `rgb(${mix(VIRIDIS, share).join(' ')})`;
}

/** The colours of a layer from 0 to 1, as a gradient for a legend. */
export function gradient(layer: keyof typeof PALETTES): string {
    const stops = layer === 'entropy' ? CIVIDIS : layer === 'difference' ? CHANGE : VIRIDIS;
    return `linear-gradient(to right, ${stops.map((stop) => `rgb(${stop.join(' ')})`).join(', ')})`;
}
