//! The errors of all histograms on a day, in one pass.
//!
//! Invariant: the squared errors are those of the histograms that [`Alternatives::histogram`] builds, but no histogram
//! is built: an hour costs one prediction of each, whatever the number of readings.

use super::{Alternatives, DayError, HISTOGRAMS, by_criterion, squared};
use crate::{Sample, models::hour_runs, order::OrderCriterion};

#[cfg(test)]
mod tests;

impl Alternatives {
    /// The error of each of [`HISTOGRAMS`] on a day's samples; `None` where there are no earlier readings.
    /// `spectral_of` predicts in hours for which neither a histogram nor a coarser one has readings.
    ///
    /// For an hour without readings of the histogram itself, the errors by which models are compared use the mean of
    /// all readings: a histogram must not win by the values of a coarser one. Otherwise, after the first week, the
    /// weekly histogram would have the errors of the histogram of weekday and weekend.
    pub(super) fn score_histograms(
        &self,
        criterion: OrderCriterion,
        samples: &[Sample],
        spectral_of: &dyn Fn(&Sample) -> f64,
    ) -> Option<[DayError; HISTOGRAMS.len()]> {
        let mean = self.hours.mean()?;
        let mut errors = [DayError::default(); HISTOGRAMS.len()];
        for run in hour_runs(samples) {
            let hour_of_week = run.hour_of_week();
            let predicted = HISTOGRAMS.map(|kind| match kind.histogram() {
                Some(histogram) => self.hours.answer(histogram, hour_of_week, mean),
                None => (None, false),
            });
            for sample in run.samples {
                for (error, (predicted, has_own)) in errors.iter_mut().zip(predicted) {
                    let predicted = predicted.unwrap_or_else(|| spectral_of(sample));
                    let compared = if has_own { predicted } else { mean };
                    error.squared += squared(predicted, sample.value);
                    error.by_criterion += by_criterion(criterion, compared, sample.value);
                }
            }
        }
        Some(errors)
    }
}
