//! What a replica tells the thread that holds the map, and what it says of itself.
//!
//! Invariant: events are told in the order of the shared log, each once, and only when they are in it for good and in
//! this daemon's own log. The thread of the map applies nothing else.

use std::{fmt, sync::Arc};

use tidemap_map::event::Event;
use tokio::{sync::oneshot, time::Instant};

/// What a replica tells the thread of its map.
#[derive(Debug)]
pub enum ReplicaEvent {
    /// Events that this daemon did not append itself: position and event, in their order. The next ones come when
    /// `applied` is dropped or used, so that a replica that catches up does not fill the memory.
    Followed {
        /// The events.
        events: Vec<(u64, Event)>,
        /// To be used when they are applied.
        applied: oneshot::Sender<()>,
    },
    /// This daemon writes the log from now on. Everything in the log before has been told.
    Writing {
        /// The epoch, which the log says.
        epoch: u64,
    },
    /// This daemon does not write the log, or no longer. Appends in flight have been answered.
    Following {
        /// The daemon that does, where it is known.
        writer: Option<String>,
    },
    /// This daemon's own log holds records behind this position that the shared log does not have. They have been
    /// applied, so the map has to be opened again without them.
    Forked {
        /// The last position that both have.
        common: u64,
    },
}

/// Hears what a replica tells. It must be quick: it hands the event to the thread of the map.
pub type ReplicaListener = Arc<dyn Fn(ReplicaEvent) + Send + Sync>;

/// What a replica does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReplicaRole {
    /// It compares its log with the shared one.
    #[default]
    Starting,
    /// It reads the log.
    Following,
    /// It becomes the writer.
    TakingOver,
    /// It writes the log.
    Writing,
    /// Its own log goes beyond the shared one, which has forgotten records: it waits to append them again.
    Ahead,
    /// Its own log and the shared one differ.
    Forked,
}

/// What a replica says of itself.
#[derive(Clone, Debug, Default)]
pub struct ReplicaStatus {
    /// What it does.
    pub role: ReplicaRole,
    /// The writer, as far as it is known.
    pub writer: Option<String>,
    /// The epoch of the last record of its own log.
    pub epoch: u64,
    /// Position of the last record of its own log.
    pub position: u64,
    /// Position of the last record of the shared log, as it was heard of last.
    pub shared_position: u64,
    /// When it last heard of the end of the shared log.
    pub heard: Option<Instant>,
    /// What is wrong, if something is.
    pub trouble: Option<String>,
    /// Whether the shared log begins behind the end of the own one, so that the map needs a copy of another daemon's.
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
