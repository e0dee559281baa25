//! Small wire types that carry over to plain ones: instants and spans.
//!
//! Invariant: an instant of the daemon is i64 nanoseconds UTC; one that does not fit is as if it were absent.

use prost_types::{Duration, Timestamp};

/// Nanoseconds in a second.
const NANOS_PER_SEC: i64 = 1_000_000_000;

pub(crate) fn timestamp(nanos: i64) -> Timestamp {
    let fraction = i32::try_from(nanos.rem_euclid(NANOS_PER_SEC)).unwrap_or(0);
    Timestamp { seconds: nanos.div_euclid(NANOS_PER_SEC), nanos: fraction }
}

pub(crate) fn instant(timestamp: Option<Timestamp>) -> Option<i64> {
    let timestamp = timestamp?;
    timestamp.seconds.checked_mul(NANOS_PER_SEC)?.checked_add(i64::from(timestamp.nanos))
}

pub(crate) fn duration(nanos: i64) -> Duration {
    let fraction = i32::try_from(nanos % NANOS_PER_SEC).unwrap_or(0);
    Duration { seconds: nanos / NANOS_PER_SEC, nanos: fraction }
}

pub(crate) fn span(duration: Option<Duration>) -> Option<i64> {
    let duration = duration?;
    duration.seconds.checked_mul(NANOS_PER_SEC)?.checked_add(i64::from(duration.nanos))
}
