//! Opens the store, starts the maps and the ports, and stops them in order.
//!
//! Invariant: the line `listening …` is printed only when requests are served. A stop acknowledges what is in flight,
//! closes the store and ends, whatever clients and the disk do: each step has its deadline.

use std::{io::Write as _, os::unix::fs::PermissionsExt as _, path::Path, sync::Arc, time::Duration};

use rustix::{
    fs::Mode,
    process::{Resource, getrlimit, setrlimit, umask},
};
use tidemap_map::live_map::PendingLimits;
use tidemap_model::time::format_rfc3339;
use tidemap_store::{CommitStep, OpenError, Store, StoreOptions, disk::Disk};
use tokio::{
    net::TcpListener,
    signal::unix::{SignalKind, signal},
    sync::{mpsc, oneshot, watch},
};
use tracing::{error, info, warn};

use crate::{
    access::keyring::Keyring,
    backups::Schedule,
    catalog::{Catalog, CatalogError, RESTORED_FIRST_BYTES},
    clock::SystemClock,
    config::Settings,
    connections::{
        ConnectionLimits, Connections, Port,
        accept::{Acceptor, HttpListener, Listener},
        request_scan::Protocol,
        socket::listen_unix,
        tls::{Tls, TlsFiles},
    },
    http,
    ingest::writer::Context,
    jobs::Jobs,
    reload::FileWatch,
    rpc::{self, guard::Access, serve::Services},
    scrubber::Scrubber,
    silent_producers::SilentProducers,
    storage_watch,
    telemetry::{
        self,
        traces::{Span, Traces},
    },
    web::{self, KnownHosts},
};

/// Time for connections to close after their streams got a goodbye.
const STOP_WITHIN: Duration = Duration::from_secs(5);
/// Time for the maps to make durable what is in flight.
const MAPS_STOP_WITHIN: Duration = Duration::from_secs(10);
/// Time for the store to close.
const CLOSE_WITHIN: Duration = Duration::from_secs(10);

/// A connection of the gRPC port without a request for this long may make room for another.
const GRPC_IDLE_AFTER: Duration = Duration::from_secs(60);
/// Limits of the HTTP port. Browsers and scripts connect again where they find an idle connection closed.
const HTTP_CONNECTIONS: ConnectionLimits =
    ConnectionLimits { total: 256, per_client: 128, idle_after: Duration::from_secs(1) };
/// Limits of its reserve, for those who ask whether the daemon lives.
const PROBE_CONNECTIONS: ConnectionLimits = ConnectionLimits { total: 32, per_client: 4, idle_after: Duration::ZERO };
/// Connections that wait until they are accepted: a whole fleet may come back at once. The system may allow fewer.
const BACKLOG: i32 = 4096;
/// Descriptors that connections leave to files.
const FILE_DESCRIPTORS: usize = 512;

