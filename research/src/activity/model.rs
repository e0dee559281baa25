//! The models that compete: none, one kind of the catalogue for every activity, or the model that a map chooses night
//! by night.
//!
//! Invariant: the name of a model reads back as the model.

use std::{fmt, str::FromStr};

use tidemap_model::{
    ORDER_MAX, StateKind,
    catalogue::ModelKind,
    selector::{Blend, ModelSelector},
};

/// The source of the temporal prior.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActivityModel {
    /// Nowhere: it is even at all times.
    Even,
    /// A kind of model, trained anew on all days each night; the number of components, if it is spectral.
    One(ModelKind, Option<usize>),
    /// A map of the activities with default properties, which chooses at each midnight.
    Auto,
}

/// The models that are compared by default.
pub const ACTIVITY_MODELS: [&str; 13] = [
    "even",
    "mean",
    "spectral:1",
    "spectral:2",
    "spectral:3",
    "spectral:5",
    "spectral:15",
    "pergam:2",
    "pergam:3",
    "histogram:24",
    "histogram:week:168",
    "calibrated",
    "auto",
];

impl fmt::Display for ActivityModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Even => f.write_str("even"),
            Self::Auto => f.write_str("auto"),
            Self::One(kind, None) => write!(f, "{kind}"),
            Self::One(kind, Some(order)) => write!(f, "{kind}:{order}"),
        }
    }
}

/// Why a text names no model of activities.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is no model of activities: use even, auto, spectral:N with N from 0 to 15, or {others}")]
pub struct WrongActivityModel {
    text: String,
    others: &'static str,
}

impl FromStr for ActivityModel {
    type Err = WrongActivityModel;

    fn from_str(text: &str) -> Result<Self, WrongActivityModel> {
        const OTHERS: &str = "mean, histogram:24, pergam:2, hypertime-em, hypertime-km, calibrated or ensemble";
        let wrong = || WrongActivityModel { text: text.to_owned(), others: OTHERS };
        if text == "even" {
            return Ok(Self::Even);
        }
        if let Some(order) = text.strip_prefix("spectral:") {
            let order = order.parse().ok().filter(|&order: &usize| order <= ORDER_MAX).ok_or_else(wrong)?;
            return Ok(Self::One(ModelKind::Spectral, Some(order)));
        }
        let ModelSelector { kind, blend, .. } = text.parse().map_err(|_| wrong())?;
        match kind {
            _ if blend != Blend::None || kind.takes_newest() || !kind.supports(StateKind::Probability) => Err(wrong()),
            // These kinds need an order.
            ModelKind::Spectral | ModelKind::Uniform => Err(wrong()),
            ModelKind::Auto => Ok(Self::Auto),
            kind => Ok(Self::One(kind, None)),
        }
    }
}
