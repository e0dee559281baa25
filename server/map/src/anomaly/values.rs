//! Anomalous values of continuous and count states.
//!
//! A value is an anomaly if it lies outside the two-sided interval, at the given confidence, of single values about the
//! prediction ([`value_tail`]): normal, or negative binomial with variance φ·λ. The variance is the variance of the
//! values, times the ratio of the model's error to the error of the mean; both are errors of predictions of days before
//! they were learned. It is never below the variance between days of the hour.
//!
//! Invariant: a state with few learned observations has no anomalies.

use tidemap_model::{
    StateKind, StateModel,
    models::{Moment, value_tail},
    selector::{ModelKind, ModelSelector},
};

use super::{Anomaly, Confidence};
use crate::{history::Reading, ids::StateId, interval::Spreads, view::MapView};

#[cfg(test)]
mod tests;

/// With fewer observations than this, the variance of single values is too uncertain.
const OBSERVATIONS_MIN: u64 = 30;

/// The distribution of single values of a state about the model's prediction.
#[derive(Clone, Debug)]
pub struct ValueJudge {
    kind: StateKind,
    spreads: Spreads,
    /// The variance of single values about the prediction; for counts, at the usual rate.
    variance: f64,
    /// The ratio of variance to rate for counts, at least 1.
    dispersion: f64,
    /// The lowest rate for counts: one event in all observations.
    least_rate: f64,
}

impl ValueJudge {
    /// The judge for a model; `None` for probabilities, and with fewer than 30 learned observations.
    ///
    /// The variance is that of the values, times the ratio of the model's error to the error of the mean at predicting
    /// days that they had not learned. The errors are the sums, fading by 7 % a day, by which updates choose orders and
    /// models. For a model that updates do not score, the error of the model in force is used; before the first scored
    /// day the ratio is 1.
    #[must_use]
    pub fn new(model: &StateModel, selector: ModelSelector) -> Option<Self> {
        let (kind, folded) = (model.kind(), model.accumulator());
        if kind == StateKind::Probability || folded.observations() < OBSERVATIONS_MIN {
            return None;
        }
        let spreads = Spreads::of(model.alternatives()?.hours());
        let variance = folded.variance() * share_of_mean(model, selector);
        let rate = folded.mean().max(0.0);
        let dispersion = if rate > 0.0 { (variance / rate).max(1.0) } else { 1.0 };
        let least_rate = 1.0 / folded.observations() as f64;
        Some(Self { kind, spreads, variance, dispersion, least_rate })
    }

    /// The p-value of a value at a moment: the probability of a value at least as far from the prediction, to either
    /// side.
    ///
    /// The variance is at least the variance between days at that hour, as for prediction intervals, because some
    /// states vary more at some hours. The variance of counts is proportional to their rate.
    #[must_use]
    pub fn tail(&self, value: f64, expected: f64, at: Moment) -> f64 {
        let between_days = self.spreads.variance_between_days(at);
        if self.kind == StateKind::Count {
            let rate = expected.max(self.least_rate);
            return value_tail(self.kind, rate, (self.dispersion * rate).max(between_days), value);
        }
        value_tail(self.kind, expected, self.variance.max(between_days), value)
    }
}

/// The ratio of the error of a model to the error of the mean, at predicting days before they were learned. For a model
/// that updates do not score it is the ratio of the model in force; 1 before the first scored day.
fn share_of_mean(model: &StateModel, selector: ModelSelector) -> f64 {
    let Some(known) = model.alternatives() else { return 1.0 };
    let scored = |wanted| known.error_sums().find(|(choice, _)| *choice == wanted).map(|(_, sum)| sum);
    let order = |order: usize| model.errors().sums().get(order).copied();
    let own = match selector.kind {
        ModelKind::Mean => order(0),
        ModelKind::Spectral => order(selector.order_for(model)),
        ModelKind::Auto => selector.order.and_then(order),
        kind => scored(kind),
    };
    match (own.or_else(|| scored(model.choice())), order(0)) {
        (Some(own), Some(of_mean)) if of_mean > 0.0 => own / of_mean,
        _ => 1.0,
    }
}

impl MapView {
    /// Whether each reading of a state is anomalous, given the model's predictions; in the order of the readings.
    /// Probabilities are judged by [`super::is_anomalous`], other kinds by [`ValueJudge`].
    #[must_use]
    pub fn judged(
        &self,
        id: StateId,
        selector: ModelSelector,
        readings: &[Reading],
        expected: &[f64],
        confidence: Confidence,
    ) -> Vec<Option<Anomaly>> {
        let pairs = readings.iter().zip(expected);
        if self.kind(id) == StateKind::Probability {
            let judged = pairs.map(|(reading, expected)| {
                super::anomalies(std::slice::from_ref(reading), std::slice::from_ref(expected), confidence).next()
            });
            return judged.collect();
        }
        let Some(judge) = ValueJudge::new(self.model(id), selector) else { return vec![None; readings.len()] };
        let times: Vec<i64> = readings.iter().map(|(nanos, _)| *nanos).collect();
        let judged = pairs.zip(self.moments(&times)).map(|((&(utc_nanos, value), &expected), at)| {
            let probability = judge.tail(value, expected, at);
            (probability <= 1.0 - confidence.get()).then_some(Anomaly { utc_nanos, value, probability })
        });
        judged.collect()
    }
}
