//! The expected gain of an update: the excess of a model's error on new readings over its usual error.
//!
//! T-RO 2017, section IV.A, lets the prediction error since the last update decide whether an update is needed:
//!
//! > ε_p = ε(τ', τ) = 1 / (τ − τ') ∫ |s'(t) − s(t)| dt over what was observed after the last update τ'.
//!
//! Here it is the mean squared error (p − v)² over the pending readings v, by the model that predicts the state. It is
//! compared with the usual error: the mean squared error of days of that kind, weekdays or weekend, before they were
//! learned, from the change alarm. The difference is the gain, if it is above 0: a state that is as uncertain as before
//! has no gain. Errors of a state that is not a probability are divided by the variance of its values, so that the
//! errors of all states may be added. A state that no update has predicted yet has no usual error, so all of its error
//! counts as gain. Limit: the gain is 0 for a state whose readings have become easier to predict.
//!
//! Invariant: all sums are finite and not negative. A judgement changes nothing.

use crate::special::square;
use crate::{Periodicities, Sample, StateKind, StateModel, models::TemporalModel as _};

#[cfg(test)]
mod tests;

/// The expected gain from learning the pending readings of one or more states.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct UpdateWorth {
    /// Number of pending readings that were judged.
    pub readings: u64,
    /// Sum of the squared errors of the readings: 0 to 1 each for probabilities; for other kinds in variances of the
    /// state.
    pub squared_error: f64,
    /// Sum of the squared errors that are usual for their state and kind of day, in the same unit.
    pub usual_squared_error: f64,
    /// Sum over the states of the error above the usual error, in the same unit.
    pub squared_error_above_usual: f64,
}

impl UpdateWorth {
    /// Judges pending readings of a state. `None` if errors have no unit: the state is not a probability, and it has no
    /// learned data or all its values were equal. `periodicities` are those of its map.
    #[must_use]
    pub fn of_state(model: &StateModel, periodicities: &Periodicities, pending: &[Sample]) -> Option<UpdateWorth> {
        let kind = model.kind();
        let unit = if kind == StateKind::Probability { 1.0 } else { model.accumulator().variance() };
        if !(unit > 0.0 && unit.is_finite()) {
            return None;
        }
        let answers = model.chosen_member(periodicities);
        let error = |sample: &Sample| square(answers.predict(sample.moment()) - sample.value);
        let squared_error = (pending.iter().map(error).sum::<f64>() / unit).min(f64::MAX);
        let alarm = model.alternatives().map(|known| known.alarm());
        let usual = |sample: &Sample| alarm.and_then(|alarm| alarm.usual_mse(sample.local_day())).unwrap_or(0.0);
        let usual_squared_error = pending.iter().map(usual).sum::<f64>().min(f64::MAX);
        Some(UpdateWorth {
            readings: pending.len() as u64,
            squared_error,
            usual_squared_error,
            squared_error_above_usual: (squared_error - usual_squared_error).max(0.0),
        })
    }

    /// Adds the expected gain of another state.
    pub fn add(&mut self, other: &UpdateWorth) {
        let add = |sum: &mut f64, more: f64| *sum = (*sum + more).min(f64::MAX);
        self.readings += other.readings;
        add(&mut self.squared_error, other.squared_error);
        add(&mut self.usual_squared_error, other.usual_squared_error);
        add(&mut self.squared_error_above_usual, other.squared_error_above_usual);
    }

    /// Mean squared error of a pending reading; 0 without readings.
    #[must_use]
    pub fn pending_error(&self) -> f64 {
        self.mean(self.squared_error)
    }

    /// Mean squared error that is usual for the readings; 0 without readings.
    #[must_use]
    pub fn usual_error(&self) -> f64 {
        self.mean(self.usual_squared_error)
    }

    /// The mean squared error by which learning is expected to improve predictions such as these; 0 without readings.
    #[must_use]
    pub fn gain(&self) -> f64 {
        self.mean(self.squared_error_above_usual)
    }

    fn mean(&self, sum: f64) -> f64 {
        sum / self.readings.max(1) as f64
    }
}
