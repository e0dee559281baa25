//! The destination of the acknowledgements of a session: the client of a stream at once, or the one reply of a request.
//!
//! Invariant: a refusal comes before or with the acknowledgement of its number.

use tidemap_ingest::protocol::RefusedObservation;
use tidemap_proto::v1::observe_response::Message as Down;

use super::channel::{Replies, reply};
use crate::{acks::acks, status::RpcError};

/// The destination of the acknowledgements of a session.
pub(super) enum Acknowledgements<'a> {
    /// The client of a stream.
    Stream(&'a Replies),
    /// The reply of a request, with the refused observations.
    Request(Vec<RefusedObservation>),
}

impl Acknowledgements<'_> {
    /// Adds an acknowledgement: all numbers after `before` up to `durable` are durable, at a log position.
    ///
    /// # Errors
    /// The client is gone, or does not read.
    pub(super) async fn add(
        &mut self,
        (before, durable): (u64, u64),
        refused: Vec<RefusedObservation>,
        position: u64,
    ) -> Result<(), RpcError> {
        match self {
            Self::Stream(replies) => {
                for ack in acks((before, durable), refused, position) {
                    reply(replies, Down::Ack(ack)).await?;
                }
            }
            Self::Request(all) => all.extend(refused),
        }
        Ok(())
    }

    /// Takes the refused observations of a request.
    pub(super) fn take_refused(&mut self) -> Vec<RefusedObservation> {
        match self {
            Self::Stream(_) => Vec::new(),
            Self::Request(refused) => std::mem::take(refused),
        }
    }
}
