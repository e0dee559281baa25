//! What a replica needs to know, and what is asked of it.
//!
//! Invariant: settings do not change while a replica runs.

use std::time::Duration;

use tokio::sync::oneshot;

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
    /// Servers of the engine that hold the stream, where it has to be made again.
    pub engine_replicas: usize,
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
pub(super) enum Order {
    /// To give the log to another daemon, if it writes it.
    HandOver(Option<String>, oneshot::Sender<bool>),
    /// To end, in order.
    Stop,
}
