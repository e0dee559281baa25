//! The mean of all readings: the "long-term memory" of RAS 2017 section 4.3.1, and the baseline of every other model.
//!
//! Invariant: the prediction is the same at all times and lies between the lowest and the highest reading.

use super::{CannotTrain, Moment, Readings, TemporalModel};
use crate::InvalidParts;

#[cfg(test)]
mod tests;

/// The weighted mean of the readings, at any moment (RAS 2017, section 4.3.1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    parts: MeanParts,
}

/// The parts of a [`Mean`], for storage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanParts {
    /// The mean value, finite.
    pub mean: f64,
}

impl Mean {
    /// Trains the mean of the readings with the weights of [`Readings::weights`].
    ///
    /// # Errors
    /// [`CannotTrain`] where there are no readings or a value is not finite.
    pub fn train(readings: Readings<'_>) -> Result<Mean, CannotTrain> {
        check_values(readings, f64::MIN..=f64::MAX, "a finite number")?;
        let mut running = RunningMean::default();
        for (sample, weight) in readings.samples.iter().zip(readings.weights()) {
            running.add(sample.value, weight);
        }
        Ok(Mean { parts: MeanParts { mean: running.mean } })
    }

    /// The mean value.
    pub fn mean(&self) -> f64 {
        self.parts.mean
    }

    /// The parts to store.
    pub fn to_parts(&self) -> MeanParts {
        self.parts
    }

    /// A model from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where the mean is not finite.
    pub fn from_parts(parts: MeanParts) -> Result<Mean, InvalidParts> {
        InvalidParts::check("mean", parts.mean, f64::MIN..=f64::MAX)?;
        Ok(Mean { parts })
    }
}

impl TemporalModel for Mean {
    fn predict(&self, _at: Moment) -> f64 {
        self.parts.mean
    }
}

/// A weighted mean that does not overflow for finite values.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RunningMean {
    pub(super) mean: f64,
    pub(super) weight: f64,
    lowest: f64,
    highest: f64,
}

impl RunningMean {
    /// Counts a finite value with a weight above 0.
    pub(super) fn add(&mut self, value: f64, weight: f64) {
        if self.weight <= 0.0 {
            *self = RunningMean { mean: value, weight, lowest: value, highest: value };
            return;
        }
        (self.lowest, self.highest) = (self.lowest.min(value), self.highest.max(value));
        self.weight += weight;
        let share = weight / self.weight;
        // A difference of huge values would overflow. Rounding must not move the mean outside the range of the
        // readings.
        self.mean = (self.mean * (1.0 - share) + value * share).clamp(self.lowest, self.highest);
    }
}

/// `Ok` where there are readings and every value lies in `range`.
pub(super) fn check_values(
    readings: Readings<'_>,
    range: std::ops::RangeInclusive<f64>,
    expected: &'static str,
) -> Result<(), CannotTrain> {
    if readings.samples.is_empty() {
        return Err(CannotTrain::NoReadings);
    }
    match readings.samples.iter().find(|sample| !range.contains(&sample.value)) {
        Some(sample) => Err(CannotTrain::Parameter { parameter: "a reading's value", found: sample.value, expected }),
        None => Ok(()),
    }
}
