//! A replica of a map: what it tells the thread that holds the map, and what it says of itself.
//!
//! Invariant: events are told in the order of the shared log, each once, and only when they are in it for good and in
//! this daemon's own log. The thread of the map applies nothing else.

use std::{fmt, sync::Arc, time::Duration};

use tidemap_map::event::Event;
use tidemap_store::GroupLog;
use tokio::{
    sync::{mpsc, oneshot, watch},
    time::Instant,
};

use crate::{
    engine::Engine,
    shared_log::{Shared, SharedLog},
};

mod compare;
mod driver;
mod lease_keeper;
mod send;
mod take_over;
mod write;

use driver::Driver;

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

/// What a replica needs to know.
#[derive(Clone, Debug)]
pub struct ReplicaSettings {
    /// Number of the map in the cluster.
    pub map: u64,
    /// The stream of the map.
    pub stream: String,
    /// Name of this daemon.
    pub member: String,
    /// Version of this daemon.
    pub version: String,
    /// Number of the maths of its updates.
    pub maths: u32,
    /// How long a lease lasts without renewal.
    pub lease: Duration,
    /// How long a new writer waits for a daemon that says that its log is longer.
    pub heal_wait: Duration,
    /// Bytes of a group.
    pub group_bytes: usize,
    /// How long one append may take before it is sent again.
    pub patience: Duration,
    /// Whether the disk is worked on by the thread of the replica itself, for a simulation.
    pub disk_inline: bool,
    /// A defect that a test must catch.
    #[cfg(test)]
    pub planted: Planted,
}

/// Defects that tests must catch.
#[cfg(test)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Planted {
    /// None.
    #[default]
    Nothing,
    /// A group is acknowledged that is not durable on the writer's own disk.
    AckBeforeSync,
    /// A writer begins without the record of its epoch.
    NoEpoch,
}

impl ReplicaSettings {
    /// The key of the map in the buckets.
    #[must_use]
    pub fn key(&self) -> String {
        format!("{:016x}", self.map)
    }
}

/// What is asked of a replica.
enum Order {
    /// To give the log to another daemon, if it writes it.
    HandOver(Option<String>, oneshot::Sender<bool>),
    /// To end, in order.
    Stop,
}

/// The handle of a replica. Dropped, the replica stops.
pub struct ReplicaHandle {
    orders: mpsc::UnboundedSender<Order>,
    stop: watch::Sender<bool>,
    candidacy: watch::Sender<Option<u32>>,
}

impl ReplicaHandle {
    /// From now on the replica may become the writer after so many others; `None`: it may not.
    pub fn set_candidacy(&self, rank: Option<u32>) {
        self.candidacy.send_if_modified(|known| std::mem::replace(known, rank) != rank);
    }

    /// Gives the log to another daemon, or to any; gives whether this replica was the writer.
    pub async fn hand_over(&self, successor: Option<String>) -> bool {
        let (done, answer) = oneshot::channel();
        self.orders.send(Order::HandOver(successor, done)).is_ok() && answer.await.unwrap_or(false)
    }

    /// Ends the replica; [`Replica::run`] returns when everything in flight is answered.
    pub fn stop(&self) {
        self.stop.send_replace(true);
        let _ = self.orders.send(Order::Stop);
    }
}

impl Drop for ReplicaHandle {
    fn drop(&mut self) {
        self.stop();
    }
}

/// A replica that is to be run.
pub struct Replica<E: Engine>(Driver<E>);

impl<E: Engine> Replica<E> {
    /// A replica of the map with this log, and the shared log that its thread appends to.
    pub fn new(
        engine: E,
        settings: ReplicaSettings,
        log: GroupLog,
        listener: ReplicaListener,
    ) -> (Replica<E>, ReplicaHandle, SharedLog) {
        let shared = Arc::new(Shared::new(log));
        let (orders, inbox) = mpsc::unbounded_channel();
        let (stop, stopping) = watch::channel(false);
        let (candidacy, rank) = watch::channel(None);
        let driver = Driver::new(engine, settings, Arc::clone(&shared), listener, inbox, stopping, rank);
        (Replica(driver), ReplicaHandle { orders, stop, candidacy }, SharedLog { shared })
    }

    /// Runs the replica until it is stopped or its log has forked.
    pub async fn run(self) {
        self.0.run().await;
    }
}

#[cfg(test)]
mod tests;
