//! The catalogue of models: every kind with its parameters, and the properties that the rest of the code needs.
//!
//! The selector of a query, the choice of the nightly update, the cache of models that are trained on request,
//! `evaluate`, experiments, the Python package, the wire and the command line all read this table. [`trained`] defines
//! how a kind is trained on readings, predicts and is stored; the formulae of each kind are in a file of its own in
//! `models/`.
//!
//! Invariant: a kind has one name and one list of the states that support it, and both are defined here; so are its
//! defaults, except the number of clusters in experiments (`parameters.rs`). A kind with other parameters is another
//! model: two of them are never compared, scored or cached as one.

use std::ops::RangeInclusive;

use crate::{
    StateKind,
    models::{HistogramCycle, HypertimeOptions, PergamOptions},
};

mod enabled;
mod name;
mod parameters;
mod trained;

pub use enabled::EnabledModels;
pub(crate) use name::listed;
pub use parameters::{ParameterSet, WrongParameter};
pub use trained::{QueryInputs, TrainedModel, TrainedModelParts, TrainingOptions};

const MINUTE_NANOS: i64 = 60_000_000_000;
const DAY_NANOS: i64 = 1440 * MINUTE_NANOS;
/// Default number of Gaussians, and of clusters.
const COMPONENTS: u32 = 3;

pub use crate::models::NIGHTLY_WINDOW_NANOS;

/// The model that predicts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ModelKind {
    /// The default: the ensemble where a state has one, else the model and order that the last update chose.
    #[default]
    Auto,
    /// The mean of the learned values.
    Mean,
    /// The last acknowledged value; the prior before the first.
    Latest,
    /// The mean and the strongest spectral components (T-RO 2017, section III).
    Spectral,
    /// The two-state Markov chain, from the newest value onwards (RAS 2017, section 4.2).
    Persistence,
    /// The mean of each interval of a cycle (RA-L 2019, section IV).
    Histogram {
        /// The cycle that repeats.
        cycle: HistogramCycle,
        /// Number of intervals of the cycle; for weekday and weekend, number for each of the two.
        bins: u32,
    },
    /// Periodic mixture of Gaussians (ICRA 2015, eq. 5 to 7).
    Pergam {
        /// Number of Gaussians.
        gaussians: u32,
        /// The period, in nanoseconds of local civil time, within [`ModelKind::PERIODS_NANOS`].
        period_nanos: i64,
    },
    /// Warped hypertime, by expectation maximisation (RA-L 2019, section III).
    HypertimeEm {
        /// Number of clusters.
        clusters: u32,
    },
    /// Warped hypertime, by k-means (RA-L 2019, section III).
    HypertimeKm {
        /// Number of clusters.
        clusters: u32,
    },
    /// A spectral model of the rate of counts.
    Poisson,
    /// Regression on the rhythms of day and week.
    Calibrated,
    /// All models of a state, weighted by how well each has predicted, with the uncertainty that follows from the
    /// number of half-hour bins.
    Ensemble,
    /// The strongest components of the Fourier transform of regular readings, and the outliers from these (T-RO 2017,
    /// section III.B).
    Uniform,
}

/// The histograms that the nightly update tries. They follow from its sums and need no training. Their places are
/// stored: a new one is added at the end.
pub const HISTOGRAMS: [ModelKind; 3] = [
    ModelKind::Histogram { cycle: HistogramCycle::Day, bins: 24 },
    ModelKind::Histogram { cycle: HistogramCycle::WeekdayWeekend, bins: 24 },
    ModelKind::Histogram { cycle: HistogramCycle::Week, bins: 168 },
];

/// The models that the nightly update trains on readings, each with the parameters with which it is tried. Their places
/// are stored: a new one is added at the end.
pub const TRAINED_AT_NIGHT: [ModelKind; 5] =
    [ModelKind::Calibrated, ModelKind::PERGAM, ModelKind::HYPERTIME_EM, ModelKind::HYPERTIME_KM, ModelKind::Poisson];

