//! Tests with daemons in one process that share a map: which requests each answers, and which it passes on.

use std::{
    collections::HashMap,
    convert::Infallible,
    path::Path,
    pin::Pin,
    sync::Mutex,
    task::{Context as TaskContext, Poll},
    time::Instant,
};

use tidemap_base::{clock::SystemClock, config::Settings};
use tidemap_cluster::replica::ReplicaEvent;
use tidemap_ingest::{catalog::UnopenedMap, jobs::Jobs, protocol::Command, writer::Context};
use tidemap_map::{name::MapName, spec::MapSpec};
use tidemap_model::Zone;
use tidemap_proto::v1::{
    self, maintenance_service_client::MaintenanceServiceClient, map_service_client::MapServiceClient,
};
use tidemap_store::{Store, StoreOptions};
use tokio::{net::TcpListener, sync::mpsc};
use tonic::{
    Code,
    codegen::Service,
    transport::{Channel, Server, server::TcpIncoming},
};
use tonic_types::StatusExt as _;

use super::*;
use crate::{guard::Access, maintenance::PageAddress, serve::services};

mod forward;
mod openings;
mod passing;
mod streams;
mod tokens;
mod views;

/// The knowledge of a daemon about the others, as the test sets it.
#[derive(Debug)]
struct Known {
    name: String,
    addresses: Mutex<HashMap<String, String>>,
    writers: Mutex<HashMap<String, String>>,
    /// The writer of the maps that are held.
    writer_of_held: Mutex<Option<String>>,
    last_contact: Mutex<Option<Instant>>,
}

impl Peers for Known {
    fn name(&self) -> &str {
        &self.name
    }

    fn address_of(&self, member: &str) -> Option<String> {
        self.addresses.lock().expect("not poisoned").get(member).cloned()
    }

    fn others(&self) -> Vec<String> {
        self.addresses.lock().expect("not poisoned").keys().filter(|member| **member != self.name).cloned().collect()
    }

    fn may_hold(&self, map: &str) -> bool {
        self.writer_of(map).is_some()
    }

    fn writer_of(&self, map: &str) -> Option<String> {
        self.writers.lock().expect("not poisoned").get(map).cloned()
    }

    fn writer_of_held(&self, _: &MapName) -> Option<String> {
        self.writer_of_held.lock().expect("not poisoned").clone()
    }

    fn last_contact(&self, _: &MapName) -> Option<Instant> {
        *self.last_contact.lock().expect("not poisoned")
    }

    fn max_staleness(&self) -> Duration {
        Duration::from_secs(3600)
    }
}

/// A daemon with its gRPC port.
struct Member {
    catalog: Arc<Catalog>,
    known: Arc<Known>,
    address: String,
    stop: watch::Sender<bool>,
    _dir: tempfile::TempDir,
}

impl Member {
    async fn start(name: &str) -> Self {
        let dir = tempfile::tempdir().expect("temporary folder");
        Self::start_in(name, dir, u64::MAX, Access::Anybody).await.0
    }

    /// Starts a daemon, and returns the maps that are still to be restored: those with more bytes of checkpoints and
    /// log.
    async fn start_in(
        name: &str,
        dir: tempfile::TempDir,
        restored_first_bytes: u64,
        access: Access,
    ) -> (Self, Vec<UnopenedMap>) {
        Self::make(name, dir, Making { restored_first_bytes, access, max_states: 100, ignores_seen: false }).await
    }

