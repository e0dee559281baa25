//! The questions for the observations that are not in the store's history yet.
//!
//! Invariant: an answer is bounded by what was asked for.

use std::sync::Arc;

use tidemap_map::{
    history::{HistoryPiece, Reading, Subject},
    ids::StateId,
};
use tokio::sync::oneshot;

/// A request for what was observed and is not in the store's history yet.
#[derive(Debug)]
pub(crate) struct ReadHistory {
    /// The state or cell.
    pub subject: Subject,
    /// First instant, nanoseconds UTC.
    pub from_nanos: i64,
    /// Beyond the last instant.
    pub to_nanos: i64,
    /// Maximum number of pending observations to return.
    pub at_most: usize,
    /// The answer; it waits while an update has observations of that time.
    pub reply: oneshot::Sender<HistoryTail>,
}

/// The observations that are not in the store's history yet.
#[derive(Debug)]
pub(crate) struct HistoryTail {
    /// Those that no update has learned.
    pub pending: Vec<Reading>,
    /// Those that updates have learned and no save has stored.
    pub unsaved: Vec<Arc<HistoryPiece>>,
    /// Generations before this one are in the store's history.
    pub stored_before: u64,
    /// Greatest time of any observation, nanoseconds UTC.
    pub newest_nanos: i64,
}

/// A request for an extract of what the next update could learn.
#[derive(Debug)]
pub(crate) struct ReadPending {
    /// Maximum number of states: those with the largest numbers of pending observations.
    pub states_max: usize,
    /// Maximum number of observations of each.
    pub readings_max: usize,
    /// The answer.
    pub reply: oneshot::Sender<PendingExtract>,
}

/// Some of what the next update could learn.
#[derive(Debug)]
pub(crate) struct PendingExtract {
    /// Updates published before.
    pub generation: u64,
    /// By state, ascending.
    pub states: Vec<(StateId, Vec<Reading>)>,
}
