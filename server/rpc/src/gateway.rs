//! The gateway: where daemons share maps, each of them answers for every map.
//!
//! A request that this daemon can answer goes on to the services. Any other request is passed to the daemon that writes
//! the map, and that daemon passes it to nobody: the gateway copies bytes in both directions and does not decode them.
//! Requests contain what their client has seen of a map, and replies contain what they show ([`ReadToken`]), so that no
//! client sees less than before.
//!
//! Invariant: a request is passed on at most once, for a caller that may call the method and use the map, and with the
//! caller's own token, which the other daemon checks again. The gateway holds no more of a body than its first message.
//! A daemon that shares no maps has no gateway.

use std::{sync::Arc, time::Duration};

use axum::{
    body::Body,
    extract::{Request, State},
    http::{HeaderMap, HeaderName, HeaderValue, header, request::Parts},
    middleware::Next,
    response::Response,
};
use tidemap_base::{
    access::{
        peer_secret::PeerSecret,
        places::{Place, place},
    },
    shares::client::Client,
    telemetry::traces::Span,
};
use tidemap_ingest::{
    catalog::Catalog,
    cluster::Cluster,
    handle::{MapHandle, OpenProgress, Shown},
    peers::{Peers, SharedMaps},
    role::MapRole,
};
use tidemap_proto::{
    first_message::PeekedBody,
    map_of::map_of,
    read_token::{ALLOW_STALE, AT_LEAST, FORWARDED, ReadToken, SHOWN},
};
use tokio::sync::watch;
use tonic::{Status, codegen::Service as _};

use super::{
    guard::current_caller,
    lookup::check_scope,
    observation::HELLO_WITHIN,
    status::{GatewayError, RpcError},
};

mod jobs;
mod late_body;
pub(super) mod links;
mod passed_body;
#[cfg(test)]
mod tests;

use late_body::late;
use links::{Links, PeerPlace};
use passed_body::{End, PassedBody};

/// Maximum time that a request waits for a writer that is known and answers.
const WRITER_WITHIN: Duration = Duration::from_secs(2);
/// Interval at which the gateway searches for the writer again.
const CHECK_INTERVAL: Duration = Duration::from_millis(100);
/// Maximum time that a request waits for a view that shows what its client has seen.
const SHOWN_WITHIN: Duration = Duration::from_millis(200);
/// Maximum size of a first message that the gateway reads: no service takes a larger one.
const FIRST_BYTES: usize = 16 << 20;
/// Maximum size of a Hello that the gateway reads.
const HELLO_BYTES: usize = 64 << 10;

const OBSERVE: &str = "/tidemap.v1.ObservationService/Observe";
/// Calls whose replies last until somebody ends them.
const LASTING: [&str; 3] =
    [OBSERVE, "/tidemap.v1.QueryService/WatchAnomalies", "/tidemap.v1.MaintenanceService/WatchJob"];

/// Headers that are passed on, besides those that begin with [`OWN_PREFIX`].
const PASSED: [HeaderName; 6] = [
    header::USER_AGENT,
    HeaderName::from_static("grpc-timeout"),
    HeaderName::from_static("grpc-encoding"),
    HeaderName::from_static("grpc-accept-encoding"),
    HeaderName::from_static("traceparent"),
    HeaderName::from_static("tracestate"),
];
const OWN_PREFIX: &str = "tidemap-";

/// The gateway of a daemon. Clones share its connections.
#[derive(Clone, Debug)]
pub(crate) struct ClusterGateway {
    catalog: Arc<Catalog>,
    peers: Arc<dyn Peers>,
    /// The secret by which the other daemons recognise this one.
    secret: Option<PeerSecret>,
    links: Arc<Links>,
    /// Becomes true when the daemon stops.
    stopping: watch::Receiver<bool>,
}

/// The header with the caller's token, which no service sees.
#[derive(Clone)]
struct KeptAuthorization(HeaderValue);

