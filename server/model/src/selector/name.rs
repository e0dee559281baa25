//! Models by name, as the command line writes them: `histogram:week:168`, `pergam:3:7d`, `auto+persistence`.
//!
//! Invariant: a name reads back as the model that it was written from.

use std::{fmt, str::FromStr};

use super::{Blend, ModelKind, ModelSelector};
use crate::{
    catalogue::listed,
    models::HistogramCycle,
    time::{InvalidDuration, parse_duration},
};

impl fmt::Display for ModelSelector {
    /// Writes the name of the command line; the order is not part of the name.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.kind, self.blend.suffix())
    }
}

/// The reason why a text does not name a model.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the error texts name the fields")]
pub enum InvalidModel {
    #[error(
        "{0:?} is not a model: use {names}, each optionally with +persistence or +memory",
        names = listed(ModelKind::ALL.map(ModelKind::name), "or")
    )]
    Unknown(String),
    #[error("model {0:?} takes no parameter after a colon")]
    Parameter(String),
    #[error("{0:?}: the parameter has to be a number above 0, as in histogram:24, histogram:week:168 or pergam:3")]
    NotANumber(String),
    #[error("{text:?}: {kind} takes at most {max} {what}")]
    TooFine { text: String, kind: &'static str, max: u32, what: String },
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
        let (model, blend) = match text.split_once('+') {
            Some((model, name)) => (model, Blend::named(name).ok_or_else(|| InvalidModel::Suffix(text.to_owned()))?),
            None => (text, Blend::None),
        };
        let mut parts = model.split(':').peekable();
        let name = parts.next().unwrap_or_default();
        let mut kind = ModelKind::named(name).ok_or_else(|| InvalidModel::Unknown(text.to_owned()))?;
        if kind.cycle().is_some()
            && let Some(cycle) = parts.peek().copied().and_then(HistogramCycle::named)
        {
            kind = kind.with_cycle(cycle);
            parts.next();
        }
        let wrong = || InvalidModel::NotANumber(text.to_owned());
        if let Some(part) = parts.next() {
            let limit = kind.count_limit().ok_or_else(|| InvalidModel::Parameter(name.to_owned()))?;
            let count = part.parse().ok().filter(|&number: &u32| number > 0).ok_or_else(wrong)?;
            kind = kind.with_count(count);
            if let Some(part) = parts.next() {
                kind = with_period(text, kind, part)?;
            }
            if parts.next().is_some() {
                return Err(wrong());
            }
            if count > limit.max {
                let what = format!("{}{}", limit.noun, limit.per);
                return Err(InvalidModel::TooFine { text: text.to_owned(), kind: kind.name(), max: limit.max, what });
            }
        }
        Ok(Self { kind, order: None, blend })
    }
}

/// The model with the period in a part of its name.
fn with_period(text: &str, kind: ModelKind, part: &str) -> Result<ModelKind, InvalidModel> {
    match (kind.period_nanos(), parse_duration(part)) {
        (Some(_), Ok(nanos)) if ModelKind::PERIODS_NANOS.contains(&nanos) => Ok(kind.with_period(nanos)),
        (Some(_), Ok(_)) => Err(InvalidModel::PeriodRange(text.to_owned())),
        (Some(_), Err(reason)) => Err(InvalidModel::NotAPeriod { text: text.to_owned(), reason }),
        (None, Ok(_)) => Err(InvalidModel::NoPeriod(text.to_owned())),
        (None, Err(_)) => Err(InvalidModel::NotANumber(text.to_owned())),
    }
}

#[cfg(test)]
mod tests;