    async fn make(name: &str, dir: tempfile::TempDir, making: Making) -> (Self, Vec<UnopenedMap>) {
        let Making { restored_first_bytes, access, max_states, ignores_seen } = making;
        let context = Context {
            store: Arc::new(store(dir.path())),
            jobs: Arc::new(Jobs::of_member(name)),
            clock: Arc::new(SystemClock),
            update_turns: Arc::new(tidemap_ingest::update_turns::UpdateTurns::new(1)),
            fatal: mpsc::unbounded_channel().0,
            forks: mpsc::unbounded_channel().0,
            max_states,
            max_producers: 10,
            max_producers_of_client: 10,
            max_pending: tidemap_map::live_map::PendingLimits { observations: 1_000_000, changes: 1_000_000 },
            update_readings_max: tidemap_map::update::UPDATE_READINGS_MAX,
            update_at_midnight: false,
            max_tiles: 20,
            tile_cache_bytes: 1 << 30,
            cluster: None,
        };
        let (catalog, unopened) = Catalog::open(context, 10, restored_first_bytes).expect("maps");
        let catalog = Arc::new(catalog);
        let known = Arc::new(Known {
            name: name.to_owned(),
            addresses: Mutex::default(),
            writers: Mutex::default(),
            writer_of_held: Mutex::default(),
            last_contact: Mutex::new(Some(Instant::now())),
        });
        let (stop, stopping) = watch::channel(false);
        let page = PageAddress { address: ([127, 0, 0, 1], 1).into(), has_tls: false };
        let shared = SharedMaps { peers: Arc::clone(&known) as Arc<dyn Peers>, tls: None, tokens_in_clear: false };
        let services = services(Arc::clone(&catalog), &Settings::default(), page, Some(shared), stopping).await;
        let address = serve(SeenFilter { inner: services.guarded(access), ignores_seen }).await;
        let member = Self { catalog, known, address, stop, _dir: dir };
        member.knows(name, &member.address);
        (member, unopened)
    }

    /// Two daemons that hold the map `office`: `a` follows, and `b` writes.
    async fn pair() -> (Self, Self) {
        let (a, b) = (Self::start("a").await, Self::start("b").await);
        for member in [&a, &b] {
            member.create().await;
        }
        a.knows("b", &b.address);
        b.knows("a", &a.address);
        a.notify(ReplicaEvent::Following { writer: Some("b".to_owned()) }).await;
        b.notify(ReplicaEvent::Writing { epoch: 1 }).await;
        (a, b)
    }

    async fn create(&self) {
        self.catalog.create(spec()).await.expect("created");
    }

    fn knows(&self, member: &str, address: &str) {
        self.known.addresses.lock().expect("not poisoned").insert(member.to_owned(), address.to_owned());
    }

    fn handle(&self) -> Arc<MapHandle> {
        self.catalog.get("office").expect("the map")
    }

    /// Passes an event of the map's replica, and waits until the map has its role.
    async fn notify(&self, event: ReplicaEvent) {
        let handle = self.handle();
        let role = match &event {
            ReplicaEvent::Following { writer } => MapRole::Following { writer: writer.clone() },
            ReplicaEvent::Writing { epoch } => MapRole::Writing { epoch: *epoch },
            other => panic!("no role: {other:?}"),
        };
        handle.send(Command::Replica(event));
        handle.watch_role().wait_for(|now| *now == role).await.expect("the map is open");
    }

    async fn channel(&self) -> Channel {
        let endpoint = Channel::from_shared(self.address.clone()).expect("an address").tcp_nodelay(true);
        endpoint.connect().await.expect("it listens")
    }

    async fn maps(&self) -> MapServiceClient<Channel> {
        MapServiceClient::new(self.channel().await)
    }

    async fn jobs(&self) -> MaintenanceServiceClient<Channel> {
        MaintenanceServiceClient::new(self.channel().await)
    }

    /// The states that a request to this daemon shows, and the token that the reply contains.
    async fn states(&self, at_least: Option<ReadToken>) -> Result<(Vec<String>, ReadToken), Status> {
        let mut request = tonic::Request::new(v1::ListStatesRequest { map: "office".to_owned(), ..Default::default() });
        mark(&mut request, at_least);
        let reply = self.maps().await.list_states(request).await?;
        let shown = shown(reply.metadata());
        Ok((reply.into_inner().states.into_iter().map(|state| state.name).collect(), shown))
    }