/// Keeps the caller's token for a request that is passed on.
pub(super) async fn keep_authorization(mut request: Request, next: Next) -> Response {
    if let Some(authorization) = request.headers().get(header::AUTHORIZATION).cloned() {
        request.extensions_mut().insert(KeptAuthorization(authorization));
    }
    next.run(request).await
}

/// Answers a request here, or passes it on.
pub(super) async fn answer_or_pass(
    State(gateway): State<ClusterGateway>,
    mut request: Request,
    next: Next,
) -> Response {
    let authorization = request.extensions_mut().remove::<KeptAuthorization>();
    let place = place(request.uri().path());
    if place == Place::Anywhere {
        return next.run(request).await;
    }
    let (parts, body) = request.into_parts();
    let is_observe = parts.uri.path() == OBSERVE;
    let call = GatewayCall { parts, body: PeekedBody::new(body), authorization };
    let answer = async move {
        let answer = gateway.answer(place, call, next).await;
        answer.unwrap_or_else(|status| status.into_http())
    };
    if !is_observe {
        return answer.await;
    }
    let answer = Client::current().scope(current_caller().scope(answer));
    late(Box::pin(Span::current().scope(answer)))
}

async fn first_message(parts: &Parts, body: &mut PeekedBody<Body>) -> Result<Option<axum::body::Bytes>, Status> {
    let broke = |error: axum::Error| Status::from_error(error.into_inner());
    if parts.uri.path() != OBSERVE {
        return body.first_message(FIRST_BYTES).await.map_err(broke);
    }
    match tokio::time::timeout(HELLO_WITHIN, body.first_message(HELLO_BYTES)).await {
        Ok(first) => first.map_err(broke),
        Err(_) => Err(RpcError::NoHello.into()),
    }
}

/// A request whose first message the gateway reads.
struct GatewayCall {
    parts: Parts,
    body: PeekedBody<Body>,
    authorization: Option<KeptAuthorization>,
}

impl GatewayCall {
    /// Answers the request in this daemon.
    async fn answer(self, next: Next) -> Response {
        next.run(Request::from_parts(self.parts, Body::new(self.body))).await
    }

    /// The name of the daemon that has passed the request on.
    fn passed_by(&self) -> Option<String> {
        let by = self.parts.headers.get(FORWARDED)?;
        Some(by.to_str().unwrap_or("another daemon").chars().take(80).collect())
    }
}

/// The daemon that answers a request.
enum Answerer {
    Here,
    There { member: String, address: String, place: PeerPlace },
}

/// The content that a view of a map shows, as a token.
fn token(map: &MapHandle, Shown { position, generation }: Shown) -> ReadToken {
    ReadToken { map_uid: map.shared_uid.unwrap_or_default(), position, generation }
}

impl ClusterGateway {
    pub(super) fn new(catalog: Arc<Catalog>, shared: SharedMaps, stopping: watch::Receiver<bool>) -> Self {
        let secret = catalog.context().cluster.as_ref().map(Cluster::secret);
        let links = Arc::new(Links::new(shared.tls, shared.tokens_in_clear));
        Self { catalog, peers: shared.peers, secret, links, stopping }
    }

    async fn answer(&self, place: Place, mut call: GatewayCall, next: Next) -> Result<Response, Status> {
        let first = first_message(&call.parts, &mut call.body).await?;
        let answer = if place == Place::Job {
            self.find_job(call, first.as_deref(), next).await
        } else {
            let map = first.as_deref().and_then(|message| map_of(call.parts.uri.path(), message)).map(str::to_owned);
            self.find_map(place, call, map, next).await
        };
        answer.map_err(Status::from)
    }

