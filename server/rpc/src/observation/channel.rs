//! The two directions of a stream: requests in, replies out.
//!
//! Invariant: the wait for a client that does not read its replies is bounded.

use std::time::Duration;

use tidemap_proto::{
    convert::{OverLimit, observe::undecodable},
    v1::{self, observe_response::Message as Down},
};
use tokio::sync::mpsc;
use tonic::{Code, Status};
use tracing::debug;

use super::StreamLimits;
use crate::status::RpcError;

/// A client must read its replies within this time.
pub(super) const READ_WITHIN: Duration = Duration::from_secs(30);

/// The messages of a stream.
pub(super) trait Requests:
    tokio_stream::Stream<Item = Result<v1::ObserveRequest, Status>> + Send + Unpin
{
}

impl<T: tokio_stream::Stream<Item = Result<v1::ObserveRequest, Status>> + Send + Unpin> Requests for T {}

pub(super) type Replies = mpsc::Sender<Result<v1::ObserveResponse, Status>>;

/// Sends a reply.
///
/// # Errors
/// The client is gone, or reads nothing.
pub(super) async fn reply(replies: &Replies, message: Down) -> Result<(), RpcError> {
    let response = v1::ObserveResponse { message: Some(message) };
    match tokio::time::timeout(READ_WITHIN, replies.send(Ok(response))).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) => Err(RpcError::Broken),
        Err(_) => Err(RpcError::SlowReader(READ_WITHIN.as_secs())),
    }
}

/// The error of a message that could not be read.
pub(super) fn unread(status: &Status, limits: &StreamLimits) -> RpcError {
    match status.code() {
        Code::OutOfRange => {
            let (what, max) = ("bytes of one message", limits.max_message_bytes as u64);
            OverLimit { what, got: None, max, setting: "setting max_message_bytes" }.into()
        }
        // The codec's bound on the number of elements.
        Code::ResourceExhausted => undecodable(status.message()).into(),
        // An error with a source is that of the connection, not that of the message.
        Code::Internal | Code::InvalidArgument if std::error::Error::source(status).is_none() => {
            undecodable(status.message()).into()
        }
        // The guard ends both bodies of a request with this error; whichever is read first, the client receives the
        // same one.
        Code::Unauthenticated => RpcError::Revoked,
        _ => {
            debug!(%status, "stream broke");
            RpcError::Broken
        }
    }
}
