//! Which model answers, as people name it.
//!
//! Invariant: a name reads back as what it was written from.

use std::{fmt, str::FromStr};

use tidemap_map::time::{InvalidDuration, format_duration, parse_duration};
use tidemap_proto::{
    convert::time::{duration, span},
    v1,
};

/// Greatest order of the spectral model.
pub const ORDER_MAX: u32 = 15;

const MINUTE_NANOS: i64 = 60_000_000_000;
const DAY_NANOS: i64 = 1440 * MINUTE_NANOS;

/// A kind of model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ModelKind {
    /// What the last update chose for each state.
    #[default]
    Auto,
    /// The mean of all values folded in.
    Mean,
    /// The last acknowledged value.
    Latest,
    /// A Markov chain of two states from the newest value on.
    Persistence,
    /// The mean of each interval of the day or the week.
    Histogram,
    /// FreMEn: the mean and the strongest spectral components.
    Spectral,
    /// FreMEn of regular observations of 0 and 1, with the outliers that it misses.
    Uniform,
    /// A periodic mixture of Gaussians, over the day or another period.
    Pergam,
    /// Warped hypertime, by expectation maximisation.
    HypertimeEm,
    /// Warped hypertime, by k-means.
    HypertimeKm,
    /// A spectral model of the rate of counts.
    Poisson,
    /// Regression on the rhythms of day and week.
    Calibrated,
}

impl ModelKind {
    /// All of them.
    pub const ALL: [Self; 12] = [
        Self::Auto,
        Self::Mean,
        Self::Latest,
        Self::Persistence,
        Self::Histogram,
        Self::Spectral,
        Self::Uniform,
        Self::Pergam,
        Self::HypertimeEm,
        Self::HypertimeKm,
        Self::Poisson,
        Self::Calibrated,
    ];

    /// As the command line writes it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Mean => "mean",
            Self::Latest => "latest",
            Self::Persistence => "persistence",
            Self::Histogram => "histogram",
            Self::Spectral => "spectral",
            Self::Uniform => "uniform",
            Self::Pergam => "pergam",
            Self::HypertimeEm => "hypertime-em",
            Self::HypertimeKm => "hypertime-km",
            Self::Poisson => "poisson",
            Self::Calibrated => "calibrated",
        }
    }

    /// Whether an order can be given with it.
    #[must_use]
    pub fn has_order(self) -> bool {
        matches!(self, Self::Auto | Self::Spectral | Self::Uniform)
    }

    /// Whether cells of a grid have it too.
    #[must_use]
    pub fn is_for_cells(self) -> bool {
        matches!(self, Self::Auto | Self::Mean | Self::Latest | Self::Spectral)
    }

    /// Whether a parameter can be given with it.
    #[must_use]
    pub fn has_parameter(self) -> bool {
        matches!(self, Self::Histogram | Self::Pergam | Self::HypertimeEm | Self::HypertimeKm)
    }
}

/// What repeats in a histogram.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Cycle {
    /// The day.
    #[default]
    Day,
    /// The week, from Monday on.
    Week,
    /// The day, Saturdays and Sundays apart.
    Weekend,
}

impl Cycle {
    const ALL: [Self; 3] = [Self::Day, Self::Week, Self::Weekend];

    fn name(self) -> &'static str {
        match self {
            Self::Day => "day",
            Self::Week => "week",
            Self::Weekend => "weekend",
        }
    }
}

/// A model, with its parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ModelSelector {
    /// The kind.
    pub kind: ModelKind,
    /// Number of spectral components; what the last update chose where absent.
    pub order: Option<u32>,
    /// Blends the last value in.
    pub persistence: bool,
    /// Bins of a histogram, Gaussians or clusters of a mixture; the daemon's default where absent.
    pub parameter: Option<u32>,
    /// What repeats in a histogram.
    pub cycle: Cycle,
    /// The period of a periodic mixture, in nanoseconds; absent for a day.
    pub period_nanos: Option<i64>,
}

