//! Anomalies: observations that a model did not expect (T-RO 2017, section V; for continuous and count states see
//! `values.rs`).
//!
//! Updates keep the observations that were unusual before they were learned (`learned.rs`). All other past observations
//! are judged by the model of one view. A watched observation is judged by the models in force when the watch processes
//! it, even if the observation itself must wait to be learned. Models that predict from the newest value judge nothing,
//! because the newest value at the time of an old observation was different. A scan is logged as changed bits of tiles,
//! so a watch follows the bits of its cells ([`tidemap_grid::follower`]).
//!
//! Invariant: only this module decides what an anomaly is. A probability of one half is never sure enough, so an
//! untrained state has no anomalies.

use tidemap_grid::view::GridView;
use tidemap_model::selector::{Blend, ModelKind, ModelSelector};

use crate::{history::Reading, view::MapView};

/// The probability from which a model counts as sure, so that an observation of the contrary is an anomaly: above 0.5,
/// at most 1.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Confidence(f64);

/// Why a confidence is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{0} is not a confidence: it must be above 0.5 and at most 1, for example 0.99")]
pub struct InvalidConfidence(pub f64);

impl Confidence {
    /// 0.99, with which the paper finds the visitor at midnight (T-RO 2017, figure 4).
    pub(crate) const DEFAULT: Self = Self(0.99);

    /// Checks a confidence.
    ///
    /// # Errors
    /// [`InvalidConfidence`] if it is not above 0.5 and at most 1, or NaN.
    pub fn new(confidence: f64) -> Result<Self, InvalidConfidence> {
        if confidence > 0.5 && confidence <= 1.0 { Ok(Self(confidence)) } else { Err(InvalidConfidence(confidence)) }
    }

    /// The confidence as a number.
    pub fn get(self) -> f64 {
        self.0
    }
}

impl Default for Confidence {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Whether an observed value, in [0, 1], contradicts a model with confidence c that predicts `probability` for the
/// value 1: the value is below 0.5 where p ≥ c, or not below 0.5 where p ≤ 1 − c.
///
/// T-RO 2017, section V: a measurement is anomalous where it is less than s'(t, c) or greater than s'(t, 1 − c), with
/// s'(t, c) = p(t) ≥ c (eq. 9). Both sides include the threshold here, so that they are alike and that a model which is
/// certain can be contradicted at confidence 1. A value between 0 and 1 counts as the nearer of the two.
pub(crate) fn is_anomalous(value: f64, probability: f64, confidence: Confidence) -> bool {
    if value < 0.5 { probability >= confidence.0 } else { probability <= 1.0 - confidence.0 }
}

/// An observation that the model did not expect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anomaly {
    /// The time, nanoseconds UTC.
    pub utc_nanos: i64,
    /// The observed value, in the bounds of the state's kind.
    pub value: f64,
    /// For probability states, the model's probability of the value 1. For other kinds the p-value: the probability of
    /// a value at least as far from the prediction, to either side. In [0, 1].
    pub probability: f64,
}

/// The anomalous readings, in their order, given the model's probability of 1 for each reading.
pub fn anomalies<'a>(
    readings: &'a [Reading],
    probabilities: &'a [f64],
    confidence: Confidence,
) -> impl Iterator<Item = Anomaly> + 'a {
    let judged = readings.iter().zip(probabilities);
    let judged = judged.map(|(&(utc_nanos, value), &probability)| Anomaly { utc_nanos, value, probability });
    judged.filter(move |judged| is_anomalous(judged.value, judged.probability, confidence))
}

/// Why a model cannot judge observations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CannotJudge {
    /// The model predicts from the newest value, which is not the value before the observation.
    #[error("{0} predicts from the newest value, not from the one before an observation: use a model such as auto")]
    Newest(ModelKind),
    /// The newest value is blended in.
    #[error("{name} blends in the newest value, not the one before an observation: leave it out", name = .0.name())]
    Blended(Blend),
    /// The model is trained on request, and observations do not wait for that.
    #[error("{0} must be trained, and a watch does not wait for that: use auto, mean or spectral")]
    NeedsTraining(ModelKind),
}

/// Whether a model can judge past observations.
///
/// # Errors
/// [`CannotJudge`], with the model to use instead.
pub fn can_judge(model: ModelSelector) -> Result<(), CannotJudge> {
    match model.kind {
        kind if kind.takes_newest() => Err(CannotJudge::Newest(model.kind)),
        _ if model.is_blended() => Err(CannotJudge::Blended(model.blend)),
        _ => Ok(()),
    }
}

/// Whether a model can judge observations as they arrive: every view has such a model ready.
///
/// # Errors
/// [`CannotJudge`], with the model to use instead.
pub fn can_watch(model: ModelSelector) -> Result<(), CannotJudge> {
    can_judge(model)?;
    if model.kind.needs_readings() { Err(CannotJudge::NeedsTraining(model.kind)) } else { Ok(()) }
}

impl MapView {
    /// The view without last values: enough to judge observations. It holds little more than the models of its
    /// generation.
    pub fn models_only(&self) -> MapView {
        MapView { live: Vec::new(), grid: self.grid.as_ref().map(GridView::models_only), ..self.clone() }
    }
}

mod cells;
pub(crate) mod learned;
mod values;

pub use learned::{MAP_RUNS_MAX, StateSurprise, SurpriseQuestion};
pub use values::ValueJudge;

#[cfg(test)]
mod tests;
