//! The replies of a stream that begin before it is known which daemon sends them: the client may wait for their head
//! before it sends its first message.
//!
//! Invariant: an answer that is only a status becomes the end of the stream.

use std::{
    fmt,
    future::Future,
    pin::Pin,
    task::{Context, Poll, ready},
};

use axum::{
    body::{Body, Bytes},
    http::{HeaderValue, header},
    response::Response,
};
use http_body::Frame;

/// An answer that is still to come.
type Answer = Pin<Box<dyn Future<Output = Response> + Send>>;

/// The body of an answer that is still to come.
struct LateBody {
    answer: Option<Answer>,
    inner: Body,
}

impl fmt::Debug for LateBody {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LateBody").finish_non_exhaustive()
    }
}

/// Returns the head of a stream at once, and its body when the answer arrives.
pub(super) fn late(answer: Answer) -> Response {
    let mut response = Response::new(Body::new(LateBody { answer: Some(answer), inner: Body::empty() }));
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/grpc"));
    response
}

impl http_body::Body for LateBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        if let Some(answer) = &mut self.answer {
            let (parts, body) = ready!(answer.as_mut().poll(context)).into_parts();
            self.answer = None;
            if parts.headers.contains_key("grpc-status") {
                let is_of_status = |name: &str| name.starts_with("grpc-status") || name == "grpc-message";
                let trailers = parts.headers.into_iter().filter_map(|(name, value)| Some((name?, value)));
                let trailers = trailers.filter(|(name, _)| is_of_status(name.as_str())).collect();
                return Poll::Ready(Some(Ok(Frame::trailers(trailers))));
            }
            self.inner = body;
        }
        Pin::new(&mut self.inner).poll_frame(context)
    }
}
