//! Which model answers, as people name it.
//!
//! Invariant: a name reads back as what it was written from.

use std::{fmt, str::FromStr};

use tidemap_proto::v1;

/// Greatest order of the spectral model.
pub const ORDER_MAX: u32 = 15;

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
    /// FreMEn: the mean and the strongest spectral components.
    Spectral,
}

impl ModelKind {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Auto, Self::Mean, Self::Latest, Self::Spectral];

    /// As the command line writes it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Mean => "mean",
            Self::Latest => "latest",
            Self::Spectral => "spectral",
        }
    }

    /// Whether an order can be given with it.
    #[must_use]
    pub fn has_order(self) -> bool {
        matches!(self, Self::Auto | Self::Spectral)
    }
}

/// Kinds that are planned, so that asking for one of them is told from a slip of the pen.
const PLANNED: [&str; 7] =
    ["persistence", "histogram", "pergam", "hypertime-em", "hypertime-km", "poisson", "calibrated"];

/// A model, with its parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ModelSelector {
    /// The kind.
    pub kind: ModelKind,
    /// Number of spectral components; what the last update chose where absent.
    pub order: Option<u32>,
    /// Blends the last value in.
    pub persistence: bool,
}

/// Why a text does not name a model.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InvalidModel {
    /// No such kind.
    #[error("{0:?} is not a model: use auto, mean, latest or spectral, each optionally with +persistence")]
    Unknown(String),
    /// Not in this version.
    #[error(
        "model {0:?} is not in this version: use auto, mean, latest or spectral, each optionally with +persistence"
    )]
    Planned(String),
    /// A parameter where there is none.
    #[error("model {0:?} takes no parameter after a colon")]
    Parameter(String),
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
        let (name, parameter) = model.split_once(':').map_or((model, None), |(name, after)| (name, Some(after)));
        if PLANNED.contains(&name) {
            return Err(InvalidModel::Planned(name.to_owned()));
        }
        let kind = ModelKind::ALL.into_iter().find(|kind| kind.name() == name);
        let kind = kind.ok_or_else(|| InvalidModel::Unknown(text.to_owned()))?;
        if parameter.is_some() {
            return Err(InvalidModel::Parameter(name.to_owned()));
        }
        Ok(Self { kind, order: None, persistence })
    }
}

impl fmt::Display for ModelSelector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.kind.name())?;
        if self.persistence { f.write_str("+persistence") } else { Ok(()) }
    }
}

impl ModelSelector {
    pub(super) fn to_wire(self) -> v1::ModelSelector {
        let kind = match self.kind {
            ModelKind::Auto => v1::ModelKind::Auto,
            ModelKind::Mean => v1::ModelKind::Mean,
            ModelKind::Latest => v1::ModelKind::Latest,
            ModelKind::Spectral => v1::ModelKind::Spectral,
        };
        v1::ModelSelector { kind: kind.into(), order: self.order, persistence: self.persistence }
    }

    pub(super) fn from_wire(model: v1::ModelSelector) -> Self {
        let kind = match model.kind() {
            v1::ModelKind::Mean => ModelKind::Mean,
            v1::ModelKind::Latest => ModelKind::Latest,
            v1::ModelKind::Spectral => ModelKind::Spectral,
            v1::ModelKind::Auto | v1::ModelKind::Unspecified => ModelKind::Auto,
        };
        Self { kind, order: model.order, persistence: model.persistence }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_are_named_as_on_the_command_line() {
        for text in ["auto", "mean", "latest", "spectral", "spectral+persistence", "auto+persistence"] {
            assert_eq!(text.parse::<ModelSelector>().map(|model| model.to_string()), Ok(text.to_owned()));
        }
    }

    #[test]
    fn what_is_not_a_model_is_told_from_what_is_not_yet_one() {
        let parsed = |text: &str| text.parse::<ModelSelector>();
        assert_eq!(parsed("fremen"), Err(InvalidModel::Unknown("fremen".to_owned())));
        assert_eq!(parsed(""), Err(InvalidModel::Unknown(String::new())));
        assert_eq!(parsed("histogram:24"), Err(InvalidModel::Planned("histogram".to_owned())));
        assert_eq!(parsed("persistence"), Err(InvalidModel::Planned("persistence".to_owned())));
        assert_eq!(parsed("spectral:2"), Err(InvalidModel::Parameter("spectral".to_owned())));
        assert_eq!(parsed("mean+x"), Err(InvalidModel::Suffix("mean+x".to_owned())));
    }
}
