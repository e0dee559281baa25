//! Replies of the HTTP port that their readers have not taken yet.
//!
//! Invariant: the bytes of these replies are bounded, per client and in total, whatever makes them. A connection gets a
//! reply piece by piece, so that the bytes that are not yet taken are counted here, and not kept elsewhere. Where there
//! is no room, the oldest reply of the client that holds the most ends. Content that all readers share takes no memory
//! and is not counted.

use std::{
    collections::BTreeMap,
    pin::Pin,
    sync::{Arc, Mutex, PoisonError},
    task::{Context, Poll, ready},
};

use axum::{
    body::{Body, Bytes},
    response::Response,
};
use http_body::{Body as _, Frame, SizeHint};
use tracing::info;

use super::{Busy, Peer, Remote};
use crate::telemetry::occasional::Occasional;

/// Number of bytes that a connection gets at a time. A reply, or a message of a reply, that is no larger is not
/// counted.
const PIECE_BYTES: usize = 16 << 10;
/// Maximum number of bytes that are not taken yet.
const UNREAD_BYTES: usize = 12 << 20;
const UNREAD_BYTES_PER_CLIENT: usize = 4 << 20;

static ENDED: Occasional = Occasional::new();

/// An extension that marks a response whose content is the same bytes for all readers.
#[derive(Clone, Copy, Debug)]
pub struct SharedContent;

/// The error of a reply that there is no room for.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("unread replies take so much memory that there is no room for this one: read the others first, or try again")]
pub struct NoRoom;

/// The bytes of all replies that are not taken yet. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct UnreadReplies(Arc<Mutex<Held>>);

/// Replies by number, the oldest first.
#[derive(Debug, Default)]
struct Held {
    next: u64,
    replies: BTreeMap<u64, Reply>,
}

#[derive(Debug)]
struct Reply {
    remote: Remote,
    /// The counted bytes. A reply that is larger than the bound of a client counts as much as the bound.
    counted: usize,
    is_oversize: bool,
}

/// A reply that is counted until it is dropped.
#[derive(Debug)]
struct CountedReply {
    number: u64,
    unread: UnreadReplies,
}

impl Drop for CountedReply {
    fn drop(&mut self) {
        self.unread.0.lock().unwrap_or_else(PoisonError::into_inner).replies.remove(&self.number);
    }
}

impl Held {
    fn bytes(&self, peer: Option<Peer>) -> usize {
        let of_peer = |reply: &&Reply| peer.is_none_or(|peer| reply.remote.peer() == peer);
        self.replies.values().filter(of_peer).map(|reply| reply.counted).sum()
    }

    /// The number of bytes of the client that holds the most, and this client.
    fn largest(&self) -> Option<(usize, Peer)> {
        let of_each = self.replies.values().map(|reply| reply.remote.peer());
        of_each.map(|peer| (self.bytes(Some(peer)), peer)).max_by_key(|(bytes, _)| *bytes)
    }

    /// Ends the oldest reply of a client. Its bytes are free a moment later.
    fn end_oldest(&mut self, peer: Peer) {
        let oldest = self.replies.iter().find(|(_, reply)| reply.remote.peer() == peer).map(|(number, _)| *number);
        if let Some(reply) = oldest.and_then(|number| self.replies.remove(&number)) {
            reply.remote.displace();
            note_end(peer, "room");
        }
    }

    /// Makes room for a reply of a client. Returns `false` if there is none.
    fn make_room(&mut self, peer: Peer, counted: usize, is_oversize: bool) -> bool {
        let of_peer = self.bytes(Some(peer));
        if of_peer > 0 && of_peer + counted > UNREAD_BYTES_PER_CLIENT
            || is_oversize && self.replies.values().any(|reply| reply.is_oversize)
        {
            return false;
        }
        while self.bytes(None) + counted > UNREAD_BYTES {
            match self.largest() {
                Some((bytes, largest)) if largest != peer && bytes >= of_peer + counted => self.end_oldest(largest),
                _ => return false,
            }
        }
        true
    }
}

fn note_end(peer: Peer, reason: &'static str) {
    metrics::counter!("tidemap_replies_ended_total", "reason" => reason).increment(1);
    if let Some(left_out) = ENDED.next() {
        info!(%peer, left_out, "a reply was ended or refused: too many bytes of replies are not read");
    }
}

