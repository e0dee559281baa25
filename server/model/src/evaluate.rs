//! The errors of a model's predictions of given observations, at each order.
//!
//! Invariant: evaluating changes nothing; every observation counts once.

use crate::{ORDER_MAX, Periodicities, PhasorTable, Sample, ScoreSums, SpectralModel, StateKind};

#[cfg(test)]
mod tests;

/// Observations that share one table of phasors; it stays in cache.
const CHUNK: usize = 1024;
/// The least predicted share that a label counts with: a single certain error must not decide.
const SHARE_MIN: f64 = 1e-6;

/// Errors of a model at predicting some observations.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Evaluation {
    /// Number of observations.
    pub observations: u64,
    /// Sum of squared differences of prediction and value.
    pub squared_error: f64,
    /// Observations whose value and prediction lie on different sides of 0.5 (T-RO eq. 15); 0.5 itself counts as 1. For
    /// labels: observations whose label is not the likeliest.
    pub wrong: u64,
    /// For labels: the sum of the surprise of each label, -log2 of its predicted share. The share counts as at least
    /// 1e-6.
    pub log_loss_bits: f64,
}

impl Evaluation {
    /// Counts one observation and its prediction. For values that are not probabilities only the squared error is
    /// meaningful.
    pub fn add(&mut self, predicted: f64, value: f64) {
        self.observations += 1;
        self.squared_error += (predicted - value) * (predicted - value);
        self.wrong += u64::from((predicted >= 0.5) != (value >= 0.5));
    }

    /// Counts one angle and its prediction, in radians. The error is 1 − cos of their difference: half the squared
    /// distance between the points on the unit circle. For small differences it is half the squared difference.
    pub fn add_angle(&mut self, predicted_rad: f64, angle_rad: f64) {
        self.observations += 1;
        self.squared_error += 1.0 - libm::cos(predicted_rad - angle_rad);
    }

    /// Counts one label, by its number, and the predicted shares of all labels, which sum to 1. The squared error is
    /// the sum over all shares (G. W. Brier, 1950), from 0 to 2.
    pub fn add_label(&mut self, shares: &[f64], label: usize) {
        self.observations += 1;
        let own = shares.get(label).copied().unwrap_or(0.0);
        let all: f64 = shares.iter().map(|share| share * share).sum();
        self.squared_error += all - 2.0 * own + 1.0;
        self.wrong += u64::from(shares.iter().enumerate().any(|(other, share)| other != label && *share >= own));
        self.log_loss_bits -= libm::log2(own.max(SHARE_MIN));
    }

    /// Mean surprise of a label, bits; 0 without observations.
    pub fn log_loss_bits(&self) -> f64 {
        self.log_loss_bits / self.observations.max(1) as f64
    }

    /// Mean squared error in the squared unit of the value (0 to 1 for probabilities); 0 without observations.
    pub fn mse(&self) -> f64 {
        self.squared_error / self.observations.max(1) as f64
    }

    /// Share of wrong predictions, 0 to 1; 0 without observations.
    pub fn error_rate(&self) -> f64 {
        self.wrong as f64 / self.observations.max(1) as f64
    }
}

/// The errors of a model of a probability on samples, one [`Evaluation`] per order 0..=`max_order`; orders above
/// [`ORDER_MAX`] are omitted.
pub fn evaluate(
    model: &SpectralModel,
    periodicities: &Periodicities,
    samples: &[Sample],
    max_order: usize,
) -> Vec<Evaluation> {
    let sums = score_samples(StateKind::Probability, model, periodicities, samples);
    let of_order = |order: usize| Evaluation {
        observations: samples.len() as u64,
        squared_error: sums.squared[order],
        wrong: sums.wrong[order] as u64,
        log_loss_bits: 0.0,
    };
    (0..=max_order.min(ORDER_MAX)).map(of_order).collect()
}

/// The errors of every order, summed over the samples. If the state is not a probability, no observation counts as
/// wrong.
pub(crate) fn score_samples(
    kind: StateKind,
    model: &SpectralModel,
    periodicities: &Periodicities,
    samples: &[Sample],
) -> ScoreSums {
    let chosen: Vec<u32> = model.components().iter().map(|component| component.periodicity).collect();
    let mut sums = ScoreSums::default();
    for chunk in samples.chunks(CHUNK) {
        let civil_nanos: Vec<i64> = chunk.iter().map(Sample::civil_nanos).collect();
        let values: Vec<f64> = chunk.iter().map(|sample| sample.value).collect();
        let phasors = PhasorTable::only(periodicities, &civil_nanos, &chosen);
        match kind {
            StateKind::Probability => model.score_run_values(&phasors, &values, &mut sums, true),
            _ => model.score_values(kind, &phasors, &values, &mut sums.squared),
        }
    }
    sums
}
