//! The requests for observations that are not in the store's history yet.
//!
//! Invariant: a reply is bounded by its request.

use std::sync::Arc;

use tidemap_map::{
    history::{HistoryPiece, Reading, Subject},
    ids::StateId,
};
use tokio::sync::oneshot;

/// A request for observations that are not in the store's history yet.
#[derive(Debug)]
pub struct ReadHistory {
    /// The state or cell.
    pub subject: Subject,
    /// First instant, nanoseconds UTC.
    pub from_nanos: i64,
    /// End of the interval, after the last instant, nanoseconds UTC.
    pub to_nanos: i64,
    /// Maximum number of pending observations to return.
    pub at_most: usize,
    /// The reply; it waits while an update has observations of that time.
    pub reply: oneshot::Sender<HistoryTail>,
}

/// The observations that are not in the store's history yet.
#[derive(Debug)]
pub struct HistoryTail {
    /// The observations that no update has learned.
    pub pending: Vec<Reading>,
    /// The observations that updates have learned and no save has stored.
    pub unsaved: Vec<Arc<HistoryPiece>>,
    /// Generations before this one are in the store's history.
    pub stored_before: u64,
    /// Greatest time of any observation, nanoseconds UTC.
    pub newest_nanos: i64,
}

/// A request for an extract of the data that the next update could learn.
#[derive(Debug)]
pub struct ReadPending {
    /// Maximum number of states. The states with the largest numbers of pending observations are selected.
    pub states_max: usize,
    /// Maximum number of observations of each state.
    pub readings_max: usize,
    /// The reply.
    pub reply: oneshot::Sender<PendingExtract>,
}

/// An extract of the data that the next update could learn.
#[derive(Debug)]
pub struct PendingExtract {
    /// Number of the generation: the updates published before.
    pub generation: u64,
    /// The readings by state, ascending.
    pub states: Vec<(StateId, Vec<Reading>)>,
}
