//! The ports: which callers may connect, and which data each caller may get.
//!
//! Invariant: both ports are bound before anything is served, and stop when they are ordered to.

use std::{net::SocketAddr, sync::Arc, time::Duration};

use anyhow::Context as _;
use rustix::process::{Resource, getrlimit, setrlimit};
use tidemap_base::{
    access::keyring::Keyring,
    config::Settings,
    connections::{
        ConnectionLimits, Connections, HTTP_CONNECTIONS, Port,
        accept::{Accepted, Acceptor, Listener},
        socket::listen_unix,
        tls::{Protocol, Tls, TlsFiles},
    },
};
use tidemap_ingest::{
    catalog::Catalog,
    peers::{PeerTlsFiles, SharedMaps},
};
use tidemap_rpc::{guard::Access, maintenance::PageAddress, serve::Services};
use tidemap_web::{KnownHosts, Recordings};
use tokio::{
    net::TcpListener,
    sync::{mpsc, watch},
    task::JoinHandle,
};
use tracing::{info, warn};

use super::DaemonError;
use crate::{http, reload::FileWatch, storage_watch};

/// Time limit for connections to close after their streams got a goodbye.
const STOP_WITHIN: Duration = Duration::from_secs(5);
/// A connection of the gRPC port without a request for this long may make room for another.
const GRPC_IDLE_AFTER: Duration = Duration::from_secs(60);
/// The bytes of an unread reply that the system keeps; it uses twice as much memory.
const HTTP_SEND_BUFFER_BYTES: usize = 64 << 10;
/// Limits of the reserve of the HTTP port, for probes that check whether the daemon lives.
const PROBE_CONNECTIONS: ConnectionLimits = ConnectionLimits { total: 32, per_client: 4, idle_after: Duration::ZERO };
/// Connections that wait until they are accepted: a whole fleet may come back at once. The system may allow fewer.
const BACKLOG: i32 = 4096;
/// Number of descriptors that connections leave free for files.
const FILE_DESCRIPTORS: usize = 512;

/// The protection of the ports: TLS, and tokens.
pub(super) struct Protection {
    /// The files of TLS, watched from before the first read.
    followed: FileWatch,
    grpc_tls: Option<Tls>,
    http_tls: Option<Tls>,
    /// The check of callers.
    pub access: Access,
}

impl Protection {
    /// Loads the files that the settings name. The file of tokens is watched from now on.
    ///
    /// # Errors
    /// A file cannot be used.
    pub(super) fn load(settings: &Settings) -> Result<Self, DaemonError> {
        let (followed, grpc_tls, http_tls) = load_tls(settings)?;
        Ok(Self { followed, grpc_tls, http_tls, access: load_access(settings)? })
    }
}

/// The files of TLS, watched from before the first read, and the TLS of both ports, if it is configured.
fn load_tls(settings: &Settings) -> Result<(FileWatch, Option<Tls>, Option<Tls>), DaemonError> {
    let files = settings.tls_files();
    let followed = FileWatch::new("certificates", files.as_ref().map_or_else(Vec::new, TlsFiles::paths));
    let load = |protocol| {
        let tls = files.clone().map(|files| Tls::new(files, protocol)).transpose();
        tls.map_err(|error| DaemonError::Settings(error.to_string()))
    };
    Ok((followed, load(Protocol::Http2)?, load(Protocol::Http1)?))
}

/// The check of callers. The file of tokens is watched from now on.
fn load_access(settings: &Settings) -> Result<Access, DaemonError> {
    let path = &settings.tokens_file;
    if path.as_os_str().is_empty() {
        return Ok(Access::Anybody);
    }
    let followed = FileWatch::new("tokens", vec![path.clone()]);
    let keyring = Keyring::open(path.clone()).map_err(|error| DaemonError::Settings(error.to_string()))?;
    let followed_by = keyring.clone();
    tidemap_base::task::spawn(followed.follow(move || followed_by.reload()));
    Ok(Access::Tokens(keyring))
}

/// The maps that the HTTP port serves. Where tokens are required, they decide. Without tokens, the port is read-only,
/// and browsers must reach it by a name that the operator has set.
fn web(
    services: &Services,
    access: &Access,
    settings: &Settings,
    stopping: watch::Receiver<bool>,
) -> anyhow::Result<axum::Router> {
    let hosts = known_hosts(access, settings);
    let access = match access {
        Access::Tokens(_) => access.clone(),
        Access::Anybody if settings.http_write => Access::Anybody,
        Access::Anybody | Access::Readers => Access::Readers,
    };
    let recordings = Recordings::new(settings, services, access.clone(), stopping).context("folder of recordings")?;
    tidemap_web::router(&services.guarded(access.clone()), services.guarded_queries(access), recordings, hosts)
}