    /// Answers a request of a map in the daemon where that can be done.
    async fn find_map(
        &self,
        place: Place,
        call: GatewayCall,
        map: Option<String>,
        next: Next,
    ) -> Result<Response, RpcError> {
        // A request without a map is wrong, or about the daemon.
        let Some(map) = map else { return Ok(call.answer(next).await) };
        check_scope(&map)?;
        let handle = self.catalog.get(&map).ok();
        let answerer = if self.is_answered_here(place, &call.parts.headers, &map, handle.as_ref()).await? {
            Answerer::Here
        } else {
            if let Some(by) = call.passed_by() {
                return Err(GatewayError::Moved { map, by }.into());
            }
            self.writer(&map, handle.as_ref(), call.authorization.is_some()).await?
        };
        match answerer {
            Answerer::There { member, address, place } => self.pass(call, (member, &address, place)).await,
            Answerer::Here => {
                let mut reply = call.answer(next).await;
                if let Some(handle) = handle {
                    // An upper bound of what the reply shows. If it were taken before the answer, it could be less than
                    // the reply shows, and a later reply could show less than this one.
                    token(&handle, handle.shown()).put(reply.headers_mut(), SHOWN);
                }
                Ok(reply)
            }
        }
    }

    /// Whether a request of a map can be answered in this daemon. Waits until the map shows what the client has seen.
    async fn is_answered_here(
        &self,
        place: Place,
        headers: &HeaderMap,
        map: &str,
        handle: Option<&Arc<MapHandle>>,
    ) -> Result<bool, GatewayError> {
        // A map that no daemon has is refused here.
        let Some(handle) = handle else { return Ok(!self.peers.may_hold(map)) };
        let role = handle.role();
        if !role.is_shared() || (place == Place::Writer && role.is_writing()) {
            return Ok(true);
        }
        let allows_stale = allows_stale(headers);
        // A map that is being opened shows an older generation, and receives nothing of its log yet.
        let is_open = handle.opening() == OpenProgress::Open;
        if place == Place::Writer || !(is_open || allows_stale) {
            return Ok(false);
        }
        if !role.is_writing() && !allows_stale {
            let max = self.peers.max_staleness();
            let is_fresh = self.peers.last_contact(&handle.spec.name).is_some_and(|time| time.elapsed() <= max);
            if !is_fresh {
                return Err(GatewayError::Stale { map: map.to_owned(), max });
            }
        }
        let Some(wanted) = ReadToken::of(headers, &AT_LEAST)? else { return Ok(true) };
        if handle.shows(|shown| token(handle, shown).reaches(wanted), SHOWN_WITHIN).await {
            return Ok(true);
        }
        // A writer that was cut off may not know yet that it writes no more: it does not show less either.
        if handle.role().is_writing() {
            return Err(GatewayError::Behind { map: map.to_owned(), wanted });
        }
        Ok(false)
    }

    /// The writer of a map, as far as it is known from the map's role or from the other daemons.
    fn known_writer(&self, map: &str, handle: Option<&Arc<MapHandle>>, by_role: Option<String>) -> Option<String> {
        let held = || self.peers.writer_of_held(&handle?.spec.name);
        by_role.or_else(held).or_else(|| self.peers.writer_of(map))
    }

    /// Takes a place on a connection to the daemon at this address.
    async fn place(&self, address: &str, has_token: bool, deadline: tokio::time::Instant) -> Result<PeerPlace, String> {
        match tokio::time::timeout_at(deadline, self.links.place(address, has_token)).await {
            Ok(place) => place.map_err(|error| error.to_string()),
            Err(_) => Err(format!("{address} does not respond")),
        }
    }