/// The states that support a kind of model, by what their values mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SupportedStates {
    /// All states.
    All,
    /// States of probabilities; cells of a grid are such.
    Probabilities,
    /// States of counts.
    Counts,
}

/// The source of a model for a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Training {
    /// Updates publish the model of each state, and of each cell of a grid: it predicts at once.
    Published,
    /// Updates publish the model of each named state; cells do not have it.
    PublishedOfStates,
    /// The model is trained on the readings of the state: on request, and at night if it is in [`TRAINED_AT_NIGHT`].
    OnReadings(TrainingCost),
}

/// The training time of one model on the readings of twelve weeks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TrainingCost {
    /// Milliseconds: it may be repeated daily.
    Low,
    /// Tenths of a second.
    Medium,
    /// Seconds.
    High,
}

/// The properties of a kind of model that do not depend on its parameters.
#[derive(Clone, Copy, Debug)]
pub struct ModelInfo {
    /// The name without parameters, on the command line, in protocols and in Python.
    pub name: &'static str,
    /// The states that support the model.
    pub states: SupportedStates,
    /// The source of the model for a query.
    pub training: Training,
    /// The names of its parameters in protocols and in Python: see [`ParameterSet`].
    pub parameters: &'static [&'static str],
}

impl ModelKind {
    /// The periods that a model with a period may have, in nanoseconds: 1 minute to 366 days.
    pub const PERIODS_NANOS: RangeInclusive<i64> = MINUTE_NANOS..=366 * DAY_NANOS;
    /// The default period: a day, in nanoseconds.
    pub const PERIOD_NANOS: i64 = DAY_NANOS;

    /// The periodic mixture with its default parameters: three Gaussians over a day.
    pub const PERGAM: Self = Self::Pergam { gaussians: COMPONENTS, period_nanos: Self::PERIOD_NANOS };
    /// Warped hypertime by expectation maximisation with its default parameter: three clusters.
    pub const HYPERTIME_EM: Self = Self::HypertimeEm { clusters: COMPONENTS };
    /// Warped hypertime by k-means with its default parameter: three clusters.
    pub const HYPERTIME_KM: Self = Self::HypertimeKm { clusters: COMPONENTS };

    /// Every kind, with its default parameters, in the order of the command line.
    pub const ALL: [Self; 13] = [
        Self::Auto,
        Self::Mean,
        Self::Latest,
        Self::Persistence,
        HISTOGRAMS[0],
        Self::Spectral,
        Self::Uniform,
        Self::PERGAM,
        Self::HYPERTIME_EM,
        Self::HYPERTIME_KM,
        Self::Poisson,
        Self::Calibrated,
        Self::Ensemble,
    ];

    /// The row of this kind in the table of all kinds.
    pub fn info(self) -> ModelInfo {
        use SupportedStates::{All, Counts, Probabilities};
        const PUBLISHED: Training = Training::Published;
        const LOW: Training = Training::OnReadings(TrainingCost::Low);
        const MEDIUM: Training = Training::OnReadings(TrainingCost::Medium);
        const HIGH: Training = Training::OnReadings(TrainingCost::High);
        const OF_BINS: &[&str] = &["bins", "cycle", "smoothing_bins", "prior_readings"];
        const OF_RHYTHMS: &[&str] = &["order", "period_base", "period_count"];
        const OF_CLUSTERS: &[&str] = &["clusters", "seed", "period_base", "period_count"];
        let row = |name, states, training, parameters| ModelInfo { name, states, training, parameters };
        match self {
            Self::Auto => row("auto", All, PUBLISHED, OF_RHYTHMS),
            Self::Mean => row("mean", All, PUBLISHED, &[]),
            Self::Latest => row("latest", All, PUBLISHED, &[]),
            Self::Persistence => row("persistence", Probabilities, LOW, &[]),
            Self::Histogram { .. } => row("histogram", All, LOW, OF_BINS),
            Self::Spectral => row("spectral", All, PUBLISHED, OF_RHYTHMS),
            Self::Uniform => row("uniform", Probabilities, LOW, &["order"]),
            Self::Pergam { .. } => row("pergam", Probabilities, MEDIUM, &["gaussians", "period", "seed"]),
            Self::HypertimeEm { .. } => row("hypertime-em", All, HIGH, OF_CLUSTERS),
            Self::HypertimeKm { .. } => row("hypertime-km", All, HIGH, OF_CLUSTERS),
            Self::Poisson => row("poisson", Counts, LOW, &["bin", "period_base", "period_count"]),
            Self::Calibrated => row("calibrated", All, LOW, &[]),
            Self::Ensemble => row("ensemble", All, Training::PublishedOfStates, &[]),
        }
    }

