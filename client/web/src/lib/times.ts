// Times of the page (milliseconds) and of the wire.

import { timestampFromMs, type Timestamp } from '@bufbuild/protobuf/wkt';

const NANOS_PER_MS = 1_000_000n;

/** The first instant that the wire has, milliseconds: a week of a simulated clock begins before it. */
const FIRST_MS = 1;

/** Milliseconds as nanoseconds of the wire. */
export function toNanos(ms: number): bigint {
    return BigInt(Math.max(FIRST_MS, Math.round(ms))) * NANOS_PER_MS;
}

/** Nanoseconds of the wire as milliseconds. */
export function fromNanos(nanos: bigint): number {
    return Number(nanos / NANOS_PER_MS);
}

/** A time as a message of the wire. */
export function toTimestamp(ms: number): Timestamp {
    return timestampFromMs(Math.max(FIRST_MS, Math.round(ms)));
}

/** Milliseconds of a message; `undefined` if there is none. */
export function fromTimestamp(time: Timestamp | undefined): number | undefined {
    return time && Number(time.seconds) * 1000 + time.nanos / 1e6;
}
