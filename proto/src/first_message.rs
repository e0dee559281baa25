//! Looks at the first message of a gRPC body that is to be passed on.
//!
//! Invariant: the body that is given back has the bytes of the one that was taken. Not more is read than the first
//! message and what arrived with it.

use std::{
    collections::VecDeque,
    pin::Pin,
    task::{Context, Poll},
};

use http_body::{Body, Frame, SizeHint};
use tonic::codegen::Bytes;

/// Bytes before a message: whether it is compressed, and its length.
const PREFIX: usize = 5;

/// A body of which the beginning was read.
#[derive(Debug)]
pub struct PeekedBody<B> {
    read: VecDeque<Frame<Bytes>>,
    rest: B,
}

impl<B: Body<Data = Bytes> + Unpin> PeekedBody<B> {
    /// A body of which nothing was read.
    pub fn new(body: B) -> Self {
        Self { read: VecDeque::new(), rest: body }
    }

    /// The first message; `None`: there is none, it is longer than `max` bytes, or it is compressed.
    ///
    /// # Errors
    /// The body broke off.
    pub async fn first_message(&mut self, max: usize) -> Result<Option<Bytes>, B::Error> {
        loop {
            match self.arrived(max) {
                Arrived::Whole(message) => return Ok(Some(message)),
                Arrived::Unreadable => return Ok(None),
                Arrived::Part => {}
            }
            let frame = std::future::poll_fn(|context| Pin::new(&mut self.rest).poll_frame(context)).await;
            let Some(frame) = frame.transpose()? else { return Ok(None) };
            let is_data = frame.is_data();
            self.read.push_back(frame);
            if !is_data {
                return Ok(None);
            }
        }
    }

    fn arrived(&self, max: usize) -> Arrived {
        let data = || self.read.iter().filter_map(Frame::data_ref);
        let prefix: Vec<u8> = data().flatten().copied().take(PREFIX).collect();
        let Some((0, length)) = prefix.split_first().filter(|_| prefix.len() == PREFIX) else {
            return if prefix.first().is_none_or(|flag| *flag == 0) { Arrived::Part } else { Arrived::Unreadable };
        };
        let length = length.iter().fold(0_usize, |length, byte| length << 8 | usize::from(*byte));
        if length > max {
            return Arrived::Unreadable;
        }
        if data().map(Bytes::len).sum::<usize>() < PREFIX + length {
            return Arrived::Part;
        }
        Arrived::Whole(match self.read.front().and_then(Frame::data_ref) {
            Some(first) if first.len() >= PREFIX + length => first.slice(PREFIX..PREFIX + length),
            _ => {
                let mut message: Vec<u8> = Vec::with_capacity(PREFIX + length);
                data().for_each(|part| message.extend_from_slice(part));
                Bytes::from(message).slice(PREFIX..PREFIX + length)
            }
        })
    }
}

/// How much of the first message is there.
enum Arrived {
    Part,
    Whole(Bytes),
    Unreadable,
}

impl<B: Body<Data = Bytes> + Unpin> Body for PeekedBody<B> {
    type Data = Bytes;
    type Error = B::Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, B::Error>>> {
        match self.read.pop_front() {
            Some(frame) => Poll::Ready(Some(Ok(frame))),
            None => Pin::new(&mut self.rest).poll_frame(context),
        }
    }

    fn is_end_stream(&self) -> bool {
        self.read.is_empty() && self.rest.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        if self.read.is_empty() { self.rest.size_hint() } else { SizeHint::default() }
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

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
            // One that is too long is not read.
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
}
