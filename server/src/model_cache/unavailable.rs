//! Why a model cannot answer for a state.
//!
//! Invariant: the reason names the setting or the command that would change it, if there is one.

use tidemap_map::event::StateKind;
use tidemap_model::models::CannotTrain;

/// Why a model cannot answer for a state.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum ModelUnavailable {
    #[error("it must be trained on observations, and the map, created with {option} none, keeps none")]
    NotKept { option: &'static str },
    #[error(
        "it must be trained on observations, and the map no longer keeps those of this state: see --retention and --grid-retention"
    )]
    Forgotten,
    #[error("it would be trained on {got} observations or more, and setting max_training_readings allows {max}")]
    TooMany { got: u64, max: u64 },
    #[error("it is a model of {expected}, and the state is a {found}", found = .found.name())]
    OtherKind { expected: &'static str, found: StateKind },
    #[error("no update has learned any observation of it yet: see tidemap update")]
    Unlearned,
    #[error("it was never observed at the same time as a position of that vector: send both with equal times")]
    NoPlaces,
    #[error("{0}")]
    CannotTrain(#[from] CannotTrain),
}
