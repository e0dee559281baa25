//! The events that a replica sends to the thread that holds the map, and the status that it reports.
//!
//! Invariant: events are sent in the order of the shared log, each once, and only when they are in it for good and in
//! this daemon's own log. The thread of the map applies nothing else.

use std::{fmt, sync::Arc};

use tidemap_map::event::Event;
use tokio::{sync::oneshot, time::Instant};

/// An event that a replica sends to the thread of its map.
#[derive(Debug)]
pub enum ReplicaEvent {
    /// Events that this daemon did not append itself: position and event, in log order. The next ones come when
    /// `applied` is dropped or used, so that a replica that catches up does not fill the memory.
    Followed {
        /// The events.
        events: Vec<(u64, Event)>,
        /// Send on this channel when the events are applied.
        applied: oneshot::Sender<()>,
    },
    /// This daemon writes the log from now on. All events in the log before this have been sent.
    Writing {
        /// The epoch, which the log records.
        epoch: u64,
    },
    /// This daemon does not write the log, or no longer writes it. Appends in flight have been completed.
    Following {
        /// The daemon that writes the log, where it is known.
        writer: Option<String>,
    },
    /// This daemon's own log holds records behind this position that the shared log does not have. They have been
    /// applied, so the map has to be opened again without them.
    Forked {
        /// The last position that both logs have.
        common: u64,
    },
}

/// Receives the events of a replica. It must return quickly: it passes the event to the thread of the map.
pub type ReplicaListener = Arc<dyn Fn(ReplicaEvent) + Send + Sync>;

/// The role of a replica.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReplicaRole {
    /// The replica compares its log with the shared one.
    #[default]
    Starting,
    /// The replica reads the log.
    Following,
    /// The replica becomes the writer.
    TakingOver,
    /// The replica writes the log.
    Writing,
    /// The own log goes beyond the shared one, which has forgotten records: the replica waits to append them again.
    Ahead,
    /// The own log and the shared one differ.
    Forked,
}

/// The status of a replica.
#[derive(Clone, Debug, Default)]
pub struct ReplicaStatus {
    /// Role of the replica.
    pub role: ReplicaRole,
    /// The writer, as far as it is known.
    pub writer: Option<String>,
    /// The epoch of the last record of the own log.
    pub epoch: u64,
    /// Position of the last record of the own log.
    pub position: u64,
    /// Position of the last record of the shared log, as it was last received.
    pub shared_position: u64,
    /// The last time at which the end of the shared log was received.
    pub last_contact: Option<Instant>,
    /// The current fault, if there is one.
    pub trouble: Option<String>,
    /// Whether the shared log begins behind the end of the own one, so that the map needs a copy of another daemon's
    /// map.
    pub needs_copy: bool,
}

impl fmt::Display for ReplicaRole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            ReplicaRole::Starting => "starting",
            ReplicaRole::Following => "following",
            ReplicaRole::TakingOver => "taking over",
            ReplicaRole::Writing => "writing",
            ReplicaRole::Ahead => "ahead",
            ReplicaRole::Forked => "forked",
        })
    }
}
