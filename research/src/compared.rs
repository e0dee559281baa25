//! The settings of models that experiments compare: the models of the catalogue, and a weighted mean of two of them.
//!
//! Names of models and parameters are the names of the command line and the protocols. Invariant: a setting can be
//! trained on any readings in the model's range of values; a parameter out of range is refused before data is read.

use tidemap_model::{
    Sample, StateKind, TrainedModel,
    catalogue::{ModelKind, ParameterSet, WrongParameter},
    models::{CannotTrain, Moment, TemporalModel},
    selector::ModelSelector,
};

/// A trained model.
#[derive(Clone, Debug)]
pub enum ComparedModel {
    /// A model of the catalogue.
    One(TrainedModel),
    /// A mean of two.
    Average(Average),
}

impl TemporalModel for ComparedModel {
    fn predict(&self, at: Moment) -> f64 {
        match self {
            Self::One(model) => model.predict(at),
            Self::Average(model) => model.predict(at),
        }
    }
}

impl ComparedModel {
    /// This model with another newest reading, given by its time in nanoseconds UTC and its value, if it answers from
    /// the newest reading; none for other models.
    pub fn with_newest(&self, newest: (i64, f64)) -> Option<ComparedModel> {
        match self {
            Self::One(model) => model.with_newest(newest).map(Self::One),
            Self::Average(_) => None,
        }
    }
}

/// The kinds of models that can be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ComparableKind {
    /// A kind of the catalogue, except `auto`.
    One(ModelKind),
    /// The weighted mean of the calibrated profile and a histogram.
    Average,
}

/// The name of [`ComparableKind::Average`].
const AVERAGE: &str = "average";
/// The parameter of [`ComparableKind::Average`] besides the parameters of its histogram.
const CALIBRATED_WEIGHT: &str = "calibrated_weight";
/// The histogram of an average: a kind with its parameters.
const AVERAGED: ModelKind = tidemap_model::catalogue::HISTOGRAMS[0];

impl ComparableKind {
    /// All kinds, in the order of the command line.
    pub fn all() -> impl Iterator<Item = ComparableKind> {
        let kinds = ModelKind::ALL.into_iter().filter(|kind| *kind != ModelKind::Auto);
        kinds.map(ComparableKind::One).chain([ComparableKind::Average])
    }

    /// The name of the kind in protocols.
    pub fn name(self) -> &'static str {
        match self {
            ComparableKind::One(kind) => kind.name(),
            ComparableKind::Average => AVERAGE,
        }
    }

    /// The names of its parameters.
    pub fn parameters(self) -> Vec<&'static str> {
        match self {
            ComparableKind::One(kind) => kind.info().parameters.to_vec(),
            ComparableKind::Average => [AVERAGED.info().parameters, &[CALIBRATED_WEIGHT]].concat(),
        }
    }
}

/// A kind of model with all its parameters.
#[derive(Clone, Debug)]
pub struct ComparedSettings {
    shown: String,
    settings: Settings,
    blend: ModelSelector,
}

#[derive(Clone, Debug)]
enum Settings {
    One(ParameterSet),
    Average { calibrated: ParameterSet, histogram: ParameterSet, calibrated_weight: f64 },
}

impl ComparedSettings {
    /// A kind with some of the parameters that [`ComparableKind::parameters`] lists, and defaults for the others.
    ///
    /// # Errors
    /// [`WrongParameter`] if a value cannot be read or the model refuses it.
    pub fn new(kind: ComparableKind, parameters: &[(&'static str, &str)]) -> Result<Self, WrongParameter> {
        let settings = match kind {
            ComparableKind::One(kind) => Settings::One(ParameterSet::new(kind, parameters)?),
            ComparableKind::Average => {
                let given = parameters.iter().find(|(name, _)| *name == CALIBRATED_WEIGHT);
                let right = "a number from 0 (the histogram alone) to 1 (the calibrated profile alone)";
                let wrong = || WrongParameter::Value { name: CALIBRATED_WEIGHT, right: right.to_owned() };
                let weight = |text: &str| text.parse().ok().filter(|weight| (0.0..=1.0).contains(weight));
                Settings::Average {
                    calibrated_weight: given.map_or(Ok(0.5), |(_, text)| weight(text).ok_or_else(wrong))?,
                    calibrated: ParameterSet::new(ModelKind::Calibrated, &[])?,
                    histogram: ParameterSet::new(AVERAGED, parameters)?,
                }
            }
        };
        let shown: Vec<String> = parameters.iter().map(|(name, text)| format!("{name}={text}")).collect();
        Ok(Self { shown: shown.join(" "), settings, blend: ModelSelector::default() })
    }

    /// These settings, with predictions that `blend` draws towards the newest reading.
    #[must_use]
    pub fn blended(self, blend: ModelSelector) -> Self {
        Self { blend, ..self }
    }

    /// The blend that draws predictions towards the newest reading.
    pub fn blend(&self) -> ModelSelector {
        self.blend
    }

    /// The parameters of the protocol, such as `bins=24 cycle=day`.
    pub fn shown(&self) -> &str {
        &self.shown
    }

    /// Trains the model on the readings of one state, ascending by time.
    ///
    /// # Errors
    /// [`CannotTrain`] without readings, or if a value is out of the model's range.
    pub fn train(&self, samples: &[Sample], kind: StateKind) -> Result<ComparedModel, CannotTrain> {
        Ok(match &self.settings {
            Settings::One(set) => ComparedModel::One(set.train(samples, kind)?),
            Settings::Average { calibrated, histogram, calibrated_weight } => ComparedModel::Average(Average {
                calibrated: calibrated.train(samples, kind)?,
                histogram: histogram.train(samples, kind)?,
                calibrated_weight: *calibrated_weight,
            }),
        })
    }
}

/// The weighted mean of two profiles whose errors differ: the calibrated one distinguishes days where they differ for
/// certain, the smoothed histogram has more readings behind each value.
#[derive(Clone, Debug)]
pub struct Average {
    calibrated: TrainedModel,
    histogram: TrainedModel,
    /// From 0 to 1; the histogram has the rest.
    calibrated_weight: f64,
}

impl TemporalModel for Average {
    fn predict(&self, at: Moment) -> f64 {
        let weight = self.calibrated_weight;
        weight * self.calibrated.predict(at) + (1.0 - weight) * self.histogram.predict(at)
    }
}
