//! Models that are trained on the readings of a state outside its update: their kinds, and a model of any kind.
//!
//! Invariant: a stored model reads back as the same model.

use crate::{
    InvalidParts, Periodicities, StateKind,
    models::{
        Calibrated, CalibratedOptions, CalibratedParts, CannotFit, CountRate, CountRateParts, Hypertime,
        HypertimeMethod, HypertimeOptions, HypertimeParts, Moment, Pergam, PergamOptions, PergamParts, Readings,
        TemporalModel,
    },
};

/// Gaussians of a periodic mixture.
const GAUSSIANS: usize = 3;
/// Clusters of a warped hypertime.
const CLUSTERS: usize = 3;
/// Seed of the random starts of the training: the same readings give the same model.
const SEED: u64 = 0;

/// A kind of model that is trained on the readings themselves, with the one setting in which it is tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum FitKind {
    /// [`Calibrated`], with its defaults.
    Calibrated,
    /// [`Pergam`], three Gaussians over the day. Of probabilities only.
    Pergam,
    /// [`Hypertime`] by expectation-maximisation, three clusters.
    HypertimeEm,
    /// [`Hypertime`] by k-means, up to three clusters.
    HypertimeKm,
    /// [`CountRate`]. Of counts only.
    Poisson,
}

impl FitKind {
    /// All kinds. Their places are stored: a new kind is added at the end.
    pub const ALL: [FitKind; 5] =
        [FitKind::Calibrated, FitKind::Pergam, FitKind::HypertimeEm, FitKind::HypertimeKm, FitKind::Poisson];

    /// Whether states of the given kind support it.
    pub fn is_for(self, state_kind: StateKind) -> bool {
        match self {
            FitKind::Pergam => state_kind == StateKind::Probability,
            FitKind::Poisson => state_kind == StateKind::Count,
            FitKind::Calibrated | FitKind::HypertimeEm | FitKind::HypertimeKm => true,
        }
    }

    /// Whether the training takes milliseconds, so that it may be repeated daily.
    pub(super) fn is_cheap(self) -> bool {
        matches!(self, FitKind::Calibrated | FitKind::Poisson)
    }

    /// Its index in [`FitKind::ALL`].
    pub(super) fn index(self) -> usize {
        self as usize
    }

    /// The name, as on the command line.
    pub fn name(self) -> &'static str {
        match self {
            FitKind::Calibrated => "calibrated",
            FitKind::Pergam => "pergam",
            FitKind::HypertimeEm => "hypertime-em",
            FitKind::HypertimeKm => "hypertime-km",
            FitKind::Poisson => "poisson",
        }
    }
}

const SPECTRAL_NAME: &str = "spectral";
const HISTOGRAM_NAME: &str = "histogram";

/// Which models the update of a state chooses among. The spectral model always is one of them; its order 0 is the mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct EnabledModels {
    /// Whether [`crate::HISTOGRAMS`] are tried.
    pub histograms: bool,
    fits: [bool; FitKind::ALL.len()],
}

impl Default for EnabledModels {
    /// Histograms, the calibrated model and, for counts, the Poisson model, which are cheap.
    fn default() -> EnabledModels {
        EnabledModels { histograms: true, ..EnabledModels::SPECTRAL }
            .with_fit(FitKind::Calibrated)
            .with_fit(FitKind::Poisson)
    }
}

impl EnabledModels {
    /// The spectral model alone.
    pub const SPECTRAL: EnabledModels = EnabledModels { histograms: false, fits: [false; FitKind::ALL.len()] };

    /// All models.
    pub const ALL: EnabledModels = EnabledModels { histograms: true, fits: [true; FitKind::ALL.len()] };

    /// These models, with or without histograms.
    #[must_use]
    pub fn with_histograms(self, histograms: bool) -> EnabledModels {
        EnabledModels { histograms, ..self }
    }

    /// These models, and the models of the given kind.
    #[must_use]
    pub fn with_fit(mut self, kind: FitKind) -> EnabledModels {
        self.fits[kind.index()] = true;
        self
    }

    /// These models, and the one of a name (see [`EnabledModels::names`]) or, with `all`, every model; `None` for any
    /// other name.
    #[must_use]
    pub fn with_named(self, name: &str) -> Option<EnabledModels> {
        let fit = FitKind::ALL.into_iter().find(|kind| kind.name() == name);
        match (name, fit) {
            ("all", _) => Some(EnabledModels::ALL),
            (SPECTRAL_NAME, _) => Some(self),
            (HISTOGRAM_NAME, _) => Some(self.with_histograms(true)),
            (_, fit) => fit.map(|kind| self.with_fit(kind)),
        }
    }

    /// The names of the models, as on the command line.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        let histogram = self.histograms.then_some(HISTOGRAM_NAME);
        [SPECTRAL_NAME].into_iter().chain(histogram).chain(self.fits().map(FitKind::name))
    }

    /// These models without those that are trained on readings.
    #[must_use]
    pub fn without_fits(self) -> EnabledModels {
        EnabledModels { fits: [false; FitKind::ALL.len()], ..self }
    }

    /// Whether models of the given kind are enabled.
    pub(crate) fn has_fit(self, kind: FitKind) -> bool {
        self.fits[kind.index()]
    }

    /// The kinds that are trained on readings.
    pub fn fits(self) -> impl Iterator<Item = FitKind> {
        FitKind::ALL.into_iter().filter(move |kind| self.has_fit(*kind))
    }
}

/// A model that was trained on the readings of a state.
#[derive(Clone, Debug, PartialEq)]
pub enum FittedModel {
    /// A profile of the week.
    Calibrated(Calibrated),
    /// A periodic mixture of Gaussians.
    Pergam(Pergam),
    /// Warped hypertime, by either method.
    Hypertime(Hypertime),
    /// The rate of counts.
    Poisson(CountRate),
}

