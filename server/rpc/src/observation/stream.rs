//! An open stream: the messages of its client, and the replies.
//!
//! Invariant: while the map is saturated nothing is read, and the client receives a message about it.

use std::time::Duration;

use tidemap_ingest::{
    ending::{Ending, is_fatal},
    intake::IntakeError,
    probe::Probed,
};
use tidemap_model::time::FUTURE_MAX_NANOS;
use tidemap_proto::{
    convert::{
        observe::{StreamMessage, message_from_wire},
        time::duration,
    },
    v1::{self, observe_response::Message as Down},
};
use tokio_stream::StreamExt as _;

use super::{
    channel::{Replies, Requests, reply, unread},
    session::OpenSession,
};
use crate::status::RpcError;

/// After this time of waiting, the daemon sends a stream the message that the map is saturated.
const BUSY_AFTER: Duration = Duration::from_secs(1);

/// An open stream.
pub(super) struct Stream<'a> {
    session: OpenSession<'a>,
    replies: &'a Replies,
    probed: Probed,
}

impl<'a> Stream<'a> {
    /// The stream of a session.
    pub(super) fn new(session: OpenSession<'a>, replies: &'a Replies, probed: Probed) -> Self {
        Self { session, replies, probed }
    }

    fn welcome_to_wire(&self) -> v1::Welcome {
        let OpenSession { service, opened, handle, .. } = &self.session;
        let limits = service.limits;
        let direct = service.peers.as_ref().and_then(|peers| peers.address_of(peers.name()));
        v1::Welcome {
            store_id: service.catalog.context().identity().to_owned(),
            incarnation: opened.incarnation,
            durable_sequence: opened.durable_sequence,
            content_crc: opened.content_crc,
            max_batch_observations: u32::try_from(limits.intake.batch).unwrap_or(u32::MAX),
            max_batch_scans: u32::try_from(limits.intake.scans.batch_scans).unwrap_or(u32::MAX),
            max_scan_points: u32::try_from(limits.intake.scans.points).unwrap_or(u32::MAX),
            max_scan_tiles: u32::try_from(limits.intake.scans.tiles).unwrap_or(u32::MAX),
            max_message_bytes: u32::try_from(limits.max_message_bytes).unwrap_or(u32::MAX),
            max_ahead: Some(duration(FUTURE_MAX_NANOS)),
            direct: direct.unwrap_or_default(),
            map_uid: handle.shared_uid.unwrap_or_default(),
        }
    }

    /// Takes messages until the client ends the stream and all is acknowledged.
    ///
    /// # Errors
    /// The reason why the stream ends before.
    pub(super) async fn serve(&mut self, requests: &mut impl Requests) -> Result<(), RpcError> {
        reply(self.replies, Down::Welcome(self.welcome_to_wire())).await?;
        let mut saturated = self.session.handle.saturated();
        loop {
            let wait = *saturated.borrow_and_update();
            self.probed.pause(wait);
            tokio::select! {
                biased;
                event = self.session.event() => match event {
                    Ok(event) => self.session.pass_on(event).await?,
                    Err(ended) => {
                        self.drain().await?;
                        return Err(ended);
                    }
                },
                _ = saturated.changed(), if wait => {}
                () = tokio::time::sleep(BUSY_AFTER), if wait => {
                    let retry_after = Some(duration(1_000_000_000));
                    reply(self.replies, Down::Busy(v1::Busy { retry_after })).await?;
                }
                request = requests.next(), if !wait => match request {
                    Some(Ok(request)) => self.take(request).await?,
                    // The producer has sent everything: all batches in flight are acknowledged before the stream ends.
                    None => return self.drain().await,
                    Some(Err(status)) => return Err(unread(&status, &self.session.service.limits)),
                },
            }
        }
    }

    async fn take(&mut self, request: v1::ObserveRequest) -> Result<(), RpcError> {
        self.session.entry.mark_active();
        // Answers to probes are not read until the message is taken.
        self.probed.pause(true);
        let message = message_from_wire(request)?;
        if matches!(message, StreamMessage::Alive) {
            self.probed.answer();
        }
        self.session.take(message).await
    }

    async fn drain(&mut self) -> Result<(), RpcError> {
        self.probed.pause(true);
        self.session.drain().await
    }

    /// Ends the stream with this result: the writer removes it, and the client receives the reason and the durable
    /// number.
    pub(super) async fn end(&self, result: &Result<(), RpcError>) {
        self.session.end(result.as_ref().err());
        let Err(error) = result else { return };
        // Without a goodbye the status contains the reason.
        let Some(reason) = goodbye_reason_to_wire(error) else { return };
        let durable_sequence = self.session.durable();
        let goodbye = v1::Goodbye { reason: reason.into(), durable_sequence, detail: error.message() };
        // The status that follows has the same reason; the client may be gone.
        let _ = reply(self.replies, Down::Goodbye(goodbye)).await;
    }
}

/// The reason of a goodbye; `None`: the stream ends without one.
fn goodbye_reason_to_wire(error: &RpcError) -> Option<v1::GoodbyeReason> {
    Some(match error {
        // Clients connect again after the status, as they do when a connection breaks.
        RpcError::Revoked | RpcError::Idle(_) | RpcError::Crowded => return None,
        // Clients connect again, and to another daemon if need be.
        RpcError::Ended(
            Ending::Shutdown | Ending::Erasure | Ending::Moved { .. } | Ending::Replaced | Ending::Forked { .. },
        )
        | RpcError::Stopping => v1::GoodbyeReason::Shutdown,
        RpcError::Ended(Ending::Superseded | Ending::Unanswered) => v1::GoodbyeReason::Superseded,
        RpcError::Ended(Ending::MapDeleted) => v1::GoodbyeReason::MapDeleted,
        RpcError::Ended(Ending::Storage(error)) if is_fatal(error) => v1::GoodbyeReason::Storage,
        RpcError::Ended(Ending::Storage(_)) => v1::GoodbyeReason::DiskFull,
        RpcError::Intake(IntakeError::OutOfSequence { .. }) => v1::GoodbyeReason::OutOfSequence,
        RpcError::Intake(IntakeError::DataMismatch { .. }) => v1::GoodbyeReason::DataMismatch,
        _ => v1::GoodbyeReason::Invalid,
    })
}