/// The names by which browsers may reach the HTTP port; any name, where tokens are required.
pub(super) fn known_hosts(access: &Access, settings: &Settings) -> KnownHosts {
    match access {
        Access::Tokens(_) => KnownHosts::any(),
        Access::Anybody | Access::Readers => KnownHosts::listed(&settings.http_hosts),
    }
}

/// The running ports.
pub(super) struct Ports {
    grpc: JoinHandle<anyhow::Result<()>>,
    http: JoinHandle<anyhow::Result<()>>,
    /// Address of the gRPC port.
    pub grpc_address: SocketAddr,
    /// Address of the HTTP port.
    pub http_address: SocketAddr,
    /// Becomes true when the ports have to stop.
    // This is a channel and not a notification: a port that starts to wait late still sees the stop.
    stop: watch::Sender<bool>,
}

/// The services of the ports.
pub(super) struct Served<'a> {
    pub settings: &'a Settings,
    pub catalog: &'a Arc<Catalog>,
    pub metrics: http::Metrics,
    /// Becomes true when the daemon stops.
    pub stopping: watch::Receiver<bool>,
    /// Receives failures of the storage.
    pub fatal: mpsc::UnboundedSender<String>,
}

impl Ports {
    /// Binds both ports and serves them.
    ///
    /// # Errors
    /// A port or the socket is taken.
    pub(super) async fn serve(served: Served<'_>, protection: Protection) -> Result<Self, DaemonError> {
        let Served { settings, catalog, metrics, stopping, fatal } = served;
        let Protection { followed, grpc_tls, http_tls, access } = protection;
        let [grpc, http] = listen_on_ports(settings).await?;
        let addresses = [&grpc, &http].map(TcpListener::local_addr);
        let [grpc_address, http_address] = addresses.map(|address| address.map_err(anyhow::Error::from));
        let (grpc_address, http_address) = (grpc_address?, http_address?);
        let (stop, ports_stopping) = watch::channel(false);
        let is_local = http_address.ip().is_loopback();
        let has_tls = http_tls.is_some() && !is_local;
        let page = PageAddress { address: http_address, has_tls };
        let shared = shared_maps(settings, catalog)?;
        let services =
            tidemap_rpc::serve::services(Arc::clone(catalog), settings, page, shared, stopping.clone()).await;
        services.health().set_ready(http::readiness(catalog, false).0).await;
        let watched = Arc::downgrade(catalog);
        tidemap_base::task::spawn(storage_watch::run(watched, services.health(), stopping.clone(), fatal));
        let web = web(&services, &access, settings, stopping.clone())?;
        let connections = accept_grpc(settings, grpc, grpc_tls.clone())?;
        let grpc_is_local = grpc_address.ip().is_loopback();
        let grpc =
            tidemap_rpc::serve::serve(connections, access.clone(), services, grpc_is_local, ports_stopping.clone());
        let listeners = accept_http(http, http_tls.clone().filter(|_| has_tls));
        let access = if is_local { Access::Anybody } else { access };
        let http = http::serve(listeners, Arc::clone(catalog), metrics, access, web, stopping, ports_stopping);
        let (grpc, http) = (
            tokio::spawn(grpc),
            tokio::spawn(async move {
                http.await;
                Ok(())
            }),
        );
        let tls: Vec<Tls> = grpc_tls.into_iter().chain(http_tls).collect();
        if !tls.is_empty() {
            tidemap_base::task::spawn(followed.follow(move || tls.iter().try_for_each(Tls::reload)));
        }
        Ok(Self { grpc, http, grpc_address, http_address, stop })
    }

    /// Waits until a port closes. A port that closes before [`Ports::stop`] has failed.
    pub(super) async fn closed(&mut self) -> DaemonError {
        let (name, ended) = tokio::select! {
            ended = &mut self.grpc => ("gRPC", ended),
            ended = &mut self.http => ("HTTP", ended),
        };
        DaemonError::Other(anyhow::anyhow!("the {name} port closed: {ended:?}"))
    }

    /// Stops the ports. For any reason of the stop, a client with an open stream is notified before the process ends.
    pub(super) async fn stop(self) {
        self.stop.send_replace(true);
        let closed = async {
            for task in [self.grpc, self.http] {
                // A task that has ended must not be awaited again.
                if !task.is_finished() {
                    let _ = task.await;
                }
            }
        };
        // A client that keeps its connection open does not keep the daemon running.
        if tokio::time::timeout(STOP_WITHIN, closed).await.is_err() {
            info!("open connections are closed");
        }
    }
}

