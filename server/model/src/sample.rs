//! One observation of one state, the input of the models.
//!
//! Invariant: the caller guarantees a value that the state's kind allows; nothing here checks it again.

use crate::LocalDay;
use crate::Row;
use crate::civil::NANOS_PER_SEC;

/// One observation of a state's value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time of the observation: UTC, nanoseconds since 1970.
    pub utc_nanos: i64,
    /// The UTC offset of the map's zone that was used when it was logged, in seconds, east positive.
    pub offset_secs: i32,
    /// The observed value, which the state's [`crate::StateKind`] allows; guaranteed by the caller.
    pub value: f64,
}

impl Sample {
    /// Local civil time, nanoseconds since 1970-01-01T00:00 local; saturates at the ends of `i64`.
    pub fn civil_nanos(&self) -> i64 {
        self.utc_nanos.saturating_add(i64::from(self.offset_secs) * NANOS_PER_SEC)
    }

    /// The observation as a row of a state that reports changes or events; NaN means that there is no value.
    pub fn row(&self) -> Row {
        (self.utc_nanos, (!self.value.is_nan()).then_some(self.value))
    }

    /// The local date of the observation.
    pub fn local_day(&self) -> LocalDay {
        LocalDay::of_civil_nanos(self.civil_nanos())
    }
}
