//! What a daemon says of itself to the others: its address, its version, and how far its own logs go.
//!
//! Invariant: it is a report, and may be old. Nothing is decided by it alone.

use std::collections::BTreeMap;

use bytes::Bytes;
use serde::{Deserialize, Serialize};

/// A report of a daemon.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MemberReport {
    /// Where the other daemons and clients reach it.
    #[serde(default)]
    pub address: String,
    /// Version of the daemon.
    #[serde(default)]
    pub version: String,
    /// The number of its disk format.
    #[serde(default)]
    pub format: u32,
    /// The number of its maths.
    #[serde(default)]
    pub maths: u32,
    /// Its share of maps is proportional to it.
    #[serde(default)]
    pub capacity: u32,
    /// Made anew at each start.
    #[serde(default)]
    pub boot: u64,
    /// Counts its reports since its start.
    #[serde(default)]
    pub counter: u64,
    /// Whether it is draining: it hands over its maps and takes no new ones.
    #[serde(default)]
    pub draining: bool,
    /// By the number of the map in the cluster: the position up to which its own log is durable.
    #[serde(default)]
    pub logs: BTreeMap<u64, u64>,
    /// By the number of the map in the cluster: the position that its newest checkpoint covers.
    #[serde(default)]
    pub covers: BTreeMap<u64, u64>,
}

impl MemberReport {
    /// As a value of a key.
    #[must_use]
    pub fn encode(&self) -> Bytes {
        serde_json::to_vec(self).unwrap_or_default().into()
    }

    /// From the value of a key; `None` for a value that cannot be read.
    #[must_use]
    pub fn decode(value: &[u8]) -> Option<MemberReport> {
        serde_json::from_slice(value).ok()
    }
}
