//! Training on the readings of a state, prediction and storage of each kind of model.
//!
//! Invariant: the same readings, parameters and options give the same model; a stored model reads back as the same
//! model, to the last bit.

use super::ModelKind;
use crate::{
    InvalidParts, ORDER_MAX, Periodicities, StateKind, TrainedEnsemble,
    models::{
        COUNT_BIN_NANOS, Calibrated, CalibratedOptions, CalibratedParts, CannotTrain, CountRate, CountRateParts,
        FixedOrder, HISTOGRAM_PRIOR_READINGS, Histogram, HistogramSettings, Hypertime, HypertimeMethod,
        HypertimeOptions, HypertimeParts, Latest, LatestParts, MarkovChain, MarkovChainParts, Mean, Moment, Pergam,
        PergamOptions, PergamParts, Readings, TemporalModel, UniformSpectral,
    },
};

/// Options of training besides the parameters in the name of a model. The daemon always uses the defaults.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainingOptions {
    /// Number of spectral components, at most [`ORDER_MAX`], which is the default.
    pub order: usize,
    /// Seed of random starts. Default 0.
    pub seed: u64,
    /// For a histogram: [`HistogramSettings::smoothing_bins`]. Default 0.
    pub smoothing_bins: f64,
    /// For a histogram: [`HistogramSettings::prior_readings`]. Default [`HISTOGRAM_PRIOR_READINGS`].
    pub prior_readings: f64,
    /// Length of an interval in which readings are counted, in nanoseconds. Default [`COUNT_BIN_NANOS`].
    pub bin_nanos: i64,
}

impl Default for TrainingOptions {
    fn default() -> TrainingOptions {
        TrainingOptions {
            order: ORDER_MAX,
            seed: 0,
            smoothing_bins: 0.0,
            prior_readings: HISTOGRAM_PRIOR_READINGS,
            bin_nanos: COUNT_BIN_NANOS,
        }
    }
}

/// A model that was trained on the readings of a state.
#[derive(Clone, Debug, PartialEq)]
#[expect(missing_docs, reason = "the kinds of ModelKind")]
pub enum TrainedModel {
    Mean(Mean),
    Latest(Latest),
    Persistence(MarkovChain),
    Histogram(Histogram),
    Spectral(Box<FixedOrder>),
    Uniform(Box<UniformSpectral>),
    Pergam(Pergam),
    /// Warped hypertime, by either method.
    Hypertime(Box<Hypertime>),
    Poisson(Box<CountRate>),
    Calibrated(Calibrated),
    Ensemble(Box<TrainedEnsemble>),
}

impl ModelKind {
    /// Trains this model on the readings of a state whose values are of a kind; `periodicities` are those of its map.
    /// The caller checks that states of this kind support the model: [`ModelKind::supports`].
    ///
    /// # Errors
    /// [`CannotTrain`], as [`ModelKind::train_with`] returns it.
    pub fn train(
        self,
        readings: Readings<'_>,
        kind: StateKind,
        periodicities: &Periodicities,
    ) -> Result<TrainedModel, CannotTrain> {
        self.train_with(readings, kind, periodicities, TrainingOptions::default())
    }

