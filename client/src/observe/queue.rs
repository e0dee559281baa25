//! The durable queue of a robot: observations wait in files until the daemon has acknowledged them.
//!
//! [`QueuedProducer`] is the handle for callers. Behind it: `folder` keeps the records on the disk, in files of
//! `segment`; `record` makes bytes of observations; `relation` knows which sequence number of the daemon a record has;
//! `sender` sends the records with a [`Producer`](super::Producer), in order.
//!
//! Invariant: an observation that was taken is sent exactly once, in order, also after the end of this program, of the
//! daemon or of the connection. After a power cut the observations since the last sync may be missing. If the queue is
//! full, observations are refused, and none that was taken is dropped.

mod error;
mod folder;
mod producer;
mod record;
mod relation;
mod segment;
mod sender;
mod state;

use std::{path::PathBuf, time::Duration};

pub use error::QueueError;
pub use producer::QueuedProducer;
pub use state::QueueState;

/// Folder and limits of a queue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct QueueOptions {
    /// The folder, created if it does not exist; one for each map, producer and label.
    pub folder: PathBuf,
    /// Maximum number of bytes of all observations in it; more are refused.
    pub bytes_max: u64,
    /// Interval at which written observations are forced to the disk: a power cut costs at most the newest ones.
    pub sync_every: Duration,
}

impl QueueOptions {
    /// Options with the usual limit (1 GiB) and interval (1 s).
    #[must_use]
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into(), bytes_max: 1 << 30, sync_every: Duration::from_secs(1) }
    }
}
