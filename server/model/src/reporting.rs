//! How a state is reported, and which readings its rows represent.
//!
//! A robot that observes a door reports **samples**: each row is a reading. A door contact reports **changes**: a row
//! contains the value that the door has from then on, and no row means that nothing changed. A button or a light
//! barrier reports **events**: a row is one event, and no row means that there was none. If changes were learned as
//! samples, a door that is open from nine to five would count as open half of the time.
//!
//! Rows are stored as they come. The models learn the readings that the rows represent, at instants that are a step
//! apart: for changes the value that holds at the instant, for events their number in each step, at its beginning. So
//! the cost of storage follows change, and models need not know how a state is reported.
//!
//! Invariant: readings depend on the rows, their times and the horizon alone. Rows in order of time give the same
//! readings, however they are divided over updates. No reading is later than the horizon.

use crate::time::NANOS_PER_SEC;

mod learned;
mod readings;
mod stated;
#[cfg(test)]
mod tests;

pub use learned::LearnedRows;
pub use readings::RowReadings;
pub use stated::{InvalidReporting, RowKind, StatedReporting};

/// The longest and the shortest step, in seconds.
const STEP_SECS: std::ops::RangeInclusive<u32> = 1..=86_400;
/// The longest time for which a value may hold without a row: a year and a day.
const HOLD_MAX_SECS: u32 = 366 * 86_400;
/// The greatest number of readings that one row represents: 11 days at a step of a second, 366 days at one of 32 s.
const READINGS_PER_ROW: u32 = 1_000_000;

/// A row: nanoseconds UTC, and the value from then on or the number of events; `None`: the sensor knows no value from
/// then on.
pub type Row = (i64, Option<f64>);

/// The origin of the rows of a state. It is fixed when the state is created.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Reporting {
    /// Each row is a reading of the state at that time.
    #[default]
    Samples,
    /// Each row is a change: its value holds until the next row.
    Changes(Hold),
    /// Each row is a number of events, usually one, of a state that counts them.
    Events(Hold),
}

/// For how long rows hold, and at which instants they are learned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Hold {
    max_secs: u32,
    step_secs: u32,
}

/// The reason why durations are invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InvalidHold {
    /// The step is too short or too long.
    #[error("a step of {0} s: it must be 1 s to 1d")]
    Step(u32),
    /// Values would hold for less than a step, or for too long.
    #[error("values hold for {max_secs} s at most: it must be one step ({step_secs} s) to 366d")]
    Max {
        /// The longest time for which a value holds, in seconds.
        max_secs: u32,
        /// The step, in seconds.
        step_secs: u32,
    },
    /// One row would represent too many readings.
    #[error(
        "values that hold for {max_secs} s at most and are learned every {step_secs} s: one row would mean {} \
         readings, the maximum is {READINGS_PER_ROW}; choose a longer step or a shorter hold",
        max_secs / step_secs
    )]
    Readings {
        /// The longest time for which a value holds, in seconds.
        max_secs: u32,
        /// The step, in seconds.
        step_secs: u32,
    },
}

impl Hold {
    /// The default of changes: values hold for a week, and are learned every five minutes.
    pub const OF_CHANGES: Hold = Hold { max_secs: 7 * 86_400, step_secs: 300 };
    /// The default of events: they are counted by the hour, and a week without one is no evidence.
    pub const OF_EVENTS: Hold = Hold { max_secs: 7 * 86_400, step_secs: 3_600 };

    /// Makes rows hold for `max_secs` seconds at most, with a reading every `step_secs` seconds.
    ///
    /// # Errors
    /// [`InvalidHold`] where a duration is outside its range.
    pub fn new(max_secs: u32, step_secs: u32) -> Result<Hold, InvalidHold> {
        if !STEP_SECS.contains(&step_secs) {
            return Err(InvalidHold::Step(step_secs));
        }
        if !(step_secs..=HOLD_MAX_SECS).contains(&max_secs) {
            return Err(InvalidHold::Max { max_secs, step_secs });
        }
        if max_secs / step_secs > READINGS_PER_ROW {
            return Err(InvalidHold::Readings { max_secs, step_secs });
        }
        Ok(Hold { max_secs, step_secs })
    }

    /// The longest time for which a row holds, in seconds.
    pub fn max_secs(self) -> u32 {
        self.max_secs
    }

    /// The time from one reading to the next, in seconds.
    pub fn step_secs(self) -> u32 {
        self.step_secs
    }

    /// The longest time for which a row holds, in nanoseconds.
    pub fn max_nanos(self) -> i64 {
        i64::from(self.max_secs) * NANOS_PER_SEC
    }

    /// The time from one reading to the next, in nanoseconds.
    pub fn step_nanos(self) -> i64 {
        i64::from(self.step_secs) * NANOS_PER_SEC
    }

    /// The last multiple of the step at or before a time.
    fn floor(self, nanos: i64) -> i64 {
        nanos - nanos.rem_euclid(self.step_nanos())
    }

    /// The first multiple of the step at or after a time; saturates.
    fn ceil(self, nanos: i64) -> i64 {
        let floor = self.floor(nanos);
        if floor == nanos { floor } else { floor.saturating_add(self.step_nanos()) }
    }

    /// Whether a row still holds at a time.
    fn reaches(self, row_nanos: i64, nanos: i64) -> bool {
        nanos.saturating_sub(row_nanos) <= self.max_nanos()
    }
}

impl Reporting {
    /// The meaning of the rows.
    pub fn kind(self) -> RowKind {
        match self {
            Reporting::Samples => RowKind::Samples,
            Reporting::Changes(_) => RowKind::Changes,
            Reporting::Events(_) => RowKind::Events,
        }
    }

    /// The time for which rows hold; `None` for samples, which do not hold.
    pub fn hold(self) -> Option<Hold> {
        match self {
            Reporting::Samples => None,
            Reporting::Changes(hold) | Reporting::Events(hold) => Some(hold),
        }
    }

    /// The greatest number of readings that the rows of a day represent; 0 for samples.
    pub fn readings_a_day(self) -> u64 {
        self.hold().map_or(0, |hold| u64::from(86_400_u32.div_ceil(hold.step_secs)))
    }

    /// Whether rows are changes of the value.
    pub fn is_changes(self) -> bool {
        matches!(self, Reporting::Changes(_))
    }

    /// Whether a row may state that no value is known from then on.
    pub fn may_end(self) -> bool {
        self != Reporting::Samples
    }

    /// The readings that all rows of a state represent, in order of time. The rows ascend by time; the last of equal
    /// times counts. `horizon_nanos`: no reading is at or after it. Samples are readings themselves.
    pub fn readings(self, rows: Vec<Row>, horizon_nanos: i64) -> RowReadings {
        LearnedRows::default().learn(self, rows, horizon_nanos).0
    }
}

impl std::fmt::Display for Reporting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.hold() {
            None => f.write_str(self.kind().name()),
            Some(Hold { max_secs, step_secs }) => {
                write!(f, "{} that hold for {max_secs} s at most, every {step_secs} s", self.kind().name())
            }
        }
    }
}
