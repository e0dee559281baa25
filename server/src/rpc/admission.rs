//! Admission: how many requests are under way, of one client and in total, and how they may arrive.
//!
//! Invariant: a request beyond a bound is refused at once, before anything of it is decoded. It counts from its arrival
//! until its last reply is sent or its client is gone. A request that does not arrive within [`ARRIVES_WITHIN`] ends,
//! and large requests that arrive at the same time share [`LARGE_REQUESTS_BYTES`].

use std::{
    collections::HashMap,
    convert::Infallible,
    pin::Pin,
    sync::{Arc, Mutex, PoisonError},
    task::{Context, Poll, ready},
    time::Duration,
};

use http_body::{Frame, SizeHint};
use tokio::{
    sync::{OwnedSemaphorePermit, Semaphore},
    time::{Instant, Sleep, sleep},
};
use tonic::{
    Code, Status,
    body::Body,
    codegen::{Bytes, Service, http},
};
use tower_layer::Layer;

use super::status::{RpcError, code_name};
use crate::{access::table::method_name, connections::Peer, telemetry::traces::Span};

/// A request of one message must arrive within this time.
const ARRIVES_WITHIN: Duration = Duration::from_secs(30);
/// What large requests that arrive at the same time may take together, in bytes.
const LARGE_REQUESTS_BYTES: usize = 64 << 20;
/// A request of at most so many bytes is not large.
const SMALL_REQUEST_BYTES: usize = 64 << 10;

/// Streams that last: they have bounds of their own, `max_streams` and `max_watches`, or belong to the health service.
const LASTING: [&str; 3] = [
    "/tidemap.v1.ObservationService/Observe",
    "/tidemap.v1.QueryService/WatchAnomalies",
    "/grpc.health.v1.Health/Watch",
];

/// Requests of many messages: each message must arrive in time, and is bounded by itself.
const STREAMED: [&str; 1] = ["/tidemap.v1.QueryService/EvaluateStates"];

/// Bounds of requests under way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RequestLimits {
    /// Maximum number of requests.
    pub total: usize,
    /// Maximum number of requests of one client.
    pub per_client: usize,
}

/// Admits the requests of a port. Clones share what they count.
#[derive(Clone, Debug)]
pub(crate) struct Admission {
    limits: RequestLimits,
    under_way: Arc<Mutex<UnderWay>>,
    large: Arc<Semaphore>,
}

#[derive(Debug, Default)]
struct UnderWay {
    total: usize,
    per_client: HashMap<Peer, usize>,
}

/// Counts a request while it is under way.
#[derive(Debug)]
struct RequestCount {
    peer: Peer,
    under_way: Arc<Mutex<UnderWay>>,
}

impl Drop for RequestCount {
    fn drop(&mut self) {
        let mut under_way = self.under_way.lock().unwrap_or_else(PoisonError::into_inner);
        under_way.total -= 1;
        metrics::gauge!("tidemap_requests").set(under_way.total as f64);
        if let Some(count) = under_way.per_client.get_mut(&self.peer) {
            *count -= 1;
            if *count == 0 {
                under_way.per_client.remove(&self.peer);
            }
        }
    }
}

impl Admission {
    /// Nothing is under way.
    pub(crate) fn new(limits: RequestLimits) -> Self {
        Self { limits, under_way: Arc::default(), large: Arc::new(Semaphore::new(LARGE_REQUESTS_BYTES)) }
    }

    fn count(&self, peer: Peer) -> Result<RequestCount, RpcError> {
        let mut under_way = self.under_way.lock().unwrap_or_else(PoisonError::into_inner);
        let of_client = under_way.per_client.get(&peer).copied().unwrap_or(0);
        let refuse = |max, setting| {
            metrics::counter!("tidemap_requests_refused").increment(1);
            Err(RpcError::TooManyRequests { max, setting })
        };
        if of_client >= self.limits.per_client {
            return refuse(self.limits.per_client, "max_requests_per_client");
        }
        if under_way.total >= self.limits.total {
            return refuse(self.limits.total, "max_requests");
        }
        under_way.total += 1;
        *under_way.per_client.entry(peer).or_default() += 1;
        metrics::gauge!("tidemap_requests").set(under_way.total as f64);
        drop(under_way);
        Ok(RequestCount { peer, under_way: Arc::clone(&self.under_way) })
    }
}

