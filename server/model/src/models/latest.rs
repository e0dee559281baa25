//! The latest value: predicts the value of the newest reading.
//!
//! Robots have this map by default: it remembers one reading. Invariant: the prediction is a reading.

use super::mean::check_values;
use super::{CannotTrain, Moment, Readings, TemporalModel};
use crate::InvalidParts;

#[cfg(test)]
mod tests;

/// The newest reading's value from the first reading on, and the first reading's value before it.
///
/// The model keeps two readings only: between them it also predicts the newest (RAS 2017, section 4.3: maps that
/// "reflect the latest state measurements").
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latest {
    parts: LatestParts,
}

/// The parts of a [`Latest`], for storage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LatestParts {
    /// Time of the first reading: UTC, nanoseconds since 1970.
    pub first_nanos: i64,
    /// Value of the first reading, finite.
    pub first_value: f64,
    /// Time of the newest reading: UTC, nanoseconds since 1970.
    pub last_nanos: i64,
    /// Value of the newest reading, finite.
    pub last_value: f64,
}

impl Latest {
    /// Keeps the first and the newest reading; of several at the newest time, the last.
    ///
    /// # Errors
    /// [`CannotTrain`] where there are no readings or a value is not finite.
    pub fn train(readings: Readings<'_>) -> Result<Latest, CannotTrain> {
        check_values(readings, f64::MIN..=f64::MAX, "a finite number")?;
        let (Some(first), Some(last)) = (readings.samples.first(), readings.samples.last()) else {
            return Err(CannotTrain::NoReadings);
        };
        Ok(Latest {
            parts: LatestParts {
                first_nanos: first.utc_nanos,
                first_value: first.value,
                last_nanos: last.utc_nanos,
                last_value: last.value,
            },
        })
    }

    /// Replaces the newest reading; a reading that is older than the newest, or not finite, changes nothing.
    pub fn observe(&mut self, utc_nanos: i64, value: f64) {
        if utc_nanos >= self.parts.last_nanos && value.is_finite() {
            (self.parts.last_nanos, self.parts.last_value) = (utc_nanos, value);
        }
    }

    /// The parts to store.
    pub fn to_parts(&self) -> LatestParts {
        self.parts
    }

    /// A model from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a value is not finite or the first reading is later than the newest.
    pub fn from_parts(parts: LatestParts) -> Result<Latest, InvalidParts> {
        InvalidParts::check("first value", parts.first_value, f64::MIN..=f64::MAX)?;
        InvalidParts::check("last value", parts.last_value, f64::MIN..=f64::MAX)?;
        let (first_nanos, last_nanos) = (parts.first_nanos, parts.last_nanos);
        if first_nanos > last_nanos {
            return Err(InvalidParts::TimesReversed { first_nanos, last_nanos });
        }
        Ok(Latest { parts })
    }
}

impl TemporalModel for Latest {
    fn predict(&self, at: Moment) -> f64 {
        if at.utc_nanos < self.parts.first_nanos { self.parts.first_value } else { self.parts.last_value }
    }
}