    /// The parameters of this model that are part of its name.
    fn parameters_mut(&mut self) -> NamedParameters<'_> {
        let none = NamedParameters::default();
        match self {
            Self::Histogram { cycle, bins } => {
                let max = u32::try_from(cycle.max_bins()).unwrap_or(u32::MAX);
                let per = if *cycle == HistogramCycle::Week { " a week" } else { " a day" };
                let limit = CountLimit { max, noun: "bins", per };
                NamedParameters { count: Some((bins, limit)), cycle: Some(cycle), ..none }
            }
            Self::Pergam { gaussians, period_nanos } => {
                let limit = CountLimit { max: PergamOptions::GAUSSIANS_MAX as u32, noun: "Gaussians", per: "" };
                NamedParameters { count: Some((gaussians, limit)), period_nanos: Some(period_nanos), ..none }
            }
            Self::HypertimeEm { clusters } | Self::HypertimeKm { clusters } => {
                let limit = CountLimit { max: HypertimeOptions::CLUSTERS_MAX as u32, noun: "clusters", per: "" };
                NamedParameters { count: Some((clusters, limit)), ..none }
            }
            _ => none,
        }
    }
}

/// The parameters that are part of the name of a model, as far as it has them.
#[derive(Debug, Default)]
struct NamedParameters<'a> {
    count: Option<(&'a mut u32, CountLimit)>,
    cycle: Option<&'a mut HistogramCycle>,
    period_nanos: Option<&'a mut i64>,
}

/// The meaning of the number in the name of a model, as in `pergam:3`, and its maximum; the minimum is 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CountLimit {
    /// The maximum of the number.
    pub max: u32,
    /// The noun for the counted items, such as `bins`.
    pub noun: &'static str,
    /// The unit to which the count refers, such as ` a day`; may be empty.
    pub per: &'static str,
}

