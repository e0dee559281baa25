//! Reports of traversals of edges.
//!
//! Invariant: the message that is sent, kept and part of the checksum is the same.

use tidemap_map::traversal::kept_reason;
use tidemap_proto::{
    convert::traversals::{text_bytes, traversal_from_wire},
    v1,
};

use super::{Producer, ProducerError, STATE_NAME_BYTES_MAX};

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

impl Producer {
    /// Accepts a traversal and returns its number; waits while the window is full. It is durable once
    /// [`super::Progress::durable_sequence`] has reached the number.
    ///
    /// # Errors
    /// [`ProducerError`]; the traversal is then not accepted.
    pub async fn send_traversal(&mut self, traversal: &Traversal) -> Result<u64, ProducerError> {
        let Traversal { from, to, action, .. } = traversal;
        if let Some(long) = [from, to, action].into_iter().find(|name| name.len() > STATE_NAME_BYTES_MAX) {
            return Err(ProducerError::NameTooLong(long.len()));
        }
        let wire = traversal.to_wire();
        self.push(|window| window.push_traversal(wire)).await
    }
}