    /// Trains this model with options of an experiment. [`ModelKind::Auto`] is trained as the spectral model: there is
    /// no update that could choose.
    ///
    /// # Errors
    /// [`CannotTrain`] if there are no readings, a parameter or a value is outside its range, or the stop signal is
    /// set.
    pub fn train_with(
        self,
        readings: Readings<'_>,
        kind: StateKind,
        periodicities: &Periodicities,
        options: TrainingOptions,
    ) -> Result<TrainedModel, CannotTrain> {
        let TrainingOptions { order, seed, smoothing_bins, prior_readings, bin_nanos } = options;
        let hypertime = |method, clusters: u32| {
            let options = HypertimeOptions { method, clusters: clusters as usize, seed };
            let model = match kind {
                StateKind::Probability => Hypertime::train(readings, periodicities, &options),
                StateKind::Continuous | StateKind::Count => {
                    Hypertime::train_continuous(readings, periodicities, &options)
                }
            };
            model.map(|model| TrainedModel::Hypertime(Box::new(model)))
        };
        Ok(match self {
            Self::Mean => TrainedModel::Mean(Mean::train(readings)?),
            Self::Latest => TrainedModel::Latest(Latest::train(readings)?),
            Self::Persistence => TrainedModel::Persistence(MarkovChain::train(readings)?),
            Self::Histogram { cycle, bins } => {
                let settings = HistogramSettings { cycle, bins: bins as usize, smoothing_bins, prior_readings };
                TrainedModel::Histogram(Histogram::train(readings, &settings)?)
            }
            Self::Auto | Self::Spectral => {
                TrainedModel::Spectral(Box::new(FixedOrder::train(readings, kind, periodicities, order)?))
            }
            Self::Uniform => TrainedModel::Uniform(Box::new(UniformSpectral::train(readings, order)?)),
            Self::Pergam { gaussians, period_nanos } => {
                let options = PergamOptions { gaussians: gaussians as usize, period_nanos, seed };
                TrainedModel::Pergam(Pergam::train(readings, &options)?)
            }
            Self::HypertimeEm { clusters } => hypertime(HypertimeMethod::Em, clusters)?,
            Self::HypertimeKm { clusters } => hypertime(HypertimeMethod::Km, clusters)?,
            Self::Poisson => {
                TrainedModel::Poisson(Box::new(CountRate::train_in_bins(readings, periodicities, bin_nanos)?))
            }
            Self::Calibrated => TrainedModel::Calibrated(Calibrated::train(readings, CalibratedOptions::default())?),
            Self::Ensemble => TrainedModel::Ensemble(Box::new(TrainedEnsemble::train(readings, kind)?)),
        })
    }

    /// The training options of warped hypertime of this kind for values with a place; `None` for other kinds, which
    /// have no distribution over places.
    pub fn hypertime_options(self) -> Option<HypertimeOptions> {
        let (method, clusters) = match self {
            Self::HypertimeEm { clusters } => (HypertimeMethod::Em, clusters),
            Self::HypertimeKm { clusters } => (HypertimeMethod::Km, clusters),
            _ => return None,
        };
        Some(HypertimeOptions { method, clusters: clusters as usize, seed: TrainingOptions::default().seed })
    }
}

impl TrainedModel {
    fn model(&self) -> &dyn TemporalModel {
        match self {
            Self::Mean(model) => model,
            Self::Latest(model) => model,
            Self::Persistence(model) => model,
            Self::Histogram(model) => model,
            Self::Spectral(model) => &**model,
            Self::Uniform(model) => &**model,
            Self::Pergam(model) => model,
            Self::Hypertime(model) => &**model,
            Self::Poisson(model) => &**model,
            Self::Calibrated(model) => model,
            Self::Ensemble(model) => &**model,
        }
    }
}

impl TemporalModel for TrainedModel {
    fn predict(&self, at: Moment) -> f64 {
        self.model().predict(at)
    }
}

/// The inputs of a prediction that come from the query and from the newest values, not from training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QueryInputs {
    /// The newest value and its time, nanoseconds UTC: the Markov chain starts from it.
    pub newest: Option<(i64, f64)>,
    /// Number of components of a uniform model.
    pub order: usize,
    /// Whether a uniform model predicts the observed value, 0 or 1, at the moments of its stored outliers.
    pub with_outliers: bool,
}

impl TrainedModel {
    /// The predicted value at a moment, given these inputs.
    pub fn predict_with(&self, at: Moment, inputs: QueryInputs) -> f64 {
        match self {
            Self::Persistence(chain) => {
                let mut chain = *chain;
                if let Some((nanos, value)) = inputs.newest {
                    chain.observe(nanos, value);
                }
                chain.predict(at)
            }
            Self::Uniform(model) => {
                let outlier = if inputs.with_outliers { model.outlier_at(inputs.order, at) } else { None };
                outlier.map_or_else(|| model.predict_at_order(inputs.order, at), |state| f64::from(u8::from(state)))
            }
            other => other.predict(at),
        }
    }
}

