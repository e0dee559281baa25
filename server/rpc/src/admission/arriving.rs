//! The body of a request while it arrives.
//!
//! Invariant: a request of one message arrives within a bounded time, and pauses for a bounded time only; otherwise it
//! ends with an error. The bytes beyond [`SMALL_REQUEST_BYTES`] are taken from the share of the bytes of large
//! requests.

use std::{
    pin::Pin,
    task::{Context, Poll, ready},
    time::Duration,
};

use http_body::{Frame, SizeHint};
use tidemap_base::shares::{Share, Shares, Taken, client::Client};
use tokio::time::{Instant, Sleep, sleep_until};
use tonic::{Status, body::Body, codegen::Bytes};

use crate::status::RpcError;

/// Maximum times to wait for a request.
#[derive(Clone, Copy, Debug)]
struct Patience {
    /// A request of one message must arrive within this time. In a request of many messages, each message must.
    whole: Duration,
    /// A request of one message may pause for this long; the first message of a request of many must begin within it.
    pause: Duration,
}

const PATIENCE: Patience = Patience { whole: Duration::from_secs(30), pause: Duration::from_secs(5) };
/// Maximum number of bytes of a request that is not large.
const SMALL_REQUEST_BYTES: usize = 64 << 10;

/// A request that arrives.
pub(super) struct ArrivingBody {
    body: Body,
    is_streamed: bool,
    patience: Patience,
    /// The time by which the whole body must arrive.
    due: Instant,
    /// The time by which its next piece must arrive.
    next: Pin<Box<Sleep>>,
    arrived: usize,
    client: Client,
    shares: Shares,
    held: Option<Taken>,
}

impl ArrivingBody {
    pub(super) fn new(body: Body, is_streamed: bool, client: Client, shares: Shares) -> Self {
        Self::waiting(body, is_streamed, client, shares, PATIENCE)
    }

    fn waiting(body: Body, is_streamed: bool, client: Client, shares: Shares, patience: Patience) -> Self {
        let now = Instant::now();
        let next = Box::pin(sleep_until(now + patience.pause));
        Self { body, is_streamed, patience, due: now + patience.whole, next, arrived: 0, client, shares, held: None }
    }

    /// Reserves room for the bytes that have arrived.
    fn hold(&mut self, bytes: usize) -> Result<(), RpcError> {
        let large = |arrived: usize| arrived.saturating_sub(SMALL_REQUEST_BYTES);
        let more = large(self.arrived + bytes) - large(self.arrived);
        self.arrived += bytes;
        match &mut self.held {
            _ if more == 0 => {}
            Some(held) => held.grow(more)?,
            none => *none = Some(self.shares.take(Share::LargeBytes, &self.client, more)?),
        }
        Ok(())
    }

    /// Reads the whole body, with the room that it holds of the bytes of large requests. Returns `None` if the body has
    /// more than `max` bytes or broke off.
    ///
    /// # Errors
    /// The body does not arrive in time, or there is no room.
    pub(super) async fn read_all(mut self, max: usize) -> Result<Option<(Vec<u8>, Option<Taken>)>, Status> {
        let mut all = Vec::new();
        while let Some(frame) = std::future::poll_fn(|context| Pin::new(&mut self).poll_arrived(context)).await {
            match frame {
                Arrived::Frame(frame) => all.extend_from_slice(frame.data_ref().map_or(&[], |data| data)),
                Arrived::Broken(_) => return Ok(None),
                Arrived::Refused(refusal) => return Err(refusal.into()),
            }
            if all.len() > max {
                return Ok(None);
            }
        }
        Ok(Some((all, self.held.take())))
    }

    fn poll_arrived(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Arrived>> {
        let now = Instant::now();
        let Poll::Ready(frame) = http_body::Body::poll_frame(Pin::new(&mut self.body), context) else {
            ready!(self.next.as_mut().poll(context));
            let within = if now >= self.due { self.patience.whole } else { self.patience.pause };
            return Poll::Ready(Some(Arrived::Refused(RpcError::Late { secs: within.as_secs() })));
        };
        let frame = match frame {
            None => return Poll::Ready(None),
            Some(Err(error)) => return Poll::Ready(Some(Arrived::Broken(error))),
            Some(Ok(frame)) => frame,
        };
        if self.is_streamed {
            let next = now + self.patience.whole;
            self.next.as_mut().reset(next);
        } else {
            let next = self.due.min(now + self.patience.pause);
            self.next.as_mut().reset(next);
            if let Err(refusal) = self.hold(frame.data_ref().map_or(0, Bytes::len)) {
                return Poll::Ready(Some(Arrived::Refused(refusal)));
            }
        }
        Poll::Ready(Some(Arrived::Frame(frame)))
    }
}

/// The outcome of a part of a request.
enum Arrived {
    Frame(Frame<Bytes>),
    /// The connection broke.
    Broken(Status),
    /// The request is too slow or too large.
    Refused(RpcError),
}

impl http_body::Body for ArrivingBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        self.poll_arrived(context).map(|piece| {
            piece.map(|piece| match piece {
                Arrived::Frame(frame) => Ok(frame),
                Arrived::Broken(status) => Err(status),
                Arrived::Refused(refusal) => Err(refusal.into()),
            })
        })
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use tidemap_base::{config::Settings, connections::Peer, shares::ShareLimits};
    use tokio_stream::StreamExt as _;

    use super::*;

    const SHORT: Patience = Patience { whole: Duration::from_secs(3), pause: Duration::from_secs(1) };

    fn arriving(
        pieces: impl tokio_stream::Stream<Item = &'static str> + Send + 'static,
        is_streamed: bool,
    ) -> ArrivingBody {
        let pieces = pieces.map(|piece| Ok::<_, Status>(Bytes::from_static(piece.as_bytes())));
        let body = axum::body::Body::from_stream(pieces.chain(tokio_stream::pending()));
        let shares = Shares::new(ShareLimits::of(&Settings::default()));
        ArrivingBody::waiting(Body::new(body), is_streamed, Client::Address(Peer::Local), shares, SHORT)
    }

    #[tokio::test]
    async fn a_body_that_does_not_come_or_trickles_ends() {
        let trickle = || tokio_stream::iter(std::iter::repeat("a")).throttle(Duration::from_millis(20));
        for (body, secs) in [
            (arriving(tokio_stream::empty(), false), SHORT.pause),
            (arriving(tokio_stream::once("a"), false), SHORT.pause),
            (arriving(tokio_stream::empty(), true), SHORT.pause),
            (arriving(trickle(), false), SHORT.whole),
            (arriving(tokio_stream::once("a"), true), SHORT.whole),
        ] {
            let late = body.read_all(1 << 20).await.expect_err("it does not end");
            assert_eq!(late.code(), tonic::Code::DeadlineExceeded);
            assert!(late.message().contains(&format!("{} seconds", secs.as_secs())), "{late}");
        }
    }

    #[tokio::test]
    async fn a_body_beyond_its_bound_is_not_read() {
        let body = arriving(tokio_stream::iter(["abc", "def"]), false);
        assert!(body.read_all(5).await.expect("no refusal").is_none());
    }
}