impl<S> Layer<S> for Admission {
    type Service = AdmittedService<S>;

    fn layer(&self, inner: S) -> AdmittedService<S> {
        AdmittedService { inner, admission: self.clone() }
    }
}

/// A service whose requests are admitted.
#[derive(Clone, Debug)]
pub(crate) struct AdmittedService<S> {
    inner: S,
    admission: Admission,
}

type Answer = Pin<Box<dyn Future<Output = Result<http::Response<Body>, Infallible>> + Send>>;

impl<S> Service<http::Request<Body>> for AdmittedService<S>
where
    S: Service<http::Request<Body>, Response = http::Response<Body>, Error = Infallible>,
    S::Future: Send + 'static,
{
    type Response = http::Response<Body>;
    type Error = Infallible;
    type Future = Answer;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, request: http::Request<Body>) -> Answer {
        let method = method_name(request.uri().path());
        if LASTING.contains(&method) {
            let span = Span::of_request(request.headers(), method);
            let answer = span.clone().scope(self.inner.call(request));
            let end = RequestEnd { method: None, began: Instant::now(), code: None, span };
            return Box::pin(count_until_end(answer, end, None));
        }
        let peer = request.extensions().get::<Peer>().copied().unwrap_or(Peer::Local);
        let count = match self.admission.count(peer) {
            Ok(count) => count,
            Err(error) => return Box::pin(std::future::ready(Ok(Status::from(error).into_http()))),
        };
        let is_streamed = STREAMED.contains(&request.uri().path());
        let large = Arc::clone(&self.admission.large);
        let deadline = Box::pin(sleep(ARRIVES_WITHIN));
        let request =
            request.map(|body| Body::new(ArrivingBody { body, is_streamed, deadline, arrived: 0, large, held: None }));
        let span = Span::of_request(request.headers(), method);
        let answer = span.clone().scope(self.inner.call(request));
        let end = RequestEnd { method: Some(method), began: Instant::now(), code: None, span };
        Box::pin(count_until_end(answer, end, Some(count)))
    }
}

async fn count_until_end(
    answer: impl Future<Output = Result<http::Response<Body>, Infallible>> + Send,
    mut end: RequestEnd,
    count: Option<RequestCount>,
) -> Result<http::Response<Body>, Infallible> {
    let reply = answer.await?;
    end.read(reply.headers());
    Ok(reply.map(|body| Body::new(CountedBody { body, end, _count: count })))
}

/// A request that arrives.
struct ArrivingBody {
    body: Body,
    is_streamed: bool,
    deadline: Pin<Box<Sleep>>,
    arrived: usize,
    large: Arc<Semaphore>,
    held: Option<OwnedSemaphorePermit>,
}

impl ArrivingBody {
    /// Reserves room for what has arrived.
    fn hold(&mut self) -> Result<(), Status> {
        let wanted = self.arrived.saturating_sub(SMALL_REQUEST_BYTES);
        let held = self.held.as_ref().map_or(0, OwnedSemaphorePermit::num_permits);
        let Some(more) = wanted.checked_sub(held).filter(|more| *more > 0) else { return Ok(()) };
        let more = u32::try_from(more).unwrap_or(u32::MAX);
        let Ok(more) = Arc::clone(&self.large).try_acquire_many_owned(more) else {
            return Err(RpcError::LargeRequests { max_bytes: LARGE_REQUESTS_BYTES }.into());
        };
        match &mut self.held {
            Some(held) => held.merge(more),
            none => *none = Some(more),
        }
        Ok(())
    }
}

