//! The gRPC port: its services, and the limits of connections.
//!
//! Invariant: every RPC of `tidemap.v1` is served here; reflection only if all clients are local.

use std::{sync::Arc, time::Duration};

use axum::middleware::{from_fn, from_fn_with_state};
use tidemap_base::{
    config::Settings,
    connections::accept::Accepted,
    shares::{ShareLimits, Shares, waited::WaitedShare},
};
use tidemap_ingest::{catalog::Catalog, cluster::Cluster, intake::IntakeLimits, peers::SharedMaps};
use tidemap_proto::convert::scans::ScanLimits;
use tidemap_proto::v1::{
    DESCRIPTORS, cluster_service_server::ClusterServiceServer, exploration_service_server::ExplorationServiceServer,
    landmark_service_server::LandmarkServiceServer, maintenance_service_server::MaintenanceServiceServer,
    map_service_server::MapServiceServer, observation_service_server::ObservationServiceServer,
    peer_service_server::PeerServiceServer, query_service_server::QueryServiceServer,
    route_service_server::RouteServiceServer, search_service_server::SearchServiceServer,
    task_service_server::TaskServiceServer, topology_service_server::TopologyServiceServer,
};
use tokio::sync::{mpsc, watch};
use tokio_stream::{StreamExt as _, wrappers::ReceiverStream};
use tonic::{server::NamedService, service, transport::Server};
use tonic_health::{ServingStatus, server::HealthReporter};

use super::{
    admission::{Admission, AdmittedService},
    cluster::ClusterCalls,
    copies::PeerCalls,
    exploration::{Explorations, PlanLimits},
    gateway::{ClusterGateway, answer_or_pass, keep_authorization},
    guard::{Access, serve_caller},
    maintenance::{Maintenance, PageAddress},
    map::Maps,
    observation::{Observations, StreamLimits, open_streams::OpenStreams},
    peer::RpcConnection,
    permits::{Permits, processors},
    query::{Queries, QueryLimits},
    route::Routes,
    tasks::Tasks,
};

/// Maximum size of a request without observations: 100,000 times and thousands of names fit.
const REQUEST_BYTES: usize = 1 << 20;
/// Maximum size of a topological map, which is loaded whole; the log takes it as one record of at most 16 MiB.
const TOPOLOGY_BYTES: usize = 12 << 20;
/// Maximum size of a request with the landmarks of a place, or with the features of an image.
const LANDMARK_BYTES: usize = 4 << 20;
/// Maximum number of concurrent requests of one connection.
const STREAMS_PER_CONNECTION: u32 = 64;
/// Maximum number of bytes of a stream that are sent and not read yet.
const STREAM_WINDOW: u32 = 256 * 1024;
/// Room for the fields of a message besides its columns.
const MESSAGE_OVERHEAD: usize = 4096;

/// The services behind guard and admission, for the requests of one port.
pub type GuardedServices = AdmittedService<service::Routes>;

/// The queries behind guard and admission, for answers that are not wire messages.
pub type GuardedQueries = AdmittedService<Arc<Queries>>;

/// The services of all ports.
#[derive(Clone, Debug)]
pub struct Services {
    routes: service::Routes,
    queries: Arc<Queries>,
    admission: Admission,
    health: Health,
    /// The gateway, if daemons share maps.
    gateway: Option<ClusterGateway>,
}

/// The health service's state.
#[derive(Clone, Debug)]
pub struct Health(HealthReporter);

impl Health {
    /// Sets whether requests are served normally, for the daemon as a whole and for two of its services.
    pub async fn set_ready(&self, is_ready: bool) {
        let status = if is_ready { ServingStatus::Serving } else { ServingStatus::NotServing };
        let observation = <ObservationServiceServer<Observations> as NamedService>::NAME;
        for service in ["", observation, <QueryServiceServer<Queries> as NamedService>::NAME] {
            self.0.set_service_status(service, status).await;
        }
    }
}

impl Services {
    /// The health service. It reports that nothing is served until [`Health::set_ready`] is called.
    pub fn health(&self) -> Health {
        self.health.clone()
    }

    /// The services for callers with this access.
    pub fn guarded(&self, access: Access) -> GuardedServices {
        let serve_caller = from_fn_with_state(access.clone(), serve_caller);
        let mut router = self.routes.clone().prepare().into_axum_router();
        if let Some(gateway) = self.gateway.clone() {
            router = router.layer(from_fn_with_state(gateway, answer_or_pass));
        }
        // The layer that is added last receives a request first.
        router = router.layer(serve_caller);
        if self.gateway.is_some() {
            router = router.layer(from_fn(keep_authorization));
        }
        // Every request passes the admission, including one of a method that does not exist.
        self.admission.service(service::Routes::from(router), access)
    }

    /// The queries for callers with this access.
    pub fn guarded_queries(&self, access: Access) -> GuardedQueries {
        self.admission.service(Arc::clone(&self.queries), access)
    }
}

