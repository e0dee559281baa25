//! One trained model of any kind, of a named state or a cell.
//!
//! Invariant: a prediction is within the bounds of the state's kind. All models have the same prediction for an
//! untrained state.

use tidemap_map::{event::StateKind, spec::MapSpec, view::MapView};
use tidemap_model::{
    Sample, StopSignal, TrainedModel,
    catalogue::QueryInputs,
    models::{CannotTrain, Moment, Readings, TemporalModel},
    selector::{ModelKind, ModelSelector},
};

use crate::StateOrCell;

/// A model that was trained on the readings of a state.
#[derive(Clone, Debug)]
pub enum CachedModel {
    /// There are no readings: the prediction of an untrained state.
    Unlearned,
    /// The model; a model with orders was trained at the highest order, and predicts for all lower ones.
    Trained(TrainedModel),
}

impl CachedModel {
    /// Trains a model on the readings of a state, ascending by time, whose values are of a kind. Models that need no
    /// readings ([`ModelKind::needs_readings`]) return [`CachedModel::Unlearned`].
    ///
    /// # Errors
    /// [`CannotTrain`] if a parameter is out of range, the model does not support the readings, or the training
    /// received the signal to stop.
    pub fn train(
        kind: ModelKind,
        state_kind: StateKind,
        samples: &[Sample],
        spec: &MapSpec,
        stop: StopSignal<'_>,
    ) -> Result<Self, CannotTrain> {
        if samples.is_empty() || !kind.needs_readings() {
            return Ok(Self::Unlearned);
        }
        let half_life_secs = spec.half_life_nanos.map(|nanos| nanos as f64 / 1e9);
        let readings = Readings { samples, half_life_secs, stop };
        kind.train(readings, state_kind, &spec.periodicities).map(Self::Trained)
    }

    /// Probability that the state is 1, or the forecast, at each of the moments, written to `out`, which has their
    /// length. A model that stores its outliers predicts 0 or 1 there, as observed.
    pub fn predict_into(
        &self,
        view: &MapView,
        target: &StateOrCell,
        moments: &[Moment],
        selector: ModelSelector,
        out: &mut [f64],
    ) {
        self.answer(view, target, moments, selector, true, out);
    }

    /// Does the same as [`CachedModel::predict_into`], but without stored outliers, to judge observations.
    pub fn expect_into(
        &self,
        view: &MapView,
        target: &StateOrCell,
        moments: &[Moment],
        selector: ModelSelector,
        out: &mut [f64],
    ) {
        self.answer(view, target, moments, selector, false, out);
    }

    fn answer(
        &self,
        view: &MapView,
        target: &StateOrCell,
        moments: &[Moment],
        selector: ModelSelector,
        with_outliers: bool,
        out: &mut [f64],
    ) {
        let model: &dyn TemporalModel = match self {
            Self::Unlearned => &Constant(target.mean(view)),
            Self::Trained(model) => {
                // The newest value changes as soon as it is acknowledged.
                let newest = target.persistence(view).last();
                let inputs = QueryInputs { newest, order: target.order(view, selector), with_outliers };
                &Answering { model, inputs }
            }
        };
        target.predict_trained_into(view, moments, model, selector, out);
    }
}

/// A model with the data that it takes from a query.
struct Answering<'a> {
    model: &'a TrainedModel,
    inputs: QueryInputs,
}

impl TemporalModel for Answering<'_> {
    fn predict(&self, at: Moment) -> f64 {
        self.model.predict_with(at, self.inputs)
    }
}

/// A model that predicts one value at all moments.
struct Constant(f64);

impl TemporalModel for Constant {
    fn predict(&self, _at: Moment) -> f64 {
        self.0
    }
}