impl http_body::Body for ArrivingBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let Poll::Ready(frame) = Pin::new(&mut self.body).poll_frame(context) else {
            ready!(self.deadline.as_mut().poll(context));
            return Poll::Ready(Some(Err(RpcError::Late { secs: ARRIVES_WITHIN.as_secs() }.into())));
        };
        if self.is_streamed {
            self.deadline.as_mut().reset(Instant::now() + ARRIVES_WITHIN);
        } else if let Some(Ok(frame)) = &frame {
            self.arrived += frame.data_ref().map_or(0, Bytes::len);
            if let Err(refusal) = self.hold() {
                return Poll::Ready(Some(Err(refusal)));
            }
        }
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// How a request ended: its code and its duration go to the metrics when it is dropped, and its span ends.
#[derive(Debug)]
struct RequestEnd {
    /// For the metrics; `None`: they do not count it.
    method: Option<&'static str>,
    began: Instant,
    /// `None`: the client left before the end.
    code: Option<Code>,
    span: Span,
}

impl RequestEnd {
    /// Takes the code from headers or trailers that have it.
    fn read(&mut self, headers: &http::HeaderMap) {
        if let Some(code) = headers.get("grpc-status") {
            self.code = Some(Code::from_bytes(code.as_bytes()));
        }
    }
}

impl Drop for RequestEnd {
    fn drop(&mut self) {
        let code = code_name(self.code.unwrap_or(Code::Cancelled));
        self.span.number("rpc.grpc.status_code", self.code.unwrap_or(Code::Cancelled) as u64);
        if self.code != Some(Code::Ok) {
            self.span.fail(code);
        }
        self.span.end();
        let Some(method) = self.method else { return };
        metrics::counter!("tidemap_requests_total", "method" => method, "code" => code).increment(1);
        metrics::histogram!("tidemap_request_duration_seconds", "method" => method).record(self.began.elapsed());
    }
}

/// A reply that keeps its request counted.
struct CountedBody {
    body: Body,
    end: RequestEnd,
    _count: Option<RequestCount>,
}

impl http_body::Body for CountedBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let frame = Pin::new(&mut self.body).poll_frame(context);
        if let Poll::Ready(Some(Ok(frame))) = &frame
            && let Some(trailers) = frame.trailers_ref()
        {
            self.end.read(trailers);
        }
        frame
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
    use tidemap_proto::v1::DESCRIPTORS;

    use super::*;

    /// Paths of the methods of which one side is a stream.
    fn paths(is_of: fn(&prost_types::MethodDescriptorProto) -> bool) -> Vec<String> {
        let set = <prost_types::FileDescriptorSet as prost::Message>::decode(DESCRIPTORS).expect("the descriptors");
        let services = set.file.iter().flat_map(|file| &file.service);
        let methods = services.flat_map(|service| service.method.iter().map(move |method| (service.name(), method)));
        let of = methods.filter(|(_, method)| is_of(method));
        of.map(|(service, method)| format!("/tidemap.v1.{service}/{}", method.name())).collect()
    }

    #[test]
    fn every_request_of_many_messages_is_known() {
        let mut known: Vec<&str> = LASTING.iter().chain(&STREAMED).copied().collect();
        known.retain(|path| !path.contains("Health") && !path.contains("Watch"));
        assert_eq!(paths(prost_types::MethodDescriptorProto::client_streaming), known);
        let replies = paths(prost_types::MethodDescriptorProto::server_streaming);
        assert!(replies.iter().any(|path| path == LASTING[1]), "{replies:?}");
    }

    #[test]
    fn requests_beyond_a_bound_are_refused_and_counted_until_they_end() {
        let admission = Admission::new(RequestLimits { total: 3, per_client: 2 });
        let peer = |last: u8| Peer::Address([10, 0, 0, last].into());
        let counts: Vec<_> = (0..2).map(|_| admission.count(peer(1)).expect("admitted")).collect();
        let refused = admission.count(peer(1)).expect_err("two are under way").to_string();
        assert!(refused.contains("max_requests_per_client"), "{refused}");
        let other = admission.count(peer(2)).expect("another client");
        let refused = admission.count(peer(3)).expect_err("three are under way").to_string();
        assert!(refused.contains("max_requests:"), "{refused}");
        drop((counts, other));
        assert!(admission.count(peer(3)).is_ok());
        assert_eq!(admission.under_way.lock().expect("sound").per_client.len(), 0);
    }
}
