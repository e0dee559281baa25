//! Which model answers a query.

use std::{fmt, ops::RangeInclusive};

use crate::{FitKind, HISTOGRAMS, ModelChoice, ORDER_MAX, StateModel, models::HistogramCycle, time::format_duration};

mod name;

pub use name::{CLUSTERS_MAX, GAUSSIANS_MAX, InvalidModel};

const MINUTE_NANOS: i64 = 60_000_000_000;
const DAY_NANOS: i64 = 1440 * MINUTE_NANOS;

/// The periods that a periodic mixture of Gaussians may have, in nanoseconds: 1 minute to 366 days.
pub const PERGAM_PERIODS: RangeInclusive<i64> = MINUTE_NANOS..=366 * DAY_NANOS;
/// The default period: a day, in nanoseconds.
pub const PERGAM_PERIOD_NANOS: i64 = DAY_NANOS;

/// Which model answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ModelKind {
    /// The model and order that the last update chose.
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
        /// What repeats.
        cycle: HistogramCycle,
        /// Intervals of the cycle; of weekday and weekend, of each.
        bins: u32,
    },
    /// Periodic mixture of Gaussians (ICRA 2015, eq. 5 to 7).
    Pergam {
        /// Number of Gaussians.
        gaussians: u32,
        /// The period, in nanoseconds of local civil time, within [`PERGAM_PERIODS`].
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
    /// The strongest components of the Fourier transform of regular readings, and the outliers that they miss (T-RO
    /// 2017, section III.B).
    Uniform,
}

impl ModelKind {
    /// Whether it has an order.
    #[inline]
    pub fn has_order(self) -> bool {
        matches!(self, ModelKind::Auto | ModelKind::Spectral | ModelKind::Uniform)
    }

    /// Whether it must be trained on the readings of a state before it can predict.
    pub fn needs_readings(self) -> bool {
        !self.is_for_cells()
    }

    /// Whether cells of a grid support it.
    pub fn is_for_cells(self) -> bool {
        matches!(self, ModelKind::Auto | ModelKind::Mean | ModelKind::Latest | ModelKind::Spectral)
    }
}

impl fmt::Display for ModelKind {
    /// As the command line names it, with its parameter.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Mean => f.write_str("mean"),
            Self::Latest => f.write_str("latest"),
            Self::Spectral => f.write_str("spectral"),
            Self::Persistence => f.write_str("persistence"),
            Self::Histogram { cycle: HistogramCycle::Day, bins } => write!(f, "histogram:{bins}"),
            Self::Histogram { cycle: HistogramCycle::Week, bins } => write!(f, "histogram:week:{bins}"),
            Self::Histogram { cycle: HistogramCycle::WeekdayWeekend, bins } => write!(f, "histogram:weekend:{bins}"),
            Self::Pergam { gaussians, period_nanos: PERGAM_PERIOD_NANOS } => write!(f, "pergam:{gaussians}"),
            Self::Pergam { gaussians, period_nanos } => {
                write!(f, "pergam:{gaussians}:{}", format_duration(*period_nanos))
            }
            Self::HypertimeEm { clusters } => write!(f, "hypertime-em:{clusters}"),
            Self::HypertimeKm { clusters } => write!(f, "hypertime-km:{clusters}"),
            Self::Poisson => f.write_str("poisson"),
            Self::Calibrated => f.write_str("calibrated"),
            Self::Uniform => f.write_str("uniform"),
        }
    }
}

impl fmt::Display for ModelSelector {
    /// As the command line names it; the order is not part of the name.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let suffix = match (self.persistence, self.memory) {
            (true, _) => "+persistence",
            (false, true) => "+memory",
            (false, false) => "",
        };
        write!(f, "{}{suffix}", self.kind)
    }
}

