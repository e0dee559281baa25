//! Reads the first message of a gRPC body that is to be passed on.
//!
//! Invariant: the returned body has the bytes of the given one. It reads no more than the first message and the bytes
//! that arrived with it.

use std::{
    pin::Pin,
    task::{Context, Poll},
};

use http_body::{Body, Frame, SizeHint};
use prost::bytes::BytesMut;
use tonic::codegen::Bytes;

/// Bytes before a message: whether it is compressed, and its length.
const PREFIX: usize = 5;

/// A body of which the beginning was read.
#[derive(Debug)]
pub struct PeekedBody<B> {
    /// The bytes read, if they arrived in one part.
    whole: Bytes,
    /// The bytes read, if they arrived in several parts: however many there are, they take the room of their bytes.
    gathered: BytesMut,
    /// The end of a body, if it came before its first message.
    trailers: Option<Frame<Bytes>>,
    rest: B,
}

impl<B: Body<Data = Bytes> + Unpin> PeekedBody<B> {
    /// A body of which nothing was read.
    pub fn new(body: B) -> Self {
        Self { whole: Bytes::new(), gathered: BytesMut::new(), trailers: None, rest: body }
    }

    /// The first message; `None`: there is none, it is longer than `max` bytes, or it is compressed.
    ///
    /// # Errors
    /// The body broke off.
    pub async fn first_message(&mut self, max: usize) -> Result<Option<Bytes>, B::Error> {
        loop {
            match arrived(self.read(), max) {
                Arrived::Whole(end) => return Ok(Some(self.take_read().slice(PREFIX..end))),
                Arrived::Unreadable => return Ok(None),
                Arrived::Part => {}
            }
            let frame = std::future::poll_fn(|context| Pin::new(&mut self.rest).poll_frame(context)).await;
            match frame.transpose()?.map(Frame::into_data) {
                Some(Ok(part)) => self.push(part),
                Some(Err(trailers)) => {
                    self.trailers = Some(trailers);
                    return Ok(None);
                }
                None => return Ok(None),
            }
        }
    }

    fn read(&self) -> &[u8] {
        if self.gathered.is_empty() { &self.whole } else { &self.gathered }
    }

    fn push(&mut self, part: Bytes) {
        if self.read().is_empty() {
            self.whole = part;
            return;
        }
        self.gathered.extend_from_slice(&std::mem::take(&mut self.whole));
        self.gathered.extend_from_slice(&part);
    }

    /// Takes the bytes read, which stay read.
    fn take_read(&mut self) -> Bytes {
        if !self.gathered.is_empty() {
            self.whole = self.gathered.split().freeze();
        }
        self.whole.clone()
    }
}

/// Finds how much of the first message these bytes have.
fn arrived(read: &[u8], max: usize) -> Arrived {
    let Some((&[flag, ref length @ ..], message)) = read.split_first_chunk::<PREFIX>() else {
        return if read.first().is_none_or(|flag| *flag == 0) { Arrived::Part } else { Arrived::Unreadable };
    };
    let length = length.iter().fold(0_usize, |length, byte| length << 8 | usize::from(*byte));
    match (flag, length) {
        (0, length) if length > max => Arrived::Unreadable,
        (0, length) if message.len() < length => Arrived::Part,
        (0, length) => Arrived::Whole(PREFIX + length),
        _ => Arrived::Unreadable,
    }
}

/// The part of the first message that has arrived.
enum Arrived {
    Part,
    /// The whole message arrived; it ends at this byte.
    Whole(usize),
    Unreadable,
}

impl<B: Body<Data = Bytes> + Unpin> Body for PeekedBody<B> {
    type Data = Bytes;
    type Error = B::Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, B::Error>>> {
        let read = self.take_read();
        self.whole = Bytes::new();
        if !read.is_empty() {
            return Poll::Ready(Some(Ok(Frame::data(read))));
        }
        match self.trailers.take() {
            Some(trailers) => Poll::Ready(Some(Ok(trailers))),
            None => Pin::new(&mut self.rest).poll_frame(context),
        }
    }

    fn is_end_stream(&self) -> bool {
        self.read().is_empty() && self.trailers.is_none() && self.rest.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        if self.read().is_empty() && self.trailers.is_none() { self.rest.size_hint() } else { SizeHint::default() }
    }
}

#[cfg(test)]
mod tests {
    use std::{collections::VecDeque, convert::Infallible};

    use proptest::prelude::*;

    use super::*;

    /// Parts that arrive one after the other.
    struct Parts(VecDeque<Bytes>);

    impl Body for Parts {
        type Data = Bytes;
        type Error = Infallible;

        fn poll_frame(mut self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
            Poll::Ready(self.0.pop_front().map(|part| Ok(Frame::data(part))))
        }
    }

    fn now<T>(future: impl Future<Output = T>) -> T {
        match std::pin::pin!(future).poll(&mut Context::from_waker(std::task::Waker::noop())) {
            Poll::Ready(value) => value,
            Poll::Pending => panic!("it waits"),
        }
    }

    fn rest(mut body: PeekedBody<Parts>) -> Vec<u8> {
        let mut bytes = Vec::new();
        while let Some(Ok(frame)) = now(std::future::poll_fn(|context| Pin::new(&mut body).poll_frame(context))) {
            bytes.extend_from_slice(frame.data_ref().expect("data"));
        }
        bytes
    }

    proptest! {
        #[test]
        fn the_first_message_is_found_and_no_byte_is_lost(
            message in prop::collection::vec(any::<u8>(), 0..40),
            more in prop::collection::vec(any::<u8>(), 0..20),
            part in 1..50_usize,
        ) {
            let length = u32::try_from(message.len()).expect("short");
            let bytes = [&[0][..], &length.to_be_bytes(), &message, &more].concat();
            let parts = || Parts(bytes.chunks(part).map(Bytes::copy_from_slice).collect());
            let mut body = PeekedBody::new(parts());
            prop_assert_eq!(now(body.first_message(64)), Ok(Some(Bytes::from(message.clone()))));
            prop_assert_eq!(rest(body), bytes.clone());
            // A message that is too long is not read.
            let mut body = PeekedBody::new(parts());
            let found = now(body.first_message(message.len().saturating_sub(1)));
            prop_assert_eq!(found.expect("a body").is_some(), message.is_empty());
            prop_assert_eq!(rest(body), bytes);
        }
    }

    #[test]
    fn a_body_without_a_message_has_none() {
        for bytes in [&b""[..], &[0, 0, 0], &[0, 0, 0, 0, 2, 1], &[1, 0, 0, 0, 1, 1]] {
            let mut body = PeekedBody::new(Parts(VecDeque::from([Bytes::copy_from_slice(bytes)])));
            assert_eq!(now(body.first_message(64)), Ok(None), "{bytes:?}");
            assert_eq!(rest(body), bytes);
        }
    }

    #[test]
    fn parts_of_one_byte_or_none_are_not_kept_one_by_one() {
        let message = [7; 1000];
        let bytes = [&[0, 0, 0, 3, 232][..], &message].concat();
        let parts = bytes.iter().flat_map(|byte| [Bytes::copy_from_slice(&[*byte]), Bytes::new()]).collect();
        let mut body = PeekedBody::new(Parts(parts));
        assert_eq!(now(body.first_message(1000)), Ok(Some(Bytes::copy_from_slice(&message))));
        let read = now(std::future::poll_fn(|context| Pin::new(&mut body).poll_frame(context)));
        let read = read.expect("a frame").expect("no error").into_data().expect("data");
        assert_eq!(read, bytes, "what was read is one piece");
    }
}
