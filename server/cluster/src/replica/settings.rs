//! The settings of a replica, and the orders that it receives.
//!
//! Invariant: the settings do not change while a replica runs.

use std::time::Duration;

use tokio::sync::oneshot;

/// The settings of a replica.
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
    /// Version number of the maths of this daemon's updates.
    pub maths: u32,
    /// Number of servers of the engine that hold the stream, where it has to be created again.
    pub engine_replicas: usize,
    /// Duration of a lease without renewal.
    pub lease: Duration,
    /// Time for which a new writer waits for a daemon whose report shows a longer log.
    pub heal_wait: Duration,
    /// Limit of a group in bytes.
    pub group_bytes: usize,
    /// Time limit of one append before it is sent again.
    pub patience: Duration,
    /// Whether the thread of the replica does the disk work itself, for a simulation.
    pub disk_inline: bool,
    /// A defect that a test must catch.
    #[cfg(test)]
    pub planted: Planted,
}

/// Defects that tests must catch.
#[cfg(test)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Planted {
    /// No defect.
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

/// An order to a replica.
pub(super) enum Order {
    /// Hand the log over to another daemon, if this one writes it.
    HandOver(Option<String>, oneshot::Sender<bool>),
    /// End in order.
    Stop,
}