/// The daemons that share maps with this one.
pub(super) fn shared_maps(settings: &Settings, catalog: &Catalog) -> Result<Option<SharedMaps>, DaemonError> {
    let Some(cluster) = catalog.context().cluster.clone() else { return Ok(None) };
    let ca = &cluster.settings().peer_ca;
    let tls = if ca.as_os_str().is_empty() {
        None
    } else {
        let identity = settings.tls_files().map(|files| (files.certificate, files.key));
        let files = PeerTlsFiles { ca: ca.clone(), identity };
        files.read().map_err(|error| DaemonError::Settings(error.to_string()))?;
        Some(files)
    };
    let tokens_in_clear = settings.allow_insecure_remote;
    Ok(Some(SharedMaps { peers: Arc::new(cluster), tls, tokens_in_clear }))
}

/// The connections of the gRPC port and of its socket.
fn accept_grpc(
    settings: &Settings,
    port: TcpListener,
    tls: Option<Tls>,
) -> Result<mpsc::Receiver<std::io::Result<Accepted>>, DaemonError> {
    let connections = Connections::new(Port::Grpc, connection_limits(settings));
    let (acceptor, accepted) = Acceptor::new(connections);
    acceptor.listen(Listener::Tcp(port, tls));
    if !settings.socket.as_os_str().is_empty() {
        let socket = listen_unix(&settings.socket, settings.socket_mode);
        let address = || settings.socket.display().to_string();
        let socket = socket.map_err(|source| DaemonError::Listen { address: address(), option: "socket", source })?;
        acceptor.listen(Listener::Unix(socket));
    }
    Ok(accepted)
}

/// The connections of the HTTP port, and those of its reserve.
fn accept_http(port: TcpListener, tls: Option<Tls>) -> [mpsc::Receiver<std::io::Result<Accepted>>; 2] {
    // Replies wait where they are counted, and not in the system, whose memory also belongs to the pod.
    if let Err(error) = rustix::net::sockopt::set_socket_send_buffer_size(&port, HTTP_SEND_BUFFER_BYTES) {
        warn!(%error, "the system does not limit the memory of unread replies");
    }
    let (acceptor, accepted) = Acceptor::new(Connections::new(Port::Http, HTTP_CONNECTIONS));
    let (acceptor, in_reserve) = acceptor.with_reserve(Connections::new(Port::Probes, PROBE_CONNECTIONS));
    acceptor.listen(Listener::Tcp(port, tls));
    [accepted, in_reserve]
}

/// The limits of the gRPC port. The process may open as many descriptors as its hard limit allows; if that is too few
/// for all connections, there are fewer.
fn connection_limits(settings: &Settings) -> ConnectionLimits {
    let mut limit = getrlimit(Resource::Nofile);
    let wanted = (settings.max_connections + FILE_DESCRIPTORS) as u64;
    if limit.current.is_some_and(|current| current < wanted) {
        limit.current = Some(limit.maximum.map_or(wanted, |maximum| maximum.min(wanted)));
        if let Err(error) = setrlimit(Resource::Nofile, limit) {
            warn!(%error, "the limit of descriptors cannot be raised");
        }
    }
    let descriptors = getrlimit(Resource::Nofile).current.map_or(usize::MAX, |current| current as usize);
    // With very few descriptors, half of them are for files.
    let room = descriptors.saturating_sub(FILE_DESCRIPTORS).max(descriptors / 2);
    let total = settings.max_connections.min(room);
    if total < settings.max_connections {
        let max = settings.max_connections;
        warn!(total, max, "the limit of descriptors allows fewer connections than max_connections");
    }
    ConnectionLimits { total, per_client: settings.max_connections_per_client, idle_after: GRPC_IDLE_AFTER }
}

/// Binds the ports.
///
/// # Errors
/// A port is taken.
pub(super) async fn listen_on_ports(settings: &Settings) -> Result<[TcpListener; 2], DaemonError> {
    let listen = async |address: &str, option| {
        let listener = TcpListener::bind(address).await.and_then(|listener| {
            // A second call changes the number of connections that may wait.
            rustix::net::listen(&listener, BACKLOG)?;
            Ok(listener)
        });
        listener.map_err(|source| DaemonError::Listen { address: address.to_owned(), option, source })
    };
    Ok([listen(&settings.listen, "--listen").await?, listen(&settings.http_listen, "--http-listen").await?])
}