    /// A connection to the writer of a map. Waits for a writer that is known and answers.
    async fn writer(
        &self,
        map: &str,
        handle: Option<&Arc<MapHandle>>,
        has_token: bool,
    ) -> Result<Answerer, GatewayError> {
        let deadline = tokio::time::Instant::now() + WRITER_WITHIN;
        let mut role = handle.map(|handle| handle.watch_role());
        let mut silent = None;
        loop {
            let by_role = match role.as_mut().map(|role| role.borrow_and_update().clone()) {
                Some(MapRole::Following { writer }) => writer,
                Some(MapRole::Alone | MapRole::Writing { .. }) => return Ok(Answerer::Here),
                None => None,
            };
            let writer = self.known_writer(map, handle, by_role);
            // A daemon that is about to write knows its own name as that of the writer.
            if let Some(member) = writer.filter(|writer| writer != self.peers.name()) {
                let why = match self.peers.address_of(&member) {
                    None => "its address is not known".to_owned(),
                    Some(address) => match self.place(&address, has_token, deadline).await {
                        Ok(place) => return Ok(Answerer::There { member, address, place }),
                        Err(why) => why,
                    },
                };
                silent = Some((member, why));
            }
            if tokio::time::Instant::now() + CHECK_INTERVAL >= deadline {
                count_failure();
                let map = map.to_owned();
                return Err(match silent {
                    Some((writer, why)) => GatewayError::NoWay { map, writer, why },
                    None => GatewayError::NoWriter { map },
                });
            }
            let changed = async {
                let Some(role) = role.as_mut() else { return std::future::pending().await };
                if role.changed().await.is_err() {
                    std::future::pending::<()>().await;
                }
            };
            // An error means that nothing has changed.
            let _ = tokio::time::timeout(CHECK_INTERVAL, changed).await;
        }
    }

    /// Passes a request to another daemon.
    async fn pass(
        &self,
        call: GatewayCall,
        (member, address, mut place): (String, &str, PeerPlace),
    ) -> Result<Response, RpcError> {
        let GatewayCall { parts, body, authorization } = call;
        let path = parts.uri.path().to_owned();
        let mut request = axum::http::Request::new(tonic::body::Body::new(body));
        *request.method_mut() = axum::http::Method::POST;
        *request.uri_mut() = parts.uri.path_and_query().cloned().map(Into::into).unwrap_or_default();
        *request.headers_mut() = self.passed_headers(&parts.headers, authorization);
        let sent = async {
            std::future::poll_fn(|context| place.channel.poll_ready(context)).await?;
            place.channel.call(request).await
        };
        match sent.await {
            Ok(reply) => {
                metrics::counter!("tidemap_cluster_passed_requests_total").increment(1);
                let end = LASTING.contains(&path.as_str()).then(|| self.stopped());
                Ok(reply.map(|body| Body::new(PassedBody::new(body, member, end, place))))
            }
            Err(error) if is_late(&error) => Err(GatewayError::Late { member }.into()),
            Err(_) => {
                count_failure();
                self.links.forget(address, &place);
                Err(GatewayError::Broke { member }.into())
            }
        }
    }

    fn passed_headers(&self, of_request: &HeaderMap, authorization: Option<KeptAuthorization>) -> HeaderMap {
        let is_passed = |name: &HeaderName| PASSED.contains(name) || name.as_str().starts_with(OWN_PREFIX);
        let kept = of_request.iter().filter(|(name, _)| is_passed(name));
        let mut headers: HeaderMap = kept.map(|(name, value)| (name.clone(), value.clone())).collect();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/grpc"));
        headers.insert(header::TE, HeaderValue::from_static("trailers"));
        let name = HeaderValue::from_str(self.peers.name());
        headers.insert(FORWARDED, name.unwrap_or_else(|_| HeaderValue::from_static("another daemon")));
        if let Some(KeptAuthorization(mut token)) = authorization {
            token.set_sensitive(true);
            headers.insert(header::AUTHORIZATION, token);
        }
        Client::current().name_in(&mut headers, self.secret.as_ref());
        headers
    }

    /// Ready when the daemon stops.
    fn stopped(&self) -> End {
        let mut stopping = self.stopping.clone();
        Box::pin(async move {
            // An error means that the sender is gone, which is a stop as well.
            let _ = stopping.wait_for(|stopping| *stopping).await;
        })
    }
}

fn count_failure() {
    metrics::counter!("tidemap_cluster_pass_failures_total").increment(1);
}

fn allows_stale(headers: &HeaderMap) -> bool {
    headers.get(ALLOW_STALE).is_some_and(|value| value == "1")
}

/// Whether the client's own deadline has passed.
fn is_late(error: &tonic::transport::Error) -> bool {
    let mut cause = std::error::Error::source(error);
    while let Some(error) = cause {
        if error.is::<tonic::TimeoutExpired>() {
            return true;
        }
        cause = error.source();
    }
    false
}
