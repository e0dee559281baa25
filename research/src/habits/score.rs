//! Scores: how far predictions are from the hidden states, and whether their confidence is right.
//!
//! Invariant: sums only, so that the scores of several seeds are the scores of all their days together.

use tidemap_model::HeldInterval;

use super::{LEVELS, baselines::BASELINES};
use crate::score::PROBABILITY_MIN;

/// The errors of predictions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors {
    predictions: u64,
    squares: f64,
    losses: f64,
}

impl Errors {
    pub(super) fn add(&mut self, p: f64, value: bool) {
        let error = p - f64::from(u8::from(value));
        self.predictions += 1;
        self.squares += error * error;
        let of_value = if value { p } else { 1.0 - p };
        self.losses -= of_value.clamp(PROBABILITY_MIN, 1.0 - PROBABILITY_MIN).ln();
    }

    fn join(&mut self, other: &Errors) {
        self.predictions += other.predictions;
        self.squares += other.squares;
        self.losses += other.losses;
    }

    /// The mean squared error.
    pub fn mse(&self) -> f64 {
        self.squares / self.predictions.max(1) as f64
    }

    /// The mean of -ln p of the hidden state, in nats, with p between 0.001 and 0.999.
    pub fn log_loss(&self) -> f64 {
        self.losses / self.predictions.max(1) as f64
    }
}

/// Intervals of a level: how many held, and the probabilities that they stated.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HourClaims {
    hours: u64,
    held: u64,
    claimed: f64,
}

impl HourClaims {
    /// `mean`: the mean of the state over the hour that the interval is about.
    pub(super) fn add(&mut self, held: &HeldInterval, mean: f64) {
        // The ends may be off by rounding.
        const ROUNDING: f64 = 1e-9;
        let interval = held.interval;
        self.hours += 1;
        self.held += u64::from(interval.lower - ROUNDING <= mean && mean <= interval.upper + ROUNDING);
        self.claimed += held.mass;
    }

    fn join(&mut self, other: &HourClaims) {
        self.hours += other.hours;
        self.held += other.held;
        self.claimed += other.claimed;
    }

    /// The share of hours of which the mean lay in the interval; none without hours.
    pub fn held(&self) -> Option<f64> {
        (self.hours > 0).then(|| self.held as f64 / self.hours as f64)
    }

    /// The mean of the probabilities that the intervals stated; none without hours.
    pub fn claimed(&self) -> Option<f64> {
        (self.hours > 0).then(|| self.claimed / self.hours as f64)
    }
}

/// Predictions close to 0 or 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sure {
    predictions: u64,
    sure: u64,
    wrong: u64,
}

impl Sure {
    /// `within`: a prediction nearer to 0 or 1 than this is sure.
    pub(super) fn add(&mut self, within: f64, p: f64, value: bool) {
        let is_sure = p < within || p > 1.0 - within;
        self.predictions += 1;
        self.sure += u64::from(is_sure);
        self.wrong += u64::from(is_sure && (p > 0.5) != value);
    }

    fn join(&mut self, other: &Sure) {
        self.predictions += other.predictions;
        self.sure += other.sure;
        self.wrong += other.wrong;
    }

    /// The share of all predictions that were sure.
    pub fn share(&self) -> f64 {
        self.sure as f64 / self.predictions.max(1) as f64
    }

    /// The share of sure predictions that were wrong; none without sure ones.
    pub fn wrong(&self) -> Option<f64> {
        (self.sure > 0).then(|| self.wrong as f64 / self.sure as f64)
    }
}

/// Predictions within these distances of 0 or 1 are sure.
pub const SURE_WITHIN: [f64; 2] = [0.01, 0.001];

/// The scores of a habit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scores {
    /// The errors of `auto`.
    pub auto: Errors,
    /// The errors of the probabilities by the habit, which no model knows.
    pub truth: Errors,
    /// The errors of the baselines.
    pub baselines: [Errors; BASELINES.len()],
    /// The intervals of uncertain hours, for each level.
    pub held: [HourClaims; LEVELS.len()],
    /// The sure predictions, by [`SURE_WITHIN`].
    pub sure: [Sure; SURE_WITHIN.len()],
}

impl Scores {
    /// Adds the scores of other days.
    pub(super) fn join(&mut self, other: &Scores) {
        self.auto.join(&other.auto);
        self.truth.join(&other.truth);
        self.baselines.iter_mut().zip(&other.baselines).for_each(|(own, other)| own.join(other));
        self.held.iter_mut().zip(&other.held).for_each(|(own, other)| own.join(other));
        self.sure.iter_mut().zip(&other.sure).for_each(|(own, other)| own.join(other));
    }

    /// The mean squared error of `auto` relative to the best baseline, as a share above it; negative if it is less.
    pub fn mse_of_best(&self) -> f64 {
        self.auto.mse() / self.best(Errors::mse) - 1.0
    }

    /// The log loss of `auto` relative to the best baseline, as a share above it.
    pub fn log_loss_of_best(&self) -> f64 {
        self.auto.log_loss() / self.best(Errors::log_loss) - 1.0
    }

    fn best(&self, loss: impl Fn(&Errors) -> f64) -> f64 {
        self.baselines.iter().map(loss).fold(f64::INFINITY, f64::min)
    }
}
