//! The reason why a model cannot predict a state.
//!
//! Invariant: the reason names the setting or the command that would change it, if there is one.

#![allow(missing_docs, reason = "the message of each variant explains it and its fields")]

use tidemap_map::{event::StateKind, view::MapView};
use tidemap_model::{models::CannotTrain, selector::ModelKind};

use crate::StateOrCell;

/// The subject of a model.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ModelSubject {
    /// A state or cell.
    #[error("model {model} of state {state:?}")]
    State { model: ModelKind, state: String },
    /// A flow of people.
    #[error("flow of {state:?} by {motion_state:?}")]
    Flow { state: String, motion_state: String },
}

/// The reason why a model cannot predict a state.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ModelUnavailable {
    #[error("it must be trained on observations, and the map, created with {option} \"none\", keeps none")]
    NotKept { option: &'static str },
    #[error("it must be trained on observations, and the map no longer keeps those of this state: see its retention")]
    Forgotten,
    #[error("it would be trained on {got} observations or more, and setting max_training_readings allows {max}")]
    TooMany { got: u64, max: u64 },
    #[error("it is a model of {expected}, and the state is a {found}", found = .found.name())]
    OtherKind { expected: &'static str, found: StateKind },
    #[error("only named states have it: use auto, mean, latest or spectral for a cell")]
    StatesOnly,
    #[error("no update has learned any observation of it yet: run an update")]
    Unlearned,
    #[error("it was never observed at the same time as a position of that vector: send both with equal times")]
    NoPlaces,
    #[error(
        "the raster has {bins} cells times directions, and at most {max} are possible: use larger cells, a smaller \
         region or fewer directions"
    )]
    RasterTooLarge { bins: f64, max: usize },
    #[error("nobody was detected in the region; {elsewhere} detections with a direction lie elsewhere")]
    NoneInRegion { elsewhere: usize },
    #[error("nobody moves: at the times of positions, all velocities are 0")]
    NobodyMoves,
    #[error("{0}")]
    CannotTrain(#[from] CannotTrain),
}

impl ModelUnavailable {
    /// Checks that the predicted state or cell, and its values, support a kind of model.
    ///
    /// # Errors
    /// The reason why they do not.
    pub fn check(target: &StateOrCell, view: &MapView, kind: ModelKind) -> Result<(), ModelUnavailable> {
        if matches!(target, StateOrCell::Cell(_)) && !kind.needs_readings() && !kind.is_for_cells() {
            return Err(ModelUnavailable::StatesOnly);
        }
        let (expected, found) = (kind.info().states.values(), target.kind(view));
        if kind.supports(found) { Ok(()) } else { Err(ModelUnavailable::OtherKind { expected, found }) }
    }
}