    async fn add_state(&self, state: &str) -> Result<tonic::Response<v1::AddStateResponse>, Status> {
        self.maps().await.add_state(new_state(state)).await
    }
}

/// The settings with which a daemon is made.
struct Making {
    restored_first_bytes: u64,
    access: Access,
    max_states: usize,
    /// A planted defect: the daemon ignores what its clients have seen.
    ignores_seen: bool,
}

/// A service that receives, or with the defect does not receive, what clients have seen.
#[derive(Clone, Debug)]
struct SeenFilter<S> {
    inner: S,
    ignores_seen: bool,
}

impl<S: Service<http::Request<tonic::body::Body>>> Service<http::Request<tonic::body::Body>> for SeenFilter<S> {
    type Response = S::Response;
    type Error = S::Error;
    type Future = S::Future;

    fn poll_ready(&mut self, context: &mut TaskContext<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, mut request: http::Request<tonic::body::Body>) -> S::Future {
        if self.ignores_seen {
            request.headers_mut().remove(AT_LEAST);
        }
        self.inner.call(request)
    }
}

fn store(dir: &Path) -> Store {
    let options = StoreOptions { new_store_id: "00".repeat(16), ..StoreOptions::default() };
    Store::open(dir, options).expect("a store")
}

fn spec() -> MapSpec {
    let name = MapName::new("office").expect("valid");
    MapSpec { zone: Zone::named("Europe/London").expect("known"), ..MapSpec::new(name) }
}

fn new_state(name: &str) -> v1::AddStateRequest {
    v1::AddStateRequest { map: "office".to_owned(), state: name.to_owned(), ..v1::AddStateRequest::default() }
}

fn mark<T>(request: &mut tonic::Request<T>, at_least: Option<ReadToken>) {
    if let Some(token) = at_least {
        let mut headers = HeaderMap::new();
        token.put(&mut headers, AT_LEAST);
        *request.metadata_mut() = tonic::metadata::MetadataMap::from_headers(headers);
    }
}

fn shown(metadata: &tonic::metadata::MetadataMap) -> ReadToken {
    ReadToken::of(metadata.as_ref(), &SHOWN).expect("a token").expect("the reply has what it shows")
}

/// Serves on a free port; returns its address.
async fn serve<S>(service: S) -> String
where
    S: Service<http::Request<tonic::body::Body>, Response = http::Response<tonic::body::Body>, Error = Infallible>
        + Clone
        + Send
        + 'static,
    S::Future: Send + 'static,
{
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = format!("http://{}", listener.local_addr().expect("an address"));
    let serving = Server::builder().serve_with_incoming(service, TcpIncoming::from(listener).with_nodelay(Some(true)));
    drop(tokio::spawn(serving));
    address
}

/// The reason of an error, for programs.
fn reason(status: &Status) -> (Code, String) {
    (status.code(), status.get_details_error_info().map(|info| info.reason).unwrap_or_default())
}

/// A writer that records what it receives, and never answers.
#[derive(Clone, Debug)]
struct Silent {
    heads: mpsc::UnboundedSender<HeaderMap>,
    left: mpsc::UnboundedSender<()>,
}

/// Sends a message when it is dropped.
struct ReportLeft(mpsc::UnboundedSender<()>);

impl Drop for ReportLeft {
    fn drop(&mut self) {
        // The test may have ended.
        let _ = self.0.send(());
    }
}

impl Service<http::Request<tonic::body::Body>> for Silent {
    type Response = http::Response<tonic::body::Body>;
    type Error = Infallible;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, Infallible>> + Send>>;

    fn poll_ready(&mut self, _: &mut TaskContext<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, request: http::Request<tonic::body::Body>) -> Self::Future {
        let _ = self.heads.send(request.headers().clone());
        let left = ReportLeft(self.left.clone());
        Box::pin(async move {
            let _held = (request, left);
            std::future::pending().await
        })
    }
}
