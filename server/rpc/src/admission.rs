//! Admission: which callers may send requests, how many requests are under way per client and in total, and how they
//! may arrive.
//!
//! Invariant: a request that is not allowed, or exceeds a bound, is refused at once, before any of it is read, and
//! holds no resources. An admitted request counts until its last reply is sent or its client is gone.

use std::{
    convert::Infallible,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
    time::Instant,
};

use http_body::{Frame, SizeHint};
use tidemap_base::{
    access::{
        Caller,
        peer_secret::PeerSecret,
        table::{Need, OBSERVE, method_name, need},
    },
    connections::{Busy, Peer, Remote},
    shares::{Share, Shares, Taken, client::Client},
    telemetry::{occasional::Occasional, traces::Span},
};
use tonic::{
    Code, Status,
    body::Body,
    codegen::{Bytes, Service, http},
};
use tracing::info;

use super::{
    guard::Access,
    status::{RpcError, code_name},
};

mod arriving;

use arriving::ArrivingBody;

const WATCH_ANOMALIES: &str = "/tidemap.v1.QueryService/WatchAnomalies";
const WATCH_HEALTH: &str = "/grpc.health.v1.Health/Watch";

/// Methods whose requests have many messages: each message must arrive in time, and has its own size bound.
const STREAMED: [&str; 3] = [
    "/tidemap.v1.QueryService/EvaluateStates",
    "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
    "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
];

static DENIALS: Occasional = Occasional::new();

/// The shares that the requests of all ports take from. Clones share them.
#[derive(Clone, Debug)]
pub(crate) struct Admission {
    shares: Shares,
    /// The secret by which other daemons prove who they are, if this daemon is a member of a cluster.
    peers: Option<PeerSecret>,
}

impl Admission {
    /// Creates an admission whose requests take from these shares.
    pub(crate) fn new(shares: Shares, peers: Option<PeerSecret>) -> Self {
        Self { shares, peers }
    }

    /// Returns a service for callers with this access.
    pub(crate) fn service<S>(&self, inner: S, access: Access) -> AdmittedService<S> {
        AdmittedService { inner, access, shares: self.shares.clone(), peers: self.peers.clone() }
    }
}

/// Logs and counts a request that a client is not allowed to make.
pub fn note_denial(peer: Peer, method: &str, error: &RpcError) {
    let reason = error.code_and_reason().1;
    if let Some(left_out) = DENIALS.next() {
        info!(%peer, reason, method, left_out, "a request was refused");
    }
    metrics::counter!("tidemap_denied_total", "reason" => reason).increment(1);
}

/// An admitted request. The resources that it holds are freed when all clones are dropped.
#[derive(Clone, Debug)]
pub struct Admitted {
    caller: Caller,
    client: Client,
    _held: Arc<(Option<Taken>, Option<Busy>)>,
}

impl Admitted {
    /// The caller of the request.
    pub fn caller(&self) -> &Caller {
        &self.caller
    }
}

/// A service whose requests are admitted.
#[derive(Clone, Debug)]
pub struct AdmittedService<S> {
    inner: S,
    access: Access,
    shares: Shares,
    peers: Option<PeerSecret>,
}

impl<S> AdmittedService<S> {
    /// The inner service, for work in [`AdmittedService::answer`].
    pub fn inner(&self) -> &S {
        &self.inner
    }

    /// Does work that answers a request like a call of a method, but without a wire message: the caller must be allowed
    /// to call the method, and the request is counted and measured as a call of it. `path` is the path of the method.
    ///
    /// # Errors
    /// The error of the work; or the caller may not call the method, too many requests are under way, or the token was
    /// revoked.
    pub async fn answer<T>(
        &self,
        path: &'static str,
        (headers, extensions): (&http::HeaderMap, &http::Extensions),
        work: impl Future<Output = Result<T, RpcError>>,
    ) -> Result<T, RpcError> {
        let admitted = self.admit(path, headers, extensions)?;
        let method = method_name(path);
        let span = Span::of_request(headers, method);
        let mut end = RequestEnd { method: Some(method), began: Instant::now(), code: None, span: span.clone() };
        let answer = span.scope(self.access.work_for(admitted.caller.clone(), work)).await;
        end.code = Some(answer.as_ref().map_or_else(|error| error.code_and_reason().0, |_| Code::Ok));
        answer
    }

    fn caller(&self, path: &str, headers: &http::HeaderMap) -> Result<Caller, RpcError> {
        match (need(path), &self.peers) {
            (Some(Need::Peer), Some(secret)) => secret.check(headers).map(|()| Caller::Peer).map_err(RpcError::Denial),
            _ => self.access.check(path, headers),
        }
    }

