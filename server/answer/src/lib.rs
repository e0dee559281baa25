//! Answers of a map that need more than its view: models that are trained on request, evaluations of models, and states
//! and cells as one.
//!
//! Invariant: no I/O, no clock. An answer depends on a view and on the readings that it is given.

mod evaluation;
mod flows;
mod places;
mod positions;
mod state_or_cell;
mod trained;
mod unavailable;

pub use evaluation::{AnswerSource, Compared, Evaluator, OtherPart};
pub use flows::{FlowRequest, train_flow};
pub use places::PlaceModel;
pub use positions::PositionModel;
pub use state_or_cell::{KnownCell, StateOrCell};
pub use trained::CachedModel;
pub use unavailable::{ModelSubject, ModelUnavailable};
