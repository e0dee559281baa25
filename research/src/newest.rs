//! Predictions of readings from the newest reading that was known some time before them.
//!
//! The models are the trained ones; only the newest reading moves. It is a reading of any file of the protocol: a robot
//! remembers its readings of the test set before. Invariant: a prediction of a reading uses no reading that is nearer
//! to it than the lead time, and with [`Ahead::Next`] none at its own time.

use tidemap_model::{MemoryBasis, Persistence, Sample, StateKind, models::TemporalModel as _};

use super::{
    compared::{ComparedModel, ComparedSettings},
    protocol::Ahead,
};

#[cfg(test)]
mod tests;

/// The readings of one state from which the newest is taken, and the parameters that the blends need.
pub(crate) struct KnownReadings {
    /// The readings of all files, ascending by time.
    samples: Vec<Sample>,
    basis: MemoryBasis,
}

impl KnownReadings {
    /// `train` are the training readings, ascending by time; `tests` the readings of each test set that was not
    /// learned.
    pub(crate) fn new<'a>(train: &[Sample], tests: impl Iterator<Item = &'a [Sample]>, kind: StateKind) -> Self {
        let count = train.len().max(1) as f64;
        let mean = train.iter().map(|sample| sample.value).sum::<f64>() / count;
        let variance = train.iter().map(|sample| (sample.value - mean).powi(2)).sum::<f64>() / count;
        let is_probability = kind == StateKind::Probability;
        // The unit is the one in which a map measures changes: for other kinds than probabilities two standard
        // deviations.
        let width = 2.0 * variance.sqrt();
        let basis = MemoryBasis {
            usual_change: if !is_probability && width > 0.0 { width } else { 1.0 },
            mean: if is_probability { mean } else { 0.5 },
            first_nanos: train.first().map(|sample| sample.utc_nanos),
            most_likely_secs: None,
        };
        let mut samples = train.to_vec();
        tests.for_each(|test| samples.extend_from_slice(test));
        samples.sort_by_key(|sample| sample.utc_nanos);
        Self { samples, basis }
    }

    /// Predictions of readings, ascending by time, at a lead time; `plain` are the predictions of the model without a
    /// newest reading.
    pub(crate) fn predict(
        &self,
        (set, model): (&ComparedSettings, &ComparedModel),
        readings: &[Sample],
        plain: &[f64],
        ahead: Ahead,
    ) -> Vec<f64> {
        let mut known = Persistence::default();
        let mut next = 0;
        let mut predictions = Vec::with_capacity(readings.len());
        for (reading, &plain) in readings.iter().zip(plain) {
            let is_known = |sample: &Sample| match ahead {
                Ahead::Next => sample.utc_nanos < reading.utc_nanos,
                Ahead::Nanos(nanos) => sample.utc_nanos <= reading.utc_nanos.saturating_sub(nanos),
            };
            while let Some(sample) = self.samples.get(next).filter(|sample| is_known(sample)) {
                known.observe(sample.utc_nanos, sample.value);
                next += 1;
            }
            let own = known.last().and_then(|newest| model.with_newest(newest));
            let own = own.map_or(plain, |model| model.predict(reading.moment()));
            predictions.push(set.blend().blend.draw(&known, self.basis, own, reading.utc_nanos));
        }
        predictions
    }
}
