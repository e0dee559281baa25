//! Opens the store, starts the maps and the ports, and stops them in order.
//!
//! Invariant: the line `listening …` is printed only when requests are served. A stop acknowledges the records in
//! flight, closes the store and ends, whatever clients and the disk do: each step has its deadline.

use std::{io::Write as _, sync::Arc, time::Duration};

use rustix::{fs::Mode, process::umask};
use tidemap_base::{
    config::Settings,
    random_id::random_id,
    telemetry::{self, traces::Traces},
};
use tidemap_ingest::{
    backups::Schedule,
    catalog::{Catalog, CatalogError, UnopenedMap},
    cluster::{Cluster, ClusterStart},
};
use tidemap_model::InstructionSet;
use tidemap_rpc::copies::CopyClient;
use tidemap_store::{Store, disk::Disk};
use tokio::{
    signal::unix::{SignalKind, signal},
    sync::{mpsc, oneshot, watch},
};
use tracing::{error, info, warn};

use crate::{http, scrubber::Scrubber, silent_producers::SilentProducers};

mod copying;
mod keeping;
mod opening;
mod ports;

use opening::{open_catalog, open_store};
use ports::{Ports, Protection, Served, known_hosts, listen_on_ports};

/// Time limit for the maps to make the records in flight durable.
const MAPS_STOP_WITHIN: Duration = Duration::from_secs(10);
/// Time limit for the store to close.
const CLOSE_WITHIN: Duration = Duration::from_secs(10);

/// The reason why the daemon ended; each error has its exit status.
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
    /// The exit status, as in sysexits.h.
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

/// Runs the daemon on a disk until it is stopped.
///
/// # Errors
/// See [`DaemonError`].
pub(crate) async fn run(settings: Settings, disk: Arc<dyn Disk>) -> Result<(), DaemonError> {
    // This overrides the umask of the caller: other users must not read the robots' observations.
    umask(Mode::RWXG | Mode::RWXO);
    let recorder = telemetry::start_metrics()?;
    let traces = Traces::start(&settings.otlp_endpoint, settings.trace_ratio)?;
    let protection = Protection::load(&settings)?;
    let metrics = http::Metrics {
        handle: recorder,
        data_dir: settings.data_dir.clone(),
        backups: Schedule::of(&settings),
        silent: Arc::new(SilentProducers::new(settings.metrics_max_producers)),
        names_for: protection.access.clone(),
        hosts: known_hosts(&protection.access, &settings),
    };
    let mut terminate = signal(SignalKind::terminate()).map_err(anyhow::Error::from)?;
    let mut interrupt = signal(SignalKind::interrupt()).map_err(anyhow::Error::from)?;
    // If the folder exists, the error of its lock is clearer than a port in use: it shows a second daemon. A new folder
    // is not even created.
    if !settings.data_dir.exists() {
        drop(listen_on_ports(&settings).await?);
    }
    let store = open_store(&settings, disk).await?;
    let (fatal_sender, mut fatal) = mpsc::unbounded_channel();
    let (forks_sender, mut forks) = mpsc::unbounded_channel();
    let cluster = tokio::select! {
        cluster = join_cluster(&settings, &store, fatal_sender.clone()) => cluster?,
        // The engine may be unreachable for a long time.
        _ = terminate.recv() => return stop_before_start(store).await,
        _ = interrupt.recv() => return stop_before_start(store).await,
    };
    let fatal_of_maps = fatal_sender.clone();
    let opened = open_catalog(&settings, Arc::clone(&store), fatal_of_maps, forks_sender, cluster.clone());
    let (catalog, rest) = opened.await?;
    let for_forks = Arc::clone(&catalog);
    tidemap_base::task::spawn(async move {
        while let Some(fork) = forks.recv().await {
            for_forks.forked(fork).await;
        }
    });
    let (stop_sender, stopping) = watch::channel(false);
    let served = Served { settings: &settings, catalog: &catalog, metrics, stopping, fatal: fatal_sender };
    let mut ports = Ports::serve(served, protection).await?;
    report_ready(&settings, &store, &ports);

    let keeping = match (cluster.clone(), ports::shared_maps(&settings, &catalog)?) {
        (Some(cluster), Some(shared)) => {
            let client = CopyClient::new(shared, cluster.secret());
            Some(tidemap_base::task::spawn(keeping::keep(cluster, Arc::clone(&catalog), client)))
        }
        _ => None,
    };
    let scrubber = Scrubber::start(&store, &settings);
    if let Some(schedule) = Schedule::of(&settings) {
        tidemap_base::task::spawn(schedule.run(Arc::clone(&catalog), stop_sender.subscribe()));
    }
    let result = tokio::select! {
        _ = terminate.recv() => Ok(()),
        _ = interrupt.recv() => Ok(()),
        error = cannot_restore(Arc::clone(&catalog), rest) => Err(error),
        Some(reason) = fatal.recv() => Err(DaemonError::Storage(reason)),
        taken = keeping::name_taken(keeping) => Err(DaemonError::Settings(taken.to_string())),
        error = ports.closed() => Err(error),
    };
    info!("stopping");
    drop(scrubber);
    stop_sender.send_replace(true);
    if let Some(cluster) = &cluster {
        // This comes first, so that other daemons write the maps before this one has stopped.
        cluster.stop().await;
    }
    if tokio::time::timeout(MAPS_STOP_WITHIN, catalog.stop()).await.is_err() {
        warn!("maps did not stop within {} seconds; nothing acknowledged is lost", MAPS_STOP_WITHIN.as_secs());
    }
    ports.stop().await;
    close(store).await;
    traces.stop().await;
    result
}