/// Why a text does not name a model.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InvalidModel {
    /// No such kind.
    #[error(
        "{0:?} is not a model: use auto, mean, latest, persistence, histogram, spectral, uniform, pergam, \
         hypertime-em, hypertime-km, poisson or calibrated, each optionally with +persistence"
    )]
    Unknown(String),
    /// A parameter where there is none.
    #[error("model {0:?} takes no parameter after a colon")]
    Parameter(String),
    /// A parameter that is no number.
    #[error("{0:?}: the parameter has to be a number above 0, as in histogram:24, histogram:week:168 or pergam:3")]
    NotANumber(String),
    /// A parameter that is too large.
    #[error("{text:?}: {kind} takes at most {max} {what}", kind = kind.name())]
    TooFine {
        /// What was given.
        text: String,
        /// The kind of model.
        kind: ModelKind,
        /// The greatest parameter.
        max: u32,
        /// What it counts.
        what: &'static str,
    },
    /// A period of a model that has none.
    #[error("{0:?}: only pergam takes a period, as in pergam:3:7d")]
    NoPeriod(String),
    /// A period that is no duration.
    #[error("{text:?}: the period of pergam comes after the Gaussians, as in pergam:3:7d: {reason}")]
    NotAPeriod {
        /// What was given.
        text: String,
        /// What is wrong with it.
        reason: InvalidDuration,
    },
    /// A period that is too short or too long.
    #[error("{0:?}: the period of pergam has to be from 1m to 366d")]
    PeriodRange(String),
    /// A suffix that is not `+persistence`.
    #[error("{0:?}: the only suffix is +persistence")]
    Suffix(String),
}

impl FromStr for ModelSelector {
    type Err = InvalidModel;

    fn from_str(text: &str) -> Result<Self, InvalidModel> {
        let (model, persistence) = match text.split_once('+') {
            Some((model, "persistence")) => (model, true),
            Some(_) => return Err(InvalidModel::Suffix(text.to_owned())),
            None => (text, false),
        };
        let mut parts = model.split(':').peekable();
        let name = parts.next().unwrap_or_default();
        let kind = ModelKind::ALL.into_iter().find(|kind| kind.name() == name);
        let kind = kind.ok_or_else(|| InvalidModel::Unknown(text.to_owned()))?;
        if parts.peek().is_some() && !kind.has_parameter() {
            return Err(InvalidModel::Parameter(name.to_owned()));
        }
        let cycle = Cycle::ALL.into_iter().filter(|_| kind == ModelKind::Histogram);
        let cycle = cycle.into_iter().find(|cycle| parts.peek() == Some(&cycle.name()));
        if cycle.is_some() {
            parts.next();
        }
        let number = |part: &str| part.parse().ok().filter(|&number: &u32| number > 0);
        let wrong = || InvalidModel::NotANumber(text.to_owned());
        let parameter = parts.next().map(|part| number(part).ok_or_else(wrong)).transpose()?;
        let period_nanos = parts.next().map(|part| period(text, kind, part)).transpose()?.flatten();
        if parts.next().is_some() {
            return Err(wrong());
        }
        let cycle = cycle.unwrap_or_default();
        let (max, what) = finest(kind, cycle);
        if parameter.is_some_and(|parameter| parameter > max) {
            return Err(InvalidModel::TooFine { text: text.to_owned(), kind, max, what });
        }
        Ok(Self { kind, order: None, persistence, parameter, cycle, period_nanos })
    }
}

/// The period in nanoseconds that a part says; `None` for a day, which need not be said.
fn period(text: &str, kind: ModelKind, part: &str) -> Result<Option<i64>, InvalidModel> {
    let found = parse_duration(part);
    match (kind, found) {
        (ModelKind::Pergam, Ok(nanos)) if (MINUTE_NANOS..=366 * DAY_NANOS).contains(&nanos) => {
            Ok(Some(nanos).filter(|&nanos| nanos != DAY_NANOS))
        }
        (ModelKind::Pergam, Ok(_)) => Err(InvalidModel::PeriodRange(text.to_owned())),
        (ModelKind::Pergam, Err(reason)) => Err(InvalidModel::NotAPeriod { text: text.to_owned(), reason }),
        (_, Ok(_)) => Err(InvalidModel::NoPeriod(text.to_owned())),
        (_, Err(_)) => Err(InvalidModel::NotANumber(text.to_owned())),
    }
}