impl TrainedModel {
    /// This model with another newest reading, given by its time in nanoseconds UTC and its value; the reading may be
    /// older than the training data. `None` for models that do not predict from the newest reading.
    pub fn with_newest(&self, (last_nanos, last_value): (i64, f64)) -> Option<TrainedModel> {
        let model = match self {
            Self::Latest(model) => {
                let first_nanos = model.to_parts().first_nanos.min(last_nanos);
                let parts = LatestParts { first_nanos, last_nanos, last_value, ..model.to_parts() };
                Latest::from_parts(parts).map(Self::Latest)
            }
            Self::Persistence(chain) => {
                let parts = MarkovChainParts { last_nanos, last_value, ..chain.to_parts() };
                MarkovChain::from_parts(parts).map(Self::Persistence)
            }
            _ => return None,
        };
        model.ok()
    }
}

/// The parts of a [`TrainedModel`] of the nightly update, for storage.
#[derive(Clone, Debug, PartialEq)]
#[expect(missing_docs, reason = "the kinds of ModelKind")]
pub enum TrainedModelParts {
    Calibrated(CalibratedParts),
    Pergam(PergamParts),
    Hypertime(HypertimeParts),
    Poisson(CountRateParts),
}

impl TrainedModel {
    /// The kind of this model in the nightly update; `None` if updates do not train such models.
    pub fn kind_at_night(&self) -> Option<ModelKind> {
        match self {
            Self::Calibrated(_) => Some(ModelKind::Calibrated),
            Self::Pergam(_) => Some(ModelKind::PERGAM),
            Self::Hypertime(model) => Some(match model.method() {
                HypertimeMethod::Em => ModelKind::HYPERTIME_EM,
                HypertimeMethod::Km => ModelKind::HYPERTIME_KM,
            }),
            Self::Poisson(_) => Some(ModelKind::Poisson),
            Self::Mean(_)
            | Self::Latest(_)
            | Self::Persistence(_)
            | Self::Histogram(_)
            | Self::Spectral(_)
            | Self::Uniform(_)
            | Self::Ensemble(_) => None,
        }
    }

    /// Its parts, for storage; `None` if updates do not train such models.
    pub fn to_parts(&self) -> Option<TrainedModelParts> {
        match self {
            Self::Calibrated(model) => Some(TrainedModelParts::Calibrated(model.to_parts())),
            Self::Pergam(model) => Some(TrainedModelParts::Pergam(model.to_parts())),
            Self::Hypertime(model) => Some(TrainedModelParts::Hypertime(model.to_parts())),
            Self::Poisson(model) => Some(TrainedModelParts::Poisson(model.to_parts())),
            _ => None,
        }
    }

    /// The model of a state of the given kind from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is outside its range, or states of that kind do not support the model.
    pub fn from_parts_of(state_kind: StateKind, parts: TrainedModelParts) -> Result<TrainedModel, InvalidParts> {
        let is_of_other_kind = match &parts {
            TrainedModelParts::Hypertime(parts) => {
                matches!(parts, HypertimeParts::Probability(_)) != (state_kind == StateKind::Probability)
            }
            _ => false,
        };
        let model = match parts {
            TrainedModelParts::Calibrated(parts) => Self::Calibrated(Calibrated::from_parts(parts)?),
            TrainedModelParts::Pergam(parts) => Self::Pergam(Pergam::from_parts(&parts)?),
            TrainedModelParts::Hypertime(parts) => Self::Hypertime(Box::new(Hypertime::from_parts(&parts)?)),
            TrainedModelParts::Poisson(parts) => Self::Poisson(Box::new(CountRate::from_parts(parts)?)),
        };
        if is_of_other_kind || !model.kind_at_night().is_some_and(|kind| kind.supports(state_kind)) {
            return Err(InvalidParts::OutOfRange { field: "model of another kind of states", found: f64::NAN });
        }
        Ok(model)
    }
}

impl From<Calibrated> for TrainedModel {
    fn from(model: Calibrated) -> TrainedModel {
        Self::Calibrated(model)
    }
}
