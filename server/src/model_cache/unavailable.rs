//! Why a model cannot answer for a state.
//!
//! Invariant: the reason names the setting or the command that would change it, if there is one.

use tidemap_map::event::StateKind;
use tidemap_model::models::CannotFit;

/// Why a model cannot answer for a state.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum ModelUnavailable {
    /// The map keeps nothing to fit it to.
    #[error("it has to be fitted to observations, and the map, created with --retention none, keeps none")]
    NotKept,
    /// What the state had is older than what the map keeps.
    #[error("it has to be fitted to observations, and the map keeps those of this state no more: see --retention")]
    Forgotten,
    /// The map was made by a version that kept nothing.
    #[error(
        "it has to be fitted to all {folded} observations that updates have folded in, and the map, which is older than \
         its history, keeps {kept} of them"
    )]
    Incomplete {
        /// Observations that updates have folded in.
        folded: u64,
        /// Those of them that are kept.
        kept: u64,
    },
    /// There are too many observations.
    #[error("it would be fitted to {got} observations or more, and setting max_fit_readings allows {max}")]
    TooMany {
        /// How many there are at least.
        got: u64,
        /// How many are allowed.
        max: u64,
    },
    /// The values of the state are not what such a model is of.
    #[error("it is a model of {expected}, and the state is a {found}", found = .found.name())]
    OtherKind {
        /// What it is a model of.
        expected: &'static str,
        /// What the state is.
        found: StateKind,
    },
    /// There is nothing to fit it to.
    #[error("no update has folded in any observation of it yet: see tidemap update")]
    Unlearned,
    /// The readings do not go with the model.
    #[error("{0}")]
    CannotFit(#[from] CannotFit),
}
