//! Models by name, as the command line writes them: `histogram:week:168`, `pergam:3:7d`, `auto+persistence`.
//!
//! Invariant: a name reads back as the model that it was written from.

use std::str::FromStr;

use super::{ModelKind, ModelSelector, PERGAM_PERIOD_NANOS, PERGAM_PERIODS};
use crate::{
    models::HistogramCycle,
    time::{InvalidDuration, parse_duration},
};

/// Greatest number of Gaussians of a periodic mixture.
pub const GAUSSIANS_MAX: u32 = 20;
/// Greatest number of clusters of a warped hypertime.
pub const CLUSTERS_MAX: u32 = 50;
/// Default number of Gaussians, and of clusters.
const COMPONENTS: u32 = 3;

impl ModelKind {
    /// Every kind, with its default parameters.
    pub const ALL: [Self; 12] = [
        Self::Auto,
        Self::Mean,
        Self::Latest,
        Self::Persistence,
        Self::Histogram { cycle: HistogramCycle::Day, bins: 24 },
        Self::Spectral,
        Self::Uniform,
        Self::Pergam { gaussians: COMPONENTS, period_nanos: PERGAM_PERIOD_NANOS },
        Self::HypertimeEm { clusters: COMPONENTS },
        Self::HypertimeKm { clusters: COMPONENTS },
        Self::Poisson,
        Self::Calibrated,
    ];

    /// The name without parameters.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Mean => "mean",
            Self::Latest => "latest",
            Self::Persistence => "persistence",
            Self::Histogram { .. } => "histogram",
            Self::Spectral => "spectral",
            Self::Uniform => "uniform",
            Self::Pergam { .. } => "pergam",
            Self::HypertimeEm { .. } => "hypertime-em",
            Self::HypertimeKm { .. } => "hypertime-km",
            Self::Poisson => "poisson",
            Self::Calibrated => "calibrated",
        }
    }

    /// The number of bins, Gaussians or clusters, its maximum, and what it counts; `None` for a kind without parameter.
    fn parameter_mut(&mut self) -> Option<(&mut u32, u32, &'static str)> {
        match self {
            Self::Histogram { cycle, bins } => {
                let what = if *cycle == HistogramCycle::Week { "bins a week" } else { "bins a day" };
                Some((bins, u32::try_from(cycle.max_bins()).unwrap_or(u32::MAX), what))
            }
            Self::Pergam { gaussians, .. } => Some((gaussians, GAUSSIANS_MAX, "Gaussians")),
            Self::HypertimeEm { clusters } | Self::HypertimeKm { clusters } => {
                Some((clusters, CLUSTERS_MAX, "clusters"))
            }
            _ => None,
        }
    }
}

/// Why a text does not name a model.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum InvalidModel {
    #[error(
        "{0:?} is not a model: use auto, mean, latest, persistence, histogram, spectral, uniform, pergam, \
         hypertime-em, hypertime-km, poisson or calibrated, each optionally with +persistence or +memory"
    )]
    Unknown(String),
    #[error("model {0:?} takes no parameter after a colon")]
    Parameter(String),
    #[error("{0:?}: the parameter has to be a number above 0, as in histogram:24, histogram:week:168 or pergam:3")]
    NotANumber(String),
    #[error("{text:?}: {kind} takes at most {max} {what}")]
    TooFine { text: String, kind: &'static str, max: u32, what: &'static str },
    #[error("{0:?}: only pergam takes a period, as in pergam:3:7d")]
    NoPeriod(String),
    #[error("{text:?}: the period of pergam comes after the Gaussians, as in pergam:3:7d: {reason}")]
    NotAPeriod { text: String, reason: InvalidDuration },
    #[error("{0:?}: the period of pergam has to be from 1m to 366d")]
    PeriodRange(String),
    #[error("{0:?}: the only suffixes are +persistence and +memory")]
    Suffix(String),
}

impl FromStr for ModelSelector {
    type Err = InvalidModel;

    fn from_str(text: &str) -> Result<Self, InvalidModel> {
        let (model, [persistence, memory]) = match text.split_once('+') {
            Some((model, "persistence")) => (model, [true, false]),
            Some((model, "memory")) => (model, [false, true]),
            Some(_) => return Err(InvalidModel::Suffix(text.to_owned())),
            None => (text, [false, false]),
        };
        let mut parts = model.split(':').peekable();
        let name = parts.next().unwrap_or_default();
        let kind = ModelKind::ALL.into_iter().find(|kind| kind.name() == name);
        let mut kind = kind.ok_or_else(|| InvalidModel::Unknown(text.to_owned()))?;
        if let ModelKind::Histogram { cycle, bins } = &mut kind {
            let named = [("day", HistogramCycle::Day, 24), ("week", HistogramCycle::Week, 168)];
            let named = named.into_iter().chain([("weekend", HistogramCycle::WeekdayWeekend, 24)]);
            if let Some((_, found, usual)) = named.into_iter().find(|(name, ..)| parts.peek() == Some(name)) {
                (*cycle, *bins) = (found, usual);
                parts.next();
            }
        }
        let wrong = || InvalidModel::NotANumber(text.to_owned());
        if let Some(part) = parts.next() {
            let Some((parameter, max, what)) = kind.parameter_mut() else {
                return Err(InvalidModel::Parameter(name.to_owned()));
            };
            *parameter = part.parse().ok().filter(|&number: &u32| number > 0).ok_or_else(wrong)?;
            let is_too_fine = *parameter > max;
            if let Some(part) = parts.next() {
                set_period(text, &mut kind, part)?;
            }
            if parts.next().is_some() {
                return Err(wrong());
            }
            if is_too_fine {
                return Err(InvalidModel::TooFine { text: text.to_owned(), kind: kind.name(), max, what });
            }
        }
        Ok(Self { kind, order: None, persistence, memory })
    }
}

/// Sets the period of a periodic mixture.
fn set_period(text: &str, kind: &mut ModelKind, part: &str) -> Result<(), InvalidModel> {
    match (kind, parse_duration(part)) {
        (ModelKind::Pergam { period_nanos, .. }, Ok(nanos)) if PERGAM_PERIODS.contains(&nanos) => {
            *period_nanos = nanos;
            Ok(())
        }
        (ModelKind::Pergam { .. }, Ok(_)) => Err(InvalidModel::PeriodRange(text.to_owned())),
        (ModelKind::Pergam { .. }, Err(reason)) => Err(InvalidModel::NotAPeriod { text: text.to_owned(), reason }),
        (_, Ok(_)) => Err(InvalidModel::NoPeriod(text.to_owned())),
        (_, Err(_)) => Err(InvalidModel::NotANumber(text.to_owned())),
    }
}

#[cfg(test)]
mod tests;
