//! The report that a daemon publishes for the others: its address, its version, and the ends of its own logs.
//!
//! Invariant: a report may be old. No decision depends on it alone.

use std::collections::BTreeMap;

use bytes::Bytes;
use serde::{Deserialize, Serialize};

/// A report of a daemon.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MemberReport {
    /// The address at which the other daemons and clients reach the daemon.
    #[serde(default)]
    pub address: String,
    /// Version of the daemon.
    #[serde(default)]
    pub version: String,
    /// Version number of the disk format of the daemon.
    #[serde(default)]
    pub format: u32,
    /// Version number of the maths of the daemon's updates.
    #[serde(default)]
    pub maths: u32,
    /// Capacity of the daemon: its number of maps is proportional to it.
    #[serde(default)]
    pub capacity: u32,
    /// A number that the daemon draws anew at each start.
    #[serde(default)]
    pub boot: u64,
    /// Number of reports since the start of the daemon.
    #[serde(default)]
    pub counter: u64,
    /// Whether the daemon is draining: it hands over its maps and takes no new ones.
    #[serde(default)]
    pub draining: bool,
    /// By the number of the map in the cluster: the position up to which the daemon's own log is durable.
    #[serde(default)]
    pub logs: BTreeMap<u64, u64>,
    /// By the number of the map in the cluster: the position that the daemon's newest checkpoint covers.
    #[serde(default)]
    pub covers: BTreeMap<u64, u64>,
}

impl MemberReport {
    /// Encodes the report as the value of a key.
    #[must_use]
    pub fn encode(&self) -> Bytes {
        serde_json::to_vec(self).unwrap_or_default().into()
    }

    /// Decodes the value of a key; `None` for a value that cannot be read.
    #[must_use]
    pub fn decode(value: &[u8]) -> Option<MemberReport> {
        serde_json::from_slice(value).ok()
    }
}
