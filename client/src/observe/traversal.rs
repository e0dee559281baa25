//! Reports of traversals of edges.
//!
//! Invariant: the message that is sent, kept and part of the checksum is the same.

use tidemap_map::traversal::kept_reason;
use tidemap_proto::{
    convert::traversals::{text_bytes, traversal_from_wire},
    v1,
};

/// Maximum number of bytes of a traversal in addition to its texts.
const TRAVERSAL_BYTES_EXTRA: usize = 64;

/// A report that a robot traversed an edge, or tried to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Traversal {
    /// Name of the node where the edge begins.
    pub from: String,
    /// Name of the node where it ends.
    pub to: String,
    /// The robot's action that traversed the edge; empty: the usual one.
    pub action: String,
    /// When the robot entered the edge, nanoseconds UTC.
    pub start_nanos: i64,
    /// When the robot arrived or gave up, nanoseconds UTC.
    pub end_nanos: i64,
    /// Whether the robot arrived.
    pub success: bool,
    /// Reason of the failure, in words: the printable part of the first 200 characters. May be empty.
    pub reason: String,
}

impl Traversal {
    /// The message of this traversal, with the reason as the daemon keeps it.
    pub(super) fn to_wire(&self) -> v1::Traversal {
        let Self { from, to, action, start_nanos, end_nanos, success, reason } = self.clone();
        v1::Traversal { from, to, action, start_nanos, end_nanos, success, reason: kept_reason(&reason) }
    }

    /// Why the traversal is invalid, as far as this is known without the map. The daemon refuses it for the same
    /// reason.
    #[must_use]
    pub fn wrong(&self) -> Option<String> {
        traversal_from_wire(&self.to_wire()).err().map(|(_, text)| text)
    }
}

/// Maximum number of bytes of a traversal.
pub(super) fn wire_bytes(traversal: &v1::Traversal) -> usize {
    TRAVERSAL_BYTES_EXTRA + text_bytes(traversal)
}
