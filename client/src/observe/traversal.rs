//! Reports of traversals of edges.
//!
//! Invariant: what is sent, kept and summed up in the checksum is the same message.

use tidemap_map::traversal::kept_reason;
use tidemap_proto::{
    convert::traversals::{text_bytes, traversal_from_wire},
    v1,
};

use super::{Producer, ProducerError, STATE_NAME_BYTES_MAX};

/// Bytes that a traversal takes on the wire beside its texts, at most.
const TRAVERSAL_BYTES_EXTRA: usize = 64;

/// A robot travelled an edge of the map's topology, or tried to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Traversal {
    /// Name of the node where the edge begins.
    pub from: String,
    /// Name of the node where it ends.
    pub to: String,
    /// By which action it was travelled; empty: as usual.
    pub action: String,
    /// When the robot set out, nanoseconds UTC.
    pub start_nanos: i64,
    /// When it arrived or gave up, nanoseconds UTC.
    pub end_nanos: i64,
    /// Whether it arrived.
    pub success: bool,
    /// Why it did not, for people to read: what prints of the first 200 characters. May be empty.
    pub reason: String,
}

impl Traversal {
    /// The message that is sent of it. What the daemon would leave out of the reason is left out here.
    pub(super) fn to_wire(&self) -> v1::Traversal {
        let Self { from, to, action, start_nanos, end_nanos, success, reason } = self.clone();
        v1::Traversal { from, to, action, start_nanos, end_nanos, success, reason: kept_reason(&reason) }
    }

    /// What is wrong with it, as far as can be said without the map. The daemon refuses it, and says the same.
    #[must_use]
    pub fn wrong(&self) -> Option<String> {
        traversal_from_wire(&self.to_wire()).err().map(|(_, text)| text)
    }
}

/// Bytes that a traversal takes on the wire, at most.
pub(super) fn wire_bytes(traversal: &v1::Traversal) -> usize {
    TRAVERSAL_BYTES_EXTRA + text_bytes(traversal)
}

impl Producer {
    /// Gives a traversal its number and takes charge of it; waits while the window is full. It is durable once
    /// [`super::Progress::durable_sequence`] has reached the number.
    ///
    /// # Errors
    /// [`ProducerError`]; the traversal has then not been taken.
    pub async fn send_traversal(&mut self, traversal: &Traversal) -> Result<u64, ProducerError> {
        let Traversal { from, to, action, .. } = traversal;
        if let Some(long) = [from, to, action].into_iter().find(|name| name.len() > STATE_NAME_BYTES_MAX) {
            return Err(ProducerError::NameTooLong(long.len()));
        }
        let wire = traversal.to_wire();
        self.push(|window| window.push_traversal(wire)).await
    }
}
