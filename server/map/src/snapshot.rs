//! A map after an update, for the store to save and restore.
//!
//! Invariant: a snapshot and the events after it determine the map. The snapshot contains the events at log positions
//! up to `position`, except observations that were still pending: these are at positions from `replay_from` on, with a
//! time not before `cut_nanos`.

use std::sync::Arc;

use tidemap_grid::{sensors::ProducerSensor, snapshot::GridSnapshot};
use tidemap_model::{Persistence, Recent, StateModel};

use crate::{
    event::StateKind,
    history::HistoryPiece,
    live_state::NewestRow,
    name::{ProducerKey, StateName},
    site::Site,
};

/// A whole map at one log position.
#[derive(Clone, Debug, PartialEq)]
pub struct MapSnapshot {
    /// Log position of the update's start; 0 where the log is empty.
    pub position: u64,
    /// Log position from which pending observations are read again; at most `position` + 1.
    pub replay_from: u64,
    /// Number of the generation.
    pub generation: u64,
    /// Cut of the last update, nanoseconds UTC.
    pub cut_nanos: i64,
    /// Latest time of the observations that did not have to wait, nanoseconds UTC; 0 without observations.
    pub newest_nanos: i64,
    /// Producers; the index is the `ProducerId`.
    pub producers: Vec<ProducerMark>,
    /// States; the index is the `StateId`.
    pub states: Vec<StateSnapshot>,
    /// The site: the data that people and robots give the map besides observations.
    pub site: Arc<Site>,
    /// The grid, where the map has one.
    pub grid: Option<GridSnapshot>,
    /// The history of updates up to this one that no save has kept yet, ascending by generation. It is not part of the
    /// map's state: a snapshot that is read back has none.
    pub history: Vec<Arc<HistoryPiece>>,
}

impl MapSnapshot {
    /// The part of the snapshot that the generation publishes: the snapshot without the sums, the pending scans and the
    /// history. A view of it gives the same answers as a view of the snapshot before anything is pending.
    #[must_use]
    pub fn published(&self) -> MapSnapshot {
        let state = |state: &StateSnapshot| StateSnapshot {
            name: state.name.clone(),
            model: Arc::new(state.model.published()),
            ..*state
        };
        MapSnapshot {
            producers: self.producers.clone(),
            states: self.states.iter().map(state).collect(),
            site: Arc::clone(&self.site),
            grid: self.grid.as_ref().map(GridSnapshot::published),
            history: Vec::new(),
            ..*self
        }
    }
}

/// Maximum number of [`ContentMark`]s of a producer that are kept, including the mark of its durable sequence.
pub const CONTENT_MARKS_MAX: usize = 8;

/// The running CRC-32C over a producer's observations up to one of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ContentMark {
    /// Sequence number of the last of the observations.
    pub sequence: u64,
    /// The CRC.
    pub crc: u32,
}

/// How far a producer's sequence is durable.
#[derive(Clone, Debug, PartialEq)]
pub struct ProducerMark {
    /// The producer's name and the label of its sequence.
    pub key: ProducerKey,
    /// Highest incarnation seen.
    pub incarnation: u64,
    /// Everything up to this sequence number is durable, or refused.
    pub durable_sequence: u64,
    /// Running CRC-32C over the observations 1..=`durable_sequence`.
    pub content_crc: u32,
    /// The sensor of all its scans; `None`: the map's own.
    pub sensor: Option<ProducerSensor>,
    /// The time at which the daemon received the newest of these observations, nanoseconds UTC.
    pub received_nanos: i64,
    /// Latest time of the producer's observations that did not have to wait, nanoseconds UTC; 0 in a map without states
    /// that report changes or events.
    pub newest_nanos: i64,
    /// The running CRC after each of the newest events, without the last event, ascending; fewer than
    /// [`CONTENT_MARKS_MAX`].
    pub recent: Vec<ContentMark>,
    /// Whether the producer has ever sent a scan.
    pub has_scans: bool,
    /// Whether the producer has given its place up, until it sends again. Its sequence continues at its old number.
    pub is_forgotten: bool,
    /// The client that introduced the producer, for the shares per client; empty: a client without a share.
    pub introduced_by: String,
}

impl ProducerMark {
    /// The CRCs that are known, ascending, including that of the durable sequence.
    #[must_use]
    pub fn content_marks(&self) -> Vec<ContentMark> {
        let newest = ContentMark { sequence: self.durable_sequence, crc: self.content_crc };
        self.recent.iter().copied().chain([newest]).collect()
    }
}

/// The data of one state in a snapshot.
#[derive(Clone, Debug, PartialEq)]
pub struct StateSnapshot {
    /// The name of the state, unique within the map.
    pub name: StateName,
    /// The kind of values that the state has.
    pub kind: StateKind,
    /// Observations acknowledged, pending ones included.
    pub observations: u64,
    /// Last value and persistence.
    pub persistence: Persistence,
    /// The recent readings.
    pub recent: Recent,
    /// The newest row, where rows are changes or events.
    pub newest_row: Option<NewestRow>,
    /// The model of the state, shared with the view that is in force.
    pub model: Arc<StateModel>,
}
