//! The wall clock. Invariant: only this file reads it; durations are measured with `std::time::Instant`, which cannot
//! be set.

use std::time::{SystemTime, UNIX_EPOCH};

/// The current time, in nanoseconds since 1970-01-01T00:00:00Z; 0 if the clock is set before that.
#[must_use]
#[expect(clippy::disallowed_methods, reason = "the one reader of the wall clock")]
pub fn now_nanos() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
}