/// A model as a query names it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ModelSelector {
    /// Which model.
    pub kind: ModelKind,
    /// Number of spectral components, at most [`ORDER_MAX`]; by default the order that the last update chose. Ignored
    /// by kinds that have no order.
    pub order: Option<usize>,
    /// Blends the last value in (T-RO eq. 12 and 13).
    pub persistence: bool,
    /// Blends the last value in by the rates of a two-state chain, which allow for changes that nobody saw (RAS 2017,
    /// eq. 6). With [`ModelSelector::persistence`] it is ignored.
    pub memory: bool,
}

impl ModelSelector {
    /// The model that a choice of an update stands for.
    #[must_use]
    pub fn of_choice(choice: ModelChoice, model: &StateModel) -> ModelSelector {
        let kind = match choice {
            ModelChoice::Spectral => {
                let order = Some(model.order());
                return ModelSelector { kind: ModelKind::Spectral, order, ..ModelSelector::default() };
            }
            ModelChoice::Histogram(number) => {
                HISTOGRAMS.get(usize::from(number)).map_or(ModelKind::Auto, |&(cycle, bins)| ModelKind::Histogram {
                    cycle,
                    bins: u32::try_from(bins).unwrap_or(u32::MAX),
                })
            }
            // With the default parameters of requests.
            ModelChoice::Fitted(FitKind::Calibrated) => ModelKind::Calibrated,
            ModelChoice::Fitted(FitKind::Pergam) => {
                ModelKind::Pergam { gaussians: 3, period_nanos: PERGAM_PERIOD_NANOS }
            }
            ModelChoice::Fitted(FitKind::HypertimeEm) => ModelKind::HypertimeEm { clusters: 3 },
            ModelChoice::Fitted(FitKind::Poisson) => ModelKind::Poisson,
            ModelChoice::Fitted(FitKind::HypertimeKm) => ModelKind::HypertimeKm { clusters: 3 },
        };
        ModelSelector { kind, ..ModelSelector::default() }
    }

    /// The model that predicts this state: what the last update chose, if the query leaves the choice to it.
    #[must_use]
    pub fn answering(self, model: &StateModel) -> ModelSelector {
        match (self.kind, self.order) {
            (ModelKind::Auto, None) => {
                let chosen = ModelSelector::of_choice(model.choice(), model);
                ModelSelector { persistence: self.persistence, memory: self.memory, ..chosen }
            }
            _ => self.answering_with(model.order()),
        }
    }

    /// The model that predicts a cell whose spectral model has this order: cells have no other model to choose.
    #[must_use]
    pub fn answering_with(self, order: usize) -> ModelSelector {
        match self.kind {
            ModelKind::Auto | ModelKind::Spectral => {
                ModelSelector { kind: ModelKind::Spectral, order: Some(self.order_or(order)), ..self }
            }
            _ => self,
        }
    }

    /// Whether it predicts from what the last update published alone, without newer values.
    pub fn is_of_generation(&self) -> bool {
        let is_plain = *self == ModelSelector { kind: self.kind, order: self.order, ..ModelSelector::default() };
        is_plain && matches!(self.kind, ModelKind::Auto | ModelKind::Mean | ModelKind::Spectral)
    }

    /// Order of the spectral model that predicts this state; 0 for a constant model or another kind.
    pub fn order_for(&self, model: &StateModel) -> usize {
        let is_other = self.kind == ModelKind::Auto && self.order.is_none() && model.choice() != ModelChoice::Spectral;
        if self.kind.has_order() && !is_other { self.order_or(model.order()) } else { 0 }
    }

    /// Whether the last value is blended in.
    #[must_use]
    #[inline]
    pub fn is_blended(self) -> bool {
        self.persistence || self.memory
    }

    /// This model without the last value.
    #[must_use]
    #[inline]
    pub fn unblended(self) -> ModelSelector {
        ModelSelector { persistence: false, memory: false, ..self }
    }

    /// The requested order, or the one that the last update chose; at most [`ORDER_MAX`].
    #[must_use]
    #[inline]
    pub fn order_or(&self, chosen: usize) -> usize {
        self.order.unwrap_or(chosen).min(ORDER_MAX)
    }
}