/// Makes the services of a daemon that serves its page at this address. `shared`: the daemons that share maps, if this
/// is one of them.
pub async fn services(
    catalog: Arc<Catalog>,
    settings: &Settings,
    page: PageAddress,
    shared: Option<SharedMaps>,
    stopping: watch::Receiver<bool>,
) -> Services {
    let (health, health_service) = tonic_health::server::health_reporter();
    let health = Health(health);
    health.set_ready(false).await;
    let shares = Shares::new(ShareLimits::of(settings));
    let peers = shared.as_ref().map(|shared| Arc::clone(&shared.peers));
    let gateway = shared.map(|shared| ClusterGateway::new(Arc::clone(&catalog), shared, stopping.clone()));
    let observations = Observations {
        catalog: Arc::clone(&catalog),
        peers,
        limits: StreamLimits {
            intake: IntakeLimits {
                batch: settings.max_batch_observations,
                table: settings.max_states_per_map,
                scans: ScanLimits {
                    batch_scans: settings.max_batch_scans,
                    points: settings.max_scan_points,
                    tiles: settings.max_scan_tiles,
                },
            },
            max_message_bytes: settings.max_message_bytes,
            max_stream_buffer: settings.max_stream_buffer_bytes,
        },
        buffers: WaitedShare::new(settings.max_buffer_bytes, settings.max_stream_buffer_bytes),
        shares: shares.clone(),
        permits: Permits::default(),
        streams: OpenStreams::new(shares.clone(), Duration::from_secs(settings.stream_idle_secs)),
        stopping,
    };
    let limits = QueryLimits {
        predictions: settings.max_predictions,
        batch: settings.max_batch_observations,
        trained_models: settings.max_trained_models,
        training_readings: settings.max_training_readings,
    };
    let queries = Arc::new(Queries::new(Arc::clone(&catalog), limits, shares.clone()));
    let plans = PlanLimits {
        predictions: settings.max_predictions,
        cells: settings.max_plan_cells,
        view_work: settings.max_view_work,
    };
    let routes = Arc::new(Routes::new(Arc::clone(&catalog), &queries, settings.max_predictions));
    let explorations = Explorations::new(Arc::clone(&catalog), &queries, plans, Arc::clone(&routes));
    let tasks = Tasks {
        catalog: Arc::clone(&catalog),
        explorations: explorations.clone(),
        observations: observations.clone(),
        permits: Permits::new(processors().max(2)),
    };
    let message_bytes = settings.max_message_bytes + MESSAGE_OVERHEAD;
    let admission = Admission::new(shares.clone(), catalog.context().cluster.as_ref().map(Cluster::secret));
    let routes = service::Routes::default()
        .add_service(health_service)
        .add_service(
            MapServiceServer::new(Maps { catalog: Arc::clone(&catalog) }).max_decoding_message_size(REQUEST_BYTES),
        )
        .add_service(ObservationServiceServer::new(observations).max_decoding_message_size(message_bytes))
        .add_service(
            QueryServiceServer::from_arc(Arc::clone(&queries))
                .max_decoding_message_size(message_bytes.max(REQUEST_BYTES))
                .max_encoding_message_size(64 << 20),
        )
        .add_service(ExplorationServiceServer::new(explorations).max_decoding_message_size(REQUEST_BYTES))
        .add_service(TaskServiceServer::new(tasks).max_decoding_message_size(REQUEST_BYTES))
        .add_service(TopologyServiceServer::from_arc(Arc::clone(&routes)).max_decoding_message_size(TOPOLOGY_BYTES))
        .add_service(LandmarkServiceServer::from_arc(Arc::clone(&routes)).max_decoding_message_size(LANDMARK_BYTES))
        .add_service(RouteServiceServer::from_arc(Arc::clone(&routes)).max_decoding_message_size(REQUEST_BYTES))
        .add_service(SearchServiceServer::from_arc(routes).max_decoding_message_size(REQUEST_BYTES))
        .add_service(
            ClusterServiceServer::new(ClusterCalls { catalog: Arc::clone(&catalog), permits: Permits::default() })
                .max_decoding_message_size(REQUEST_BYTES),
        )
        .add_service(PeerServiceServer::new(PeerCalls::new(Arc::clone(&catalog))).max_decoding_message_size(4096))
        .add_service(
            MaintenanceServiceServer::new(Maintenance {
                catalog,
                backup_dir: settings.backup_dir.clone(),
                page,
                shares,
            })
            .max_decoding_message_size(REQUEST_BYTES),
        );
    Services { routes, queries, admission, health, gateway }
}

/// Serves the gRPC port to those with access until `stop` becomes true and the connections are closed. Reflection is
/// served if all clients are local.
///
/// # Errors
/// The transport failed.
pub async fn serve(
    connections: mpsc::Receiver<std::io::Result<Accepted>>,
    access: Access,
    mut services: Services,
    is_local: bool,
    mut stop: watch::Receiver<bool>,
) -> anyhow::Result<()> {
    if is_local {
        let reflection = || {
            tonic_reflection::server::Builder::configure()
                .register_encoded_file_descriptor_set(DESCRIPTORS)
                .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        };
        // Older tools use v1alpha only.
        services.routes =
            services.routes.add_service(reflection().build_v1()?).add_service(reflection().build_v1alpha()?);
    }
    let stopped = async move {
        // An error means that the sender is gone, which is a stop as well.
        let _ = stop.wait_for(|stop| *stop).await;
    };
    let connections = ReceiverStream::new(connections).map(|accepted| accepted.map(RpcConnection));
    Server::builder()
        .max_concurrent_streams(STREAMS_PER_CONNECTION)
        .initial_stream_window_size(STREAM_WINDOW)
        // A stream of a saturated map may stay unread for long; the other streams of the connection continue.
        .initial_connection_window_size(STREAM_WINDOW * STREAMS_PER_CONNECTION)
        .http2_keepalive_interval(Some(Duration::from_secs(20)))
        .http2_keepalive_timeout(Some(Duration::from_secs(10)))
        .http2_max_header_list_size(16 * 1024)
        .serve_with_incoming_shutdown(services.guarded(access), connections, stopped)
        .await?;
    Ok(())
}