/// What a [`FittedModel`] consists of, for storage.
#[derive(Clone, Debug, PartialEq)]
pub enum FittedModelParts {
    /// Of a profile of the week.
    Calibrated(CalibratedParts),
    /// Of a periodic mixture of Gaussians.
    Pergam(PergamParts),
    /// Of a warped hypertime.
    Hypertime(HypertimeParts),
    /// Of the rate of counts.
    Poisson(CountRateParts),
}

impl FittedModel {
    /// Trains a model of this kind on readings of a state of kind `state_kind`; `periodicities` are those of its map.
    ///
    /// # Errors
    /// [`CannotFit`] where there are no readings, or states of that kind do not support the model.
    pub fn fit(
        kind: FitKind,
        state_kind: StateKind,
        readings: Readings<'_>,
        periodicities: &Periodicities,
    ) -> Result<FittedModel, CannotFit> {
        let hypertime = |method| {
            let options = HypertimeOptions { method, clusters: CLUSTERS, seed: SEED };
            match state_kind {
                StateKind::Probability => Hypertime::fit(readings, periodicities, &options),
                StateKind::Continuous | StateKind::Count => {
                    Hypertime::fit_continuous(readings, periodicities, &options)
                }
            }
        };
        match kind {
            _ if !kind.is_for(state_kind) => Err(CannotFit::NoReadings),
            FitKind::Poisson => CountRate::fit(readings, periodicities).map(Self::Poisson),
            FitKind::Calibrated => Calibrated::fit(readings, CalibratedOptions::default()).map(Self::Calibrated),
            FitKind::Pergam => {
                let options = PergamOptions { gaussians: GAUSSIANS, seed: SEED, ..PergamOptions::default() };
                Pergam::fit(readings, &options).map(Self::Pergam)
            }
            FitKind::HypertimeEm => hypertime(HypertimeMethod::Em).map(Self::Hypertime),
            FitKind::HypertimeKm => hypertime(HypertimeMethod::Km).map(Self::Hypertime),
        }
    }

    /// Which kind of model this is.
    pub fn kind(&self) -> FitKind {
        match self {
            Self::Calibrated(_) => FitKind::Calibrated,
            Self::Pergam(_) => FitKind::Pergam,
            Self::Poisson(_) => FitKind::Poisson,
            Self::Hypertime(model) => match model.method() {
                HypertimeMethod::Em => FitKind::HypertimeEm,
                HypertimeMethod::Km => FitKind::HypertimeKm,
            },
        }
    }

    /// Its parts, for storage.
    pub fn to_parts(&self) -> FittedModelParts {
        match self {
            Self::Calibrated(model) => FittedModelParts::Calibrated(model.to_parts()),
            Self::Pergam(model) => FittedModelParts::Pergam(model.to_parts()),
            Self::Hypertime(model) => FittedModelParts::Hypertime(model.to_parts()),
            Self::Poisson(model) => FittedModelParts::Poisson(model.to_parts()),
        }
    }

    /// The model of a state of the given kind from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is outside its range, or states of that kind do not support the model.
    pub fn from_parts_of(state_kind: StateKind, parts: FittedModelParts) -> Result<FittedModel, InvalidParts> {
        let is_probability = state_kind == StateKind::Probability;
        let is_fitting = match &parts {
            FittedModelParts::Calibrated(_) => true,
            FittedModelParts::Pergam(_) => is_probability,
            FittedModelParts::Poisson(_) => state_kind == StateKind::Count,
            FittedModelParts::Hypertime(HypertimeParts::Probability(_)) => is_probability,
            FittedModelParts::Hypertime(HypertimeParts::Continuous(_)) => !is_probability,
        };
        if !is_fitting {
            return Err(InvalidParts::OutOfRange { field: "model of another kind of states", found: f64::NAN });
        }
        Ok(match parts {
            FittedModelParts::Calibrated(parts) => Self::Calibrated(Calibrated::from_parts(parts)?),
            FittedModelParts::Pergam(parts) => Self::Pergam(Pergam::from_parts(&parts)?),
            FittedModelParts::Hypertime(parts) => Self::Hypertime(Hypertime::from_parts(&parts)?),
            FittedModelParts::Poisson(parts) => Self::Poisson(CountRate::from_parts(parts)?),
        })
    }
}

impl TemporalModel for FittedModel {
    fn predict(&self, at: Moment) -> f64 {
        match self {
            Self::Calibrated(model) => model.predict(at),
            Self::Pergam(model) => model.predict(at),
            Self::Hypertime(model) => model.predict(at),
            Self::Poisson(model) => model.predict(at),
        }
    }
}

impl From<Calibrated> for FittedModel {
    fn from(model: Calibrated) -> FittedModel {
        Self::Calibrated(model)
    }
}

impl From<Pergam> for FittedModel {
    fn from(model: Pergam) -> FittedModel {
        Self::Pergam(model)
    }
}

impl From<Hypertime> for FittedModel {
    fn from(model: Hypertime) -> FittedModel {
        Self::Hypertime(model)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_models_read_back() {
        for models in [EnabledModels::ALL, EnabledModels::SPECTRAL, EnabledModels::default()] {
            let read = models.names().try_fold(EnabledModels::SPECTRAL, EnabledModels::with_named);
            assert_eq!(read, Some(models));
        }
        assert_eq!(EnabledModels::SPECTRAL.with_named("all"), Some(EnabledModels::ALL));
        for name in ["mean", "", "fremen", "pergam:3"] {
            assert_eq!(EnabledModels::ALL.with_named(name), None, "{name}");
        }
    }
}