    /// Admits a request by its head. The service takes the answer from the extensions of a request that has one.
    ///
    /// # Errors
    /// The caller may not call this method, or too many requests are under way.
    pub fn admit(
        &self,
        path: &str,
        headers: &http::HeaderMap,
        extensions: &http::Extensions,
    ) -> Result<Admitted, RpcError> {
        let remote = extensions.get::<Remote>().inspect(|remote| remote.note_request());
        let peer = remote.map_or(Peer::Local, Remote::peer);
        let method = method_name(path);
        let caller = self.caller(path, headers).inspect_err(|error| {
            note_denial(peer, method, error);
            let code = code_name(error.code_and_reason().0);
            metrics::counter!("tidemap_requests_total", "method" => method, "code" => code).increment(1);
        })?;
        let is_stranger = need(path) == Some(Need::Open) && !matches!(caller, Caller::Holder(_));
        let share = match method {
            // Both have bounds of their own, and a stream reads its messages at its own pace.
            OBSERVE | WATCH_ANOMALIES => None,
            WATCH_HEALTH => Some(Share::HealthWatches),
            _ if is_stranger => Some(Share::Open),
            _ => Some(Share::Requests),
        };
        let client = Client::of(&caller, headers, peer, self.peers.as_ref());
        let taken = share.map(|share| self.shares.take(share, &client, 1)).transpose()?;
        let busy = remote.map(|remote| remote.busy(!matches!(caller, Caller::Stranger)));
        Ok(Admitted { caller, client, _held: Arc::new((taken, busy)) })
    }

    /// Reads the whole body of an admitted request, with the room that it holds of the bytes of large requests. Returns
    /// `None` if the body has more than `max` bytes or broke off.
    ///
    /// # Errors
    /// The body does not arrive in time, or there is no room.
    pub async fn read_all(
        &self,
        admitted: &Admitted,
        body: axum::body::Body,
        max: usize,
    ) -> Result<Option<(Vec<u8>, Option<Taken>)>, Status> {
        ArrivingBody::new(Body::new(body), false, admitted.client.clone(), self.shares.clone()).read_all(max).await
    }

    /// Reserves room for a large request as JSON.
    ///
    /// # Errors
    /// There is no room.
    pub fn large_json(&self, admitted: &Admitted) -> Result<Taken, Status> {
        Ok(self.shares.take(Share::LargeJson, &admitted.client, 1).map_err(RpcError::from)?)
    }
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

    fn call(&mut self, mut request: http::Request<Body>) -> Answer {
        let known = request.extensions_mut().remove::<Admitted>();
        let admit = || self.admit(request.uri().path(), request.headers(), request.extensions());
        let admitted = match known.map_or_else(admit, Ok) {
            Ok(admitted) => admitted,
            Err(error) => return Box::pin(std::future::ready(Ok(Status::from(error).into_http()))),
        };
        let method = method_name(request.uri().path());
        if method != OBSERVE {
            let is_streamed = STREAMED.contains(&method);
            let (client, shares) = (admitted.client.clone(), self.shares.clone());
            request = request.map(|body| Body::new(ArrivingBody::new(body, is_streamed, client, shares)));
        }
        request.extensions_mut().insert(admitted.caller.clone());
        request.extensions_mut().insert(admitted.client.clone());
        // The metrics do not count calls that last.
        let lasts = matches!(method, OBSERVE | WATCH_ANOMALIES | WATCH_HEALTH);
        let span = Span::of_request(request.headers(), method);
        let answer = span.clone().scope(self.inner.call(request));
        let end = RequestEnd { method: (!lasts).then_some(method), began: Instant::now(), code: None, span };
        Box::pin(async move {
            let (mut end, reply) = (end, answer.await?);
            end.read(reply.headers());
            Ok(reply.map(|body| Body::new(CountedBody { body, end, _admitted: admitted })))
        })
    }
}

/// The end of a request. When it is dropped, its code and its duration go to the metrics, and its span ends.
#[derive(Debug)]
struct RequestEnd {
    /// The method for the metrics; `None`: the metrics do not count the request.
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
    _admitted: Admitted,
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
        let matching = methods.filter(|(_, method)| is_of(method));
        matching.map(|(service, method)| format!("/tidemap.v1.{service}/{}", method.name())).collect()
    }

    #[test]
    fn every_request_of_many_messages_is_known() {
        let mut known: Vec<&str> = [OBSERVE].into_iter().chain(STREAMED).collect();
        known.retain(|path| !path.contains("reflection"));
        assert_eq!(paths(prost_types::MethodDescriptorProto::client_streaming), known);
        let replies = paths(prost_types::MethodDescriptorProto::server_streaming);
        assert!(replies.iter().any(|path| path == WATCH_ANOMALIES), "{replies:?}");
    }
}
