//! The body of a request or of a reply that ends when the caller's token is revoked.
//!
//! Invariant: the body changes no byte before the revocation, and has no bytes after it.

use std::{
    fmt,
    future::Future,
    pin::Pin,
    task::{Context, Poll},
};

use axum::{BoxError, body::Body, body::Bytes, http::HeaderMap};
use http_body::{Frame, SizeHint};
use tidemap_base::access::{Caller, keyring::Keyring};
use tonic::Status;

use super::status::RpcError;

/// The direction of a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Direction {
    /// To the daemon: it breaks off with an error.
    Request,
    /// From the daemon: it ends with a status.
    Reply,
}

/// A body that is watched.
pub(super) struct WatchedBody {
    inner: Body,
    revoked: Pin<Box<dyn Future<Output = ()> + Send>>,
    direction: Direction,
    is_over: bool,
}

impl fmt::Debug for WatchedBody {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("WatchedBody").field("direction", &self.direction).finish_non_exhaustive()
    }
}

impl WatchedBody {
    /// Watches the body of a caller's request or reply.
    pub(super) fn wrap(inner: Body, keyring: Keyring, caller: Caller, direction: Direction) -> Body {
        Body::new(Self { inner, revoked: Box::pin(keyring.revoked(caller)), direction, is_over: false })
    }
}

impl http_body::Body for WatchedBody {
    type Data = Bytes;
    type Error = BoxError;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
        let body = &mut *self;
        if body.is_over {
            return Poll::Ready(None);
        }
        if body.revoked.as_mut().poll(context).is_ready() {
            body.is_over = true;
            body.inner = Body::empty();
            metrics::counter!("tidemap_revoked_requests_total").increment(1);
            let status = Status::from(RpcError::Revoked);
            return Poll::Ready(Some(match body.direction {
                Direction::Request => Err(Box::new(status)),
                Direction::Reply => {
                    let mut trailers = HeaderMap::new();
                    status.add_header(&mut trailers).map(|()| Frame::trailers(trailers)).map_err(Into::into)
                }
            }));
        }
        Pin::new(&mut body.inner).poll_frame(context).map_err(Into::into)
    }

    fn is_end_stream(&self) -> bool {
        self.is_over || self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        // An exact length would be a promise that a revocation could break.
        SizeHint::default()
    }
}