impl UnreadReplies {
    fn take(&self, remote: &Remote, bytes: usize) -> Result<CountedReply, NoRoom> {
        let is_oversize = bytes > UNREAD_BYTES_PER_CLIENT;
        let (peer, counted) = (remote.peer(), bytes.min(UNREAD_BYTES_PER_CLIENT));
        let mut held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if !held.make_room(peer, counted, is_oversize) {
            drop(held);
            note_end(peer, "refused");
            return Err(NoRoom);
        }
        let number = held.next;
        held.next += 1;
        held.replies.insert(number, Reply { remote: remote.clone(), counted, is_oversize });
        Ok(CountedReply { number, unread: self.clone() })
    }

    /// Returns a response whose bytes are counted until they are taken, and whose connection is busy until then.
    ///
    /// # Errors
    /// There is no room for a response whose length is known.
    pub fn counted(&self, response: Response, remote: &Remote, busy: Busy) -> Result<Response, NoRoom> {
        let is_shared = response.extensions().get::<SharedContent>().is_some();
        let length = response.body().size_hint().exact().and_then(|length| usize::try_from(length).ok());
        let large = length.filter(|length| !is_shared && *length > PIECE_BYTES);
        let taken = large.map(|length| self.take(remote, length)).transpose()?;
        let (unread, remote) = (self.clone(), remote.clone());
        Ok(response.map(|inner| {
            Body::new(PiecewiseBody { inner, rest: Bytes::new(), taken, is_shared, unread, remote, _busy: busy })
        }))
    }
}

/// A body that is handed over in pieces.
struct PiecewiseBody {
    inner: Body,
    /// The rest of the last frame.
    rest: Bytes,
    taken: Option<CountedReply>,
    is_shared: bool,
    unread: UnreadReplies,
    remote: Remote,
    _busy: Busy,
}

impl PiecewiseBody {
    fn next_piece(&mut self) -> Bytes {
        let piece = self.rest.split_to(self.rest.len().min(PIECE_BYTES));
        if self.is_shared {
            return piece;
        }
        // A slice of a large reply would keep all of it in memory.
        let piece = Bytes::copy_from_slice(&piece);
        if self.rest.is_empty() {
            self.rest = Bytes::new();
            self.taken = None;
        }
        piece
    }
}