/// Why the daemon ended; each error has its exit status.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DaemonError {
    #[error("{0}")]
    Locked(String),
    #[error("{0}")]
    Data(String),
    #[error("{0}")]
    Settings(String),
    #[error("cannot listen on {address}: {source}. Choose another with {option}")]
    Listen { address: String, option: &'static str, source: std::io::Error },
    #[error("storage failed, and nothing after the last acknowledgement was kept: {0}")]
    Storage(String),
    #[error("{0:#}")]
    Other(#[from] anyhow::Error),
}

impl DaemonError {
    /// Exit status as in sysexits.h.
    pub(crate) fn exit_status(&self) -> u8 {
        match self {
            Self::Locked(_) => 73,
            Self::Data(_) => 65,
            Self::Listen { .. } => 69,
            Self::Storage(_) => 74,
            Self::Settings(_) => 78,
            Self::Other(_) => 70,
        }
    }
}

impl From<CatalogError> for DaemonError {
    fn from(error: CatalogError) -> Self {
        match error {
            // The data is sound; the machine lacks resources.
            CatalogError::Thread(_) => Self::Other(error.into()),
            _ => Self::Data(error.to_string()),
        }
    }
}

fn open_store(settings: &Settings, disk: Arc<dyn Disk>) -> Result<Store, DaemonError> {
    let options = StoreOptions {
        segment_bytes: settings.segment_bytes,
        index_cache_bytes: settings.index_cache_bytes,
        checkpoints_kept: settings.checkpoints_kept,
        tile_cache_bytes: settings.tile_cache_bytes,
        spectrum_cache_bytes: settings.spectrum_cache_bytes,
        new_store_id: random_id()?,
        expected_store_id: Some(settings.expect_store_id.clone()).filter(|id| !id.is_empty()),
    };
    Store::open_on(disk, &settings.data_dir, options).map_err(|error| match error {
        OpenError::Locked { .. } => DaemonError::Locked(error.to_string()),
        _ => DaemonError::Data(error.to_string()),
    })
}

/// The files of TLS, followed from before they are read, and the TLS of both ports, if it is configured.
fn load_tls(settings: &Settings) -> Result<(FileWatch, Option<Tls>, Option<Tls>), DaemonError> {
    let files = settings.tls_files();
    let followed = FileWatch::new("certificates", files.as_ref().map_or_else(Vec::new, TlsFiles::paths));
    let load = |protocol| {
        let tls = files.clone().map(|files| Tls::new(files, protocol)).transpose();
        tls.map_err(|error| DaemonError::Settings(error.to_string()))
    };
    Ok((followed, load(Protocol::Http2)?, load(Protocol::Http1)?))
}

/// How callers are checked. The file of tokens is followed from now on.
fn load_access(settings: &Settings) -> Result<Access, DaemonError> {
    let path = &settings.tokens_file;
    if path.as_os_str().is_empty() {
        return Ok(Access::Anybody);
    }
    let followed = FileWatch::new("tokens", vec![path.clone()]);
    let keyring = Keyring::open(path.clone()).map_err(|error| DaemonError::Settings(error.to_string()))?;
    let followed_by = keyring.clone();
    tokio::spawn(followed.follow(move || followed_by.reload()));
    Ok(Access::Tokens(keyring))
}

/// What the HTTP port serves of maps. Where tokens are asked for, they decide; without, the port is for reading, and
/// browsers must reach it by a name that the operator knows.
fn web(services: &Services, access: &Access, settings: &Settings) -> anyhow::Result<axum::Router> {
    let hosts = known_hosts(access, settings);
    let access = match access {
        Access::Tokens(_) => access.clone(),
        Access::Anybody if settings.http_write => Access::Anybody,
        Access::Anybody | Access::Readers => Access::Readers,
    };
    web::router(&services.guarded(access), hosts)
}

/// The names by which browsers may reach the HTTP port; any, where tokens are asked for.
fn known_hosts(access: &Access, settings: &Settings) -> KnownHosts {
    match access {
        Access::Tokens(_) => KnownHosts::any(),
        Access::Anybody | Access::Readers => KnownHosts::listed(&settings.http_hosts),
    }
}

/// Takes the permissions of other users on the data folder away, which an earlier version or a copy may have given.
fn close_to_others(folder: &Path) {
    let mode = match std::fs::metadata(folder) {
        Ok(metadata) => metadata.permissions().mode() & 0o777,
        Err(error) => return warn!(%error, "the permissions of the data folder cannot be read"),
    };
    if mode & 0o077 == 0 {
        return;
    }
    match std::fs::set_permissions(folder, std::fs::Permissions::from_mode(0o700)) {
        Ok(()) => warn!("the data folder was open to others with permissions {mode:o}; now they are 700"),
        Err(error) => {
            warn!(%error, "the data folder is open to others with permissions {mode:o}, which cannot be changed");
        }
    }
}

/// 16 bytes of the system's randomness as hex: the identity of a new data folder.
pub(crate) fn random_id() -> anyhow::Result<String> {
    let mut bytes = [0u8; 16];
    let random =
        std::fs::File::open("/dev/urandom").and_then(|mut file| std::io::Read::read_exact(&mut file, &mut bytes));
    anyhow::Context::context(random, "/dev/urandom")?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Writes to the log which folder was opened, and what was found in it.
fn tell_state(store: &Store, folder: &Path) {
    let (id, folder) = (store.store_id(), folder.display());
    if store.is_new() {
        warn!(
            "{folder} is a new data folder, with the store id {id}. If it should have held data: is its disk mounted? To \
             refuse any other folder from now on, put this line into the config file: expect_store_id = \"{id}\""
        );
    }
    for report in store.reports() {
        warn!("{report}");
    }
    for trouble in store.trouble() {
        error!("{trouble}");
    }
    match store.losses() {
        Ok(losses) => losses.iter().for_each(|loss| {
            let accepted = format_rfc3339(loss.accepted_nanos);
            warn!(file = loss.file, accepted, "accepted as lost: {}", loss.problem);
        }),
        Err(error) => error!(%error, "the record of accepted losses cannot be read"),
    }
}

/// Runs the daemon on a disk until it is stopped.
///
/// # Errors
/// See [`DaemonError`].
pub(crate) async fn run(settings: Settings, disk: Arc<dyn Disk>) -> Result<(), DaemonError> {
    // Whatever the daemon was started with: what robots saw is nobody else's business.
    umask(Mode::RWXG | Mode::RWXO);
    let recorder = telemetry::start_metrics()?;
    let traces = Traces::start(&settings.otlp_endpoint, settings.trace_ratio)?;
    let (followed, grpc_tls, http_tls) = load_tls(&settings)?;
    let access = load_access(&settings)?;
    let metrics = http::Metrics {
        handle: recorder,
        data_dir: settings.data_dir.clone(),
        backups: Schedule::of(&settings),
        silent: Arc::new(SilentProducers::new(settings.metrics_max_producers)),
        names_for: access.clone(),
        hosts: known_hosts(&access, &settings),
    };
    let mut terminate = signal(SignalKind::terminate()).map_err(anyhow::Error::from)?;
    let mut interrupt = signal(SignalKind::interrupt()).map_err(anyhow::Error::from)?;
    // Of a folder that exists, its lock says more than a port in use: a second daemon. A new one is not even made.
    if !settings.data_dir.exists() {
        drop(listen_on_ports(&settings).await?);
    }
    let for_store = settings.clone();
    let store =
        tokio::task::spawn_blocking(move || open_store(&for_store, disk)).await.map_err(anyhow::Error::from)??;
    close_to_others(&settings.data_dir);
    telemetry::tell_build(store.store_id());
    tell_state(&store, &settings.data_dir);
    let update_pool = rayon::ThreadPoolBuilder::new()
        .num_threads(settings.update_threads())
        .thread_name(|index| format!("learn-{index}"))
        .build()
        .map_err(anyhow::Error::from)?;
    let (fatal_sender, mut fatal) = mpsc::unbounded_channel();
    let storage_failed = fatal_sender.clone();
    let context = Context {
        store: Arc::new(store),
        jobs: Arc::new(Jobs::default()),
        clock: Arc::new(SystemClock),
        update_pool: Arc::new(update_pool),
        fatal: fatal_sender,
        max_states: settings.max_states_per_map,
        max_producers: settings.max_producers_per_map,
        max_pending: PendingLimits {
            observations: settings.max_pending_observations,
            changes: settings.max_pending_changes,
        },
        update_at_midnight: settings.update_at_midnight,
        max_tiles: settings.max_tiles_per_map,
        tile_cache_bytes: settings.tile_cache_bytes,
    };
    let store = Arc::clone(&context.store);
    let max_maps = settings.max_maps;
    let open = move || Catalog::open(context, max_maps, RESTORED_FIRST_BYTES);
    let (catalog, rest) = tokio::task::spawn_blocking(open).await.map_err(anyhow::Error::from)??;
    let catalog = Arc::new(catalog);

    follow_commits(&catalog);

    let (stop_sender, stopping) = watch::channel(false);
    let [grpc, http] = listen_on_ports(&settings).await?;
    let (grpc_address, http_address) =
        (grpc.local_addr().map_err(anyhow::Error::from)?, http.local_addr().map_err(anyhow::Error::from)?);
    // A channel and not a notification: a port that starts to wait late still sees the stop.
    let (stop_ports, ports_stopping) = watch::channel(false);
    let services = rpc::serve::services(Arc::clone(&catalog), &settings, stopping.clone()).await;
    services.health().tell(http::readiness(&catalog, false).0).await;
    let watched = Arc::downgrade(&catalog);
    tokio::spawn(storage_watch::run(watched, services.health(), stopping.clone(), storage_failed));
    let web = web(&services, &access, &settings)?;
    let (grpc_acceptor, grpc_connections) =
        Acceptor::new(Connections::new(Port::Grpc, connection_limits(&settings)), Protocol::Http2);
    grpc_acceptor.listen(Listener::Tcp(grpc, grpc_tls.clone()));
    if !settings.socket.as_os_str().is_empty() {
        let socket = listen_unix(&settings.socket, settings.socket_mode);
        let address = || settings.socket.display().to_string();
        let socket = socket.map_err(|source| DaemonError::Listen { address: address(), option: "socket", source })?;
        grpc_acceptor.listen(Listener::Unix(socket));
    }
    let is_local = grpc_address.ip().is_loopback();
    let mut grpc_task =
        tokio::spawn(rpc::serve::serve(grpc_connections, access.clone(), services, is_local, ports_stopping.clone()));
    let (http_acceptor, accepted) = Acceptor::new(Connections::new(Port::Http, HTTP_CONNECTIONS), Protocol::Http1);
    let (http_acceptor, in_reserve) = http_acceptor.with_reserve(Connections::new(Port::Probes, PROBE_CONNECTIONS));
    http_acceptor.listen(Listener::Tcp(http, http_tls.clone().filter(|_| !http_address.ip().is_loopback())));
    let http_access = if http_address.ip().is_loopback() { Access::Anybody } else { access };
    let http = [accepted, in_reserve].map(|accepted| HttpListener { address: http_address, accepted });
    let mut http_task =
        tokio::spawn(http::serve(http, Arc::clone(&catalog), metrics, http_access, web, stopping, ports_stopping));
    let tls: Vec<Tls> = grpc_tls.into_iter().chain(http_tls).collect();
    if !tls.is_empty() {
        tokio::spawn(followed.follow(move || tls.iter().try_for_each(Tls::reload)));
    }
    println!("listening grpc={grpc_address} http={http_address}");
    // A closed stdout is no reason to stop.
    let _ = std::io::stdout().flush();
    info!(grpc = %grpc_address, http = %http_address, data = %settings.data_dir.display(), store_id = store.store_id(), "ready");

    let scrubber = Scrubber::start(&store, &settings);
    if let Some(schedule) = Schedule::of(&settings) {
        tokio::spawn(schedule.run(Arc::clone(&catalog), stop_sender.subscribe()));
    }
    let restoring = Arc::clone(&catalog);
    let restored = tokio::task::spawn_blocking(move || restoring.restore_rest(rest));
    let cannot_restore = async {
        match restored.await {
            Ok(Err(error)) => DaemonError::from(error),
            Err(error) => DaemonError::Other(error.into()),
            Ok(Ok(())) => std::future::pending().await,
        }
    };
    let result = tokio::select! {
        _ = terminate.recv() => Ok(()),
        _ = interrupt.recv() => Ok(()),
        error = cannot_restore => Err(error),
        Some(reason) = fatal.recv() => Err(DaemonError::Storage(reason)),
        ended = &mut grpc_task => Err(DaemonError::Other(anyhow::anyhow!("the gRPC port closed: {ended:?}"))),
        ended = &mut http_task => Err(DaemonError::Other(anyhow::anyhow!("the HTTP port closed: {ended:?}"))),
    };
    info!("stopping");
    drop(scrubber);
    stop_sender.send_replace(true);
    if tokio::time::timeout(MAPS_STOP_WITHIN, catalog.stop()).await.is_err() {
        warn!("maps did not stop within {} seconds; nothing acknowledged is lost", MAPS_STOP_WITHIN.as_secs());
    }
    stop_ports.send_replace(true);
    // Whatever the daemon ends of: who has an open stream is told before the process is gone.
    let closed = async {
        for task in [grpc_task, http_task] {
            // What has ended must not be asked again.
            if !task.is_finished() {
                let _ = task.await;
            }
        }
    };
    // A client that keeps its connection open does not keep the daemon running.
    if tokio::time::timeout(STOP_WITHIN, closed).await.is_err() {
        info!("open connections are closed");
    }
    close(store).await;
    traces.stop().await;
    result
}

/// Makes a span of each group commit.
fn follow_commits(catalog: &Arc<Catalog>) {
    // Weak, because the catalog holds the store.
    let maps = Arc::downgrade(catalog);
    catalog.context().store.follow_commits(Box::new(move |map, records, bytes| {
        let span = Span::root("commit");
        if span.is_recorded()
            && let Some(maps) = maps.upgrade()
            && let Some(handle) = maps.all().values().find(|handle| handle.id == map)
        {
            span.text("tidemap.map", &handle.spec.name);
        }
        span.number("tidemap.records", records as u64);
        span.number("tidemap.bytes", bytes);
        let mut part = span.child("write");
        Box::new(move |step| {
            part.end();
            match step {
                CommitStep::Written => part = span.child("fdatasync"),
                CommitStep::Durable => span.end(),
                CommitStep::Failed => {
                    span.fail("not durable: the log says why");
                    span.end();
                }
            }
        })
    }));
}

/// Closes the store, in a thread of its own, because all threads of the runtime may wait for a disk that hangs.
async fn close(store: Arc<Store>) {
    let (done, closed) = oneshot::channel();
    let thread = std::thread::Builder::new().name("close".to_owned()).spawn(move || {
        store.close();
        // After the deadline nobody waits.
        let _ = done.send(());
    });
    if let Err(error) = thread {
        error!(%error, "the store was not closed; the next start repairs it");
        return;
    }
    match tokio::time::timeout(CLOSE_WITHIN, closed).await {
        Ok(Ok(())) => info!("stopped"),
        Ok(Err(_)) => error!("the store did not close in order; the next start repairs it"),
        Err(_) => {
            let secs = CLOSE_WITHIN.as_secs();
            error!("the store did not close within {secs} seconds; the next start repairs it");
        }
    }
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

async fn listen_on_ports(settings: &Settings) -> Result<[TcpListener; 2], DaemonError> {
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
