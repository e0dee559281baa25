//! The body of a reply that another daemon sends.
//!
//! Invariant: the body is passed on without change. Where the connection breaks, or this daemon stops, it ends with a
//! status.

use std::{
    fmt,
    future::Future,
    pin::Pin,
    task::{Context, Poll},
};

use axum::body::Bytes;
use http_body::{Frame, SizeHint};
use tonic::{Status, body::Body, codegen::http::HeaderMap};

use super::links::PeerPlace;
use crate::status::{GatewayError, RpcError};

/// The time when a reply that lasts has to end.
pub(super) type End = Pin<Box<dyn Future<Output = ()> + Send>>;

/// A reply that is passed on.
pub(super) struct PassedBody {
    inner: Body,
    member: String,
    /// Ready when this daemon stops; `None`: the reply does not last.
    end: Option<End>,
    is_over: bool,
    _place: PeerPlace,
}

impl fmt::Debug for PassedBody {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PassedBody").field("member", &self.member).finish_non_exhaustive()
    }
}

impl PassedBody {
    pub(super) fn new(inner: Body, member: String, end: Option<End>, place: PeerPlace) -> Self {
        Self { inner, member, end, is_over: false, _place: place }
    }

    fn ended(&mut self, error: RpcError) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        self.is_over = true;
        // This ends the call at the other daemon, too.
        self.inner = Body::empty();
        let mut trailers = HeaderMap::new();
        Poll::Ready(Some(Status::from(error).add_header(&mut trailers).map(|()| Frame::trailers(trailers))))
    }
}

impl http_body::Body for PassedBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        if self.is_over {
            return Poll::Ready(None);
        }
        if self.end.as_mut().is_some_and(|end| end.as_mut().poll(context).is_ready()) {
            return self.ended(RpcError::Stopping);
        }
        match Pin::new(&mut self.inner).poll_frame(context) {
            Poll::Ready(Some(Err(_))) => {
                let member = self.member.clone();
                self.ended(GatewayError::Broke { member }.into())
            }
            other => other,
        }
    }

    fn is_end_stream(&self) -> bool {
        self.is_over || self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::default()
    }
}