/// Properties of a model from the table, and its parameters.
impl ModelKind {
    /// The kind of a name, with its default parameters; `None` for any other name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// The name without parameters.
    pub fn name(self) -> &'static str {
        self.info().name
    }

    /// Whether states of this kind support the model.
    pub fn supports(self, kind: StateKind) -> bool {
        self.info().states.contains(kind)
    }

    /// Whether it has an order.
    #[inline]
    pub fn has_order(self) -> bool {
        // Predictions of cells call this for every cell, so it does not read the table. A test compares both.
        matches!(self, Self::Auto | Self::Spectral | Self::Uniform)
    }

    /// Whether it must be trained on the readings of a state before it can predict.
    pub fn needs_readings(self) -> bool {
        matches!(self.info().training, Training::OnReadings(_))
    }

    /// Whether all cells of a grid have it, without training.
    pub fn is_for_cells(self) -> bool {
        self.info().training == Training::Published
    }

    /// Whether it predicts from the newest value, which may not be learned by an update yet.
    pub fn takes_newest(self) -> bool {
        matches!(self, Self::Latest | Self::Persistence)
    }

    /// The training time of the model; `None` if it is not trained on readings.
    pub fn cost(self) -> Option<TrainingCost> {
        match self.info().training {
            Training::Published | Training::PublishedOfStates => None,
            Training::OnReadings(cost) => Some(cost),
        }
    }

    /// Whether training takes milliseconds, so that it may be repeated daily.
    pub(crate) fn is_cheap(self) -> bool {
        self.cost() == Some(TrainingCost::Low)
    }

    /// Its place in [`TRAINED_AT_NIGHT`]; `None` if the update does not train it with these parameters.
    pub(crate) fn place_at_night(self) -> Option<usize> {
        TRAINED_AT_NIGHT.iter().position(|&kind| kind == self)
    }

    /// The number of bins, Gaussians or clusters; `None` if it has none.
    pub fn count(mut self) -> Option<u32> {
        self.parameters_mut().count.map(|(count, _)| *count)
    }

    /// The meaning of [`ModelKind::count`], and its maximum.
    pub fn count_limit(mut self) -> Option<CountLimit> {
        self.parameters_mut().count.map(|(_, limit)| limit)
    }

    /// This model with another number of bins, Gaussians or clusters; unchanged if it has none.
    #[must_use]
    pub fn with_count(mut self, number: u32) -> Self {
        if let Some((count, _)) = self.parameters_mut().count {
            *count = number;
        }
        self
    }

    /// The cycle that repeats; `None` if it is no histogram.
    pub fn cycle(mut self) -> Option<HistogramCycle> {
        self.parameters_mut().cycle.copied()
    }

    /// The cycle of a histogram and its number of bins; `None` if it is no histogram.
    pub fn histogram(self) -> Option<(HistogramCycle, usize)> {
        Some((self.cycle()?, self.count()? as usize))
    }

    /// This model with another cycle and its usual number of bins; unchanged if it is no histogram.
    #[must_use]
    pub fn with_cycle(mut self, wanted: HistogramCycle) -> Self {
        match self.parameters_mut().cycle {
            Some(cycle) => *cycle = wanted,
            None => return self,
        }
        self.with_count(wanted.usual_bins())
    }

    /// The period in nanoseconds; `None` if it has none that can be set.
    pub fn period_nanos(mut self) -> Option<i64> {
        self.parameters_mut().period_nanos.copied()
    }

    /// This model with another period; unchanged if it has none.
    #[must_use]
    pub fn with_period(mut self, nanos: i64) -> Self {
        if let Some(period_nanos) = self.parameters_mut().period_nanos {
            *period_nanos = nanos;
        }
        self
    }
}

impl SupportedStates {
    /// Whether states of this kind are among these states.
    pub fn contains(self, kind: StateKind) -> bool {
        match self {
            Self::All => true,
            Self::Probabilities => kind == StateKind::Probability,
            Self::Counts => kind == StateKind::Count,
        }
    }

    /// The values of these states, in words.
    pub fn values(self) -> &'static str {
        match self {
            Self::All => "any values",
            Self::Probabilities => "probabilities",
            Self::Counts => "counts",
        }
    }
}

/// The stored form of the choice of an update.
impl ModelKind {
    /// The number under which the first of [`TRAINED_AT_NIGHT`] is stored as the model in force; the others follow.
    /// Smaller numbers are free for [`HISTOGRAMS`].
    const TRAINED_ID: u8 = 128;

    /// The number under which a model that is in force is stored: 0 the spectral model, from 128 on those of
    /// [`TRAINED_AT_NIGHT`], else the place in [`HISTOGRAMS`], from 1. `None` if updates do not choose it.
    pub fn id(self) -> Option<u8> {
        let histogram = || HISTOGRAMS.iter().position(|&kind| kind == self).map(|place| place as u8 + 1);
        let trained = || self.place_at_night().map(|place| place as u8 + Self::TRAINED_ID);
        if self == Self::Spectral { Some(0) } else { histogram().or_else(trained) }
    }

    /// The model of a stored number; `None` if there is none.
    pub fn from_id(id: u8) -> Option<Self> {
        match id.checked_sub(Self::TRAINED_ID) {
            Some(place) => TRAINED_AT_NIGHT.get(usize::from(place)).copied(),
            None if id == 0 => Some(Self::Spectral),
            None => HISTOGRAMS.get(usize::from(id - 1)).copied(),
        }
    }
}

#[cfg(test)]
mod tests;