/// Ends a daemon that does not serve anything yet.
async fn stop_before_start(store: Arc<Store>) -> Result<(), DaemonError> {
    info!("stopping");
    close(store).await;
    Ok(())
}

/// Joins the cluster that the settings name, if there is one.
async fn join_cluster(
    settings: &Settings,
    store: &Store,
    fatal: mpsc::UnboundedSender<String>,
) -> Result<Option<Cluster>, DaemonError> {
    let Some(section) = &settings.cluster else { return Ok(None) };
    // A map that cannot be opened reports this when it is opened.
    let held = store.maps().into_iter().filter_map(|(id, _)| store.shared(id).ok().flatten()).collect();
    let start = ClusterStart { listen: settings.listen.clone(), proposed_id: random_id()?, held, fatal };
    let connected = Cluster::connect(section, start).await;
    connected.map(Some).map_err(|error| DaemonError::Settings(error.to_string()))
}

/// Reports that requests are served.
fn report_ready(settings: &Settings, store: &Store, ports: &Ports) {
    let Ports { grpc_address, http_address, .. } = ports;
    println!("listening grpc={grpc_address} http={http_address}");
    // A closed stdout is no reason to stop.
    let _ = std::io::stdout().flush();
    let data = settings.data_dir.display();
    let instructions = InstructionSet::in_use();
    info!(grpc = %grpc_address, http = %http_address, %data, store_id = store.store_id(), %instructions, "ready");
}

/// Restores the maps that are served from the index. Ends only if one cannot be restored.
async fn cannot_restore(catalog: Arc<Catalog>, rest: Vec<UnopenedMap>) -> DaemonError {
    match tidemap_base::task::blocking(move || catalog.restore_rest(rest)).await {
        Ok(Err(error)) => error.into(),
        Err(error) => DaemonError::Other(error.into()),
        Ok(Ok(())) => std::future::pending().await,
    }
}

/// Closes the store, in a thread of its own, because all threads of the runtime may wait for a disk that hangs.
async fn close(store: Arc<Store>) {
    let (done, closed) = oneshot::channel();
    let thread = std::thread::Builder::new().name("close".to_owned()).spawn(move || {
        store.close();
        // After the deadline nobody waits for this.
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
