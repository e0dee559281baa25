//! The daemon's clocks. No other code reads the wall clock.
//!
//! Invariant: all other code gets the time from here, so that tests can set it.

use std::{fmt, time::SystemTime};

/// A clock that returns the time of day.
pub trait Clock: fmt::Debug + Send + Sync {
    /// Returns the nanoseconds since 1970-01-01T00:00:00Z.
    fn now_nanos(&self) -> i64;
}

/// The machine's clock.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock;

impl Clock for SystemClock {
    #[expect(clippy::disallowed_methods, reason = "the one reader of the wall clock")]
    fn now_nanos(&self) -> i64 {
        SystemTime::now()
            .duration_since(SystemTime::UNIX_EPOCH)
            .map_or(0, |elapsed| i64::try_from(elapsed.as_nanos()).unwrap_or(i64::MAX))
    }
}
