//! One trained model of any kind, of a named state or a cell.
//!
//! Invariant: a prediction is within the bounds of the state's kind. An untrained state has the same prediction as with
//! any other model.

use tidemap_map::{event::StateKind, spec::MapSpec, view::MapView};
use tidemap_model::{
    ORDER_MAX, Sample, StopSignal,
    models::{
        Calibrated, CalibratedOptions, CannotFit, CountRate, Histogram, HistogramSettings, Hypertime, HypertimeMethod,
        HypertimeOptions, MarkovChain, Moment, Pergam, PergamOptions, Readings, TemporalModel, UniformSpectral,
    },
    selector::{ModelKind, ModelSelector},
};

use crate::state_or_cell::StateOrCell;

/// Seed of the random starts of the training: the same readings give the same model.
const SEED: u64 = 0;

/// A model that was trained on the readings of a state.
#[derive(Clone, Debug)]
pub(crate) enum CachedModel {
    /// There are no readings: the prediction of an untrained state.
    Unlearned,
    /// Persistence alone.
    MarkovChain(MarkovChain),
    /// The mean of each interval of a cycle.
    Histogram(Histogram),
    /// Periodic mixture of Gaussians.
    Pergam(Pergam),
    /// Warped hypertime.
    Hypertime(Box<Hypertime>),
    /// Rate of counts.
    Poisson(Box<CountRate>),
    /// Rhythms of day and week.
    Calibrated(Calibrated),
    /// The spectrum of regular readings and its outliers, at the highest order, which answers for all lower ones.
    Uniform(Box<UniformSpectral>),
}

impl CachedModel {
    /// Trains a model on the readings of a state of kind `state_kind`, ascending by time. Models that need no readings
    /// ([`ModelKind::needs_readings`]) give [`CachedModel::Unlearned`].
    ///
    /// # Errors
    /// [`CannotFit`] if a parameter is out of range or the model does not support the readings, or the training
    /// is told to stop.
    pub(crate) fn fit(
        kind: ModelKind,
        state_kind: StateKind,
        samples: &[Sample],
        spec: &MapSpec,
        stop: StopSignal<'_>,
    ) -> Result<Self, CannotFit> {
        if samples.is_empty() {
            return Ok(Self::Unlearned);
        }
        let half_life_secs = spec.half_life_nanos.map(|nanos| nanos as f64 / 1e9);
        let readings = Readings { samples, half_life_secs, stop };
        let hypertime = |method, clusters: u32| {
            let options = HypertimeOptions { method, clusters: clusters as usize, seed: SEED };
            let model = match state_kind {
                StateKind::Probability => Hypertime::fit(readings, &spec.periodicities, &options),
                StateKind::Continuous | StateKind::Count => {
                    Hypertime::fit_continuous(readings, &spec.periodicities, &options)
                }
            };
            model.map(|model| Self::Hypertime(Box::new(model)))
        };
        match kind {
            ModelKind::Auto | ModelKind::Mean | ModelKind::Latest | ModelKind::Spectral => Ok(Self::Unlearned),
            ModelKind::Persistence => MarkovChain::fit(readings).map(Self::MarkovChain),
            ModelKind::Histogram { cycle, bins } => {
                Histogram::fit(readings, &HistogramSettings::new(cycle, bins as usize)).map(Self::Histogram)
            }
            ModelKind::Pergam { gaussians, period_nanos } => {
                let options = PergamOptions { gaussians: gaussians as usize, period_nanos, seed: SEED };
                Pergam::fit(readings, &options).map(Self::Pergam)
            }
            ModelKind::HypertimeEm { clusters } => hypertime(HypertimeMethod::Em, clusters),
            ModelKind::HypertimeKm { clusters } => hypertime(HypertimeMethod::Km, clusters),
            ModelKind::Poisson => {
                CountRate::fit(readings, &spec.periodicities).map(|model| Self::Poisson(Box::new(model)))
            }
            ModelKind::Calibrated => Calibrated::fit(readings, CalibratedOptions::default()).map(Self::Calibrated),
            ModelKind::Uniform => UniformSpectral::fit(readings, ORDER_MAX).map(|model| Self::Uniform(Box::new(model))),
        }
    }

    /// Probability that the state is 1, or the forecast, at each of the moments, written to `out`, which has their
    /// length. A model that stores its outliers ([`CachedModel::Uniform`]) answers 0 or 1 there, as observed.
    pub(crate) fn predict_into(
        &self,
        view: &MapView,
        target: &StateOrCell,
        moments: &[Moment],
        selector: ModelSelector,
        out: &mut [f64],
    ) {
        self.answer(view, target, moments, selector, true, out);
    }

    /// Predicts as [`CachedModel::predict_into`], but without stored outliers, to judge observations.
    pub(crate) fn expect_into(
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
        with_recall: bool,
        out: &mut [f64],
    ) {
        let (latest, uniform);
        let model: &dyn TemporalModel = match self {
            Self::Unlearned => &Constant(target.mean(view)),
            Self::MarkovChain(chain) => {
                // Starts from the newest value, which changes as soon as it is acknowledged; the rates do not change.
                latest = from_newest(*chain, view, target);
                &latest
            }
            Self::Histogram(model) => model,
            Self::Pergam(model) => model,
            Self::Hypertime(model) => &**model,
            Self::Poisson(model) => &**model,
            Self::Calibrated(model) => model,
            Self::Uniform(model) => {
                uniform = Uniform { model, order: target.order(view, selector), with_recall };
                &uniform
            }
        };
        target.predict_fitted_into(view, moments, model, selector, out);
    }
}

fn from_newest(mut chain: MarkovChain, view: &MapView, target: &StateOrCell) -> MarkovChain {
    if let Some((nanos, value)) = target.persistence(view).last() {
        chain.observe(nanos, value);
    }
    chain
}

/// A uniform model at one order, with its outliers or without.
struct Uniform<'a> {
    model: &'a UniformSpectral,
    order: usize,
    with_recall: bool,
}

impl TemporalModel for Uniform<'_> {
    fn predict(&self, at: Moment) -> f64 {
        let recalled = if self.with_recall { self.model.outlier_at(self.order, at) } else { None };
        recalled.map_or_else(|| self.model.predict_at_order(self.order, at), |state| f64::from(u8::from(state)))
    }
}

/// Answers one value at all moments.
struct Constant(f64);

impl TemporalModel for Constant {
    fn predict(&self, _at: Moment) -> f64 {
        self.0
    }
}