impl http_body::Body for PiecewiseBody {
    type Data = Bytes;
    type Error = axum::BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::BoxError>>> {
        let body = &mut *self;
        if body.rest.is_empty() {
            let frame = match ready!(Pin::new(&mut body.inner).poll_frame(context)) {
                Some(Ok(frame)) => frame,
                other => return Poll::Ready(other.map(|frame| frame.map_err(Into::into))),
            };
            match frame.into_data() {
                Ok(data) if data.len() > PIECE_BYTES => body.rest = data,
                Ok(data) => return Poll::Ready(Some(Ok(Frame::data(data)))),
                Err(frame) => return Poll::Ready(Some(Ok(frame))),
            }
            if body.taken.is_none() && !body.is_shared {
                body.taken = Some(body.unread.take(&body.remote, body.rest.len())?);
            }
        }
        Poll::Ready(Some(Ok(Frame::data(body.next_piece()))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (inner, rest) = (self.inner.size_hint(), self.rest.len() as u64);
        let mut hint = SizeHint::new();
        hint.set_lower(inner.lower() + rest);
        if let Some(upper) = inner.upper() {
            hint.set_upper(upper + rest);
        }
        hint
    }
}

#[cfg(test)]
mod tests {
    use std::net::IpAddr;

    use http_body_util::BodyExt as _;

    use super::*;
    use crate::connections::{ConnectionLimits, ConnectionSlot, Connections, Port};

    /// Connections of clients by the last number of their addresses.
    fn connected(clients: &[u8]) -> Vec<ConnectionSlot> {
        let idle_after = std::time::Duration::from_secs(60);
        let port = Connections::new(Port::Http, ConnectionLimits { total: 100, per_client: 100, idle_after });
        let connect = |last: &u8| port.admit(Peer::Address(IpAddr::from([10, 0, 0, *last])));
        clients.iter().map(|last| connect(last).expect("room")).collect()
    }

    fn remote(slot: &ConnectionSlot) -> Remote {
        Remote(Arc::clone(&slot.seat))
    }

    fn reply(unread: &UnreadReplies, slot: &ConnectionSlot, body: Body) -> Result<Body, NoRoom> {
        let remote = remote(slot);
        unread.counted(Response::new(body), &remote, remote.busy(true)).map(Response::into_body)
    }

    fn counted(unread: &UnreadReplies) -> usize {
        unread.0.lock().expect("sound").bytes(None)
    }

    #[tokio::test]
    async fn a_reply_counts_until_its_last_piece_is_taken() {
        let (unread, slots) = (UnreadReplies::default(), connected(&[1]));
        let content: Vec<u8> = (0..100_000_u32).flat_map(u32::to_le_bytes).collect();
        let streamed = tokio_stream::iter([Ok::<_, std::convert::Infallible>(Bytes::from(content.clone()))]);
        for (body, length) in [(Body::from(content.clone()), Some(400_000)), (Body::from_stream(streamed), None)] {
            let mut body = reply(&unread, &slots[0], body).expect("room");
            assert_eq!(body.size_hint().exact(), length);
            let mut read = Vec::new();
            while let Some(frame) = body.frame().await {
                let data = frame.expect("a frame").into_data().expect("data");
                assert!(data.len() <= PIECE_BYTES);
                read.extend_from_slice(&data);
                assert_eq!(counted(&unread) > 0, read.len() < content.len());
            }
            assert!(read == content, "no byte is changed");
        }
        let kept = reply(&unread, &slots[0], Body::from(vec![0; PIECE_BYTES])).expect("room");
        assert_eq!(counted(&unread), 0, "small replies are not counted");
        let large = reply(&unread, &slots[0], Body::from(content)).expect("room");
        assert_eq!(counted(&unread), 400_000);
        drop((kept, large));
        assert_eq!(counted(&unread), 0);
    }

    #[tokio::test]
    async fn shared_content_is_not_counted_and_not_copied() {
        let (unread, slots) = (UnreadReplies::default(), connected(&[1]));
        let content = Bytes::from(vec![7; 1 << 20]);
        let mut response = Response::new(Body::from(content.clone()));
        response.extensions_mut().insert(SharedContent);
        let remote = remote(&slots[0]);
        let response = unread.counted(response, &remote, remote.busy(true)).expect("room");
        let piece = response.into_body().frame().await.expect("a piece").expect("no error").into_data().expect("data");
        assert_eq!((counted(&unread), piece.as_ptr()), (0, content.as_ptr()));
    }

    #[test]
    fn who_holds_the_most_makes_room_for_others() {
        let unread = UnreadReplies::default();
        let slots = connected(&[1, 1, 2, 3, 4]);
        let take = |slot: usize, bytes| unread.take(&remote(&slots[slot]), bytes);
        let half = UNREAD_BYTES_PER_CLIENT / 2;
        let first: Vec<_> = (0..2).map(|slot| take(slot, half).expect("room")).collect();
        assert!(take(0, PIECE_BYTES + 1).is_err(), "its own share is full");
        let others: Vec<_> = (2..4).map(|slot| take(slot, UNREAD_BYTES_PER_CLIENT).expect("room")).collect();
        assert_eq!(counted(&unread), UNREAD_BYTES);
        let newcomer = take(4, half).expect("one of those who hold the most makes room");
        let ended = slots.iter().filter(|slot| slot.seat.is_displaced.load(std::sync::atomic::Ordering::Acquire));
        assert_eq!(ended.count(), 1);
        assert!(counted(&unread) <= UNREAD_BYTES);
        drop((first, others, newcomer));
        let oversize = take(0, 10 * UNREAD_BYTES).expect("one reply may be larger");
        assert!(take(2, 10 * UNREAD_BYTES).is_err(), "at a time");
        assert!(take(2, UNREAD_BYTES_PER_CLIENT).is_ok());
        drop(oversize);
        assert_eq!(counted(&unread), 0);
    }
}