/// The greatest parameter of a kind, and what it counts.
fn finest(kind: ModelKind, cycle: Cycle) -> (u32, &'static str) {
    match (kind, cycle) {
        (ModelKind::Histogram, Cycle::Day | Cycle::Weekend) => (1440, "bins a day"),
        (ModelKind::Histogram, Cycle::Week) => (10_080, "bins a week"),
        (ModelKind::Pergam, _) => (20, "Gaussians"),
        (ModelKind::HypertimeEm | ModelKind::HypertimeKm, _) => (50, "clusters"),
        _ => (0, "parameters"),
    }
}

impl fmt::Display for ModelSelector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.kind.name())?;
        if self.cycle != Cycle::Day {
            write!(f, ":{}", self.cycle.name())?;
        }
        if let Some(parameter) = self.parameter {
            write!(f, ":{parameter}")?;
        }
        if let Some(period_nanos) = self.period_nanos {
            write!(f, ":{}", format_duration(period_nanos))?;
        }
        if self.persistence { f.write_str("+persistence") } else { Ok(()) }
    }
}

impl ModelSelector {
    pub(crate) fn to_wire(self) -> v1::ModelSelector {
        let kind = match self.kind {
            ModelKind::Auto => v1::ModelKind::Auto,
            ModelKind::Mean => v1::ModelKind::Mean,
            ModelKind::Latest => v1::ModelKind::Latest,
            ModelKind::Persistence => v1::ModelKind::Persistence,
            ModelKind::Histogram => v1::ModelKind::Histogram,
            ModelKind::Spectral => v1::ModelKind::Spectral,
            ModelKind::Pergam => v1::ModelKind::Pergam,
            ModelKind::HypertimeEm => v1::ModelKind::HypertimeEm,
            ModelKind::HypertimeKm => v1::ModelKind::HypertimeKm,
            ModelKind::Poisson => v1::ModelKind::Poisson,
            ModelKind::Calibrated => v1::ModelKind::Calibrated,
            ModelKind::Uniform => v1::ModelKind::Uniform,
        };
        let cycle = match (self.kind, self.cycle) {
            (ModelKind::Histogram, Cycle::Day) => v1::HistogramCycle::Day,
            (ModelKind::Histogram, Cycle::Week) => v1::HistogramCycle::Week,
            (ModelKind::Histogram, Cycle::Weekend) => v1::HistogramCycle::WeekdayWeekend,
            _ => v1::HistogramCycle::Unspecified,
        };
        v1::ModelSelector {
            kind: kind.into(),
            order: self.order,
            persistence: self.persistence,
            parameter: self.parameter,
            cycle: cycle.into(),
            period: self.period_nanos.map(duration),
        }
    }

    pub(super) fn from_wire(model: v1::ModelSelector) -> Self {
        let kind = match model.kind() {
            v1::ModelKind::Mean => ModelKind::Mean,
            v1::ModelKind::Latest => ModelKind::Latest,
            v1::ModelKind::Persistence => ModelKind::Persistence,
            v1::ModelKind::Histogram => ModelKind::Histogram,
            v1::ModelKind::Spectral => ModelKind::Spectral,
            v1::ModelKind::Pergam => ModelKind::Pergam,
            v1::ModelKind::HypertimeEm => ModelKind::HypertimeEm,
            v1::ModelKind::HypertimeKm => ModelKind::HypertimeKm,
            v1::ModelKind::Poisson => ModelKind::Poisson,
            v1::ModelKind::Calibrated => ModelKind::Calibrated,
            v1::ModelKind::Uniform => ModelKind::Uniform,
            v1::ModelKind::Auto | v1::ModelKind::Unspecified => ModelKind::Auto,
        };
        let cycle = match model.cycle() {
            v1::HistogramCycle::Week => Cycle::Week,
            v1::HistogramCycle::WeekdayWeekend => Cycle::Weekend,
            v1::HistogramCycle::Day | v1::HistogramCycle::Unspecified => Cycle::Day,
        };
        Self {
            kind,
            order: model.order,
            persistence: model.persistence,
            parameter: model.parameter,
            cycle,
            period_nanos: span(model.period),
        }
    }
}

#[cfg(test)]
mod tests;
