//! The services for browsers and scripts on the HTTP port: gRPC-Web, the same RPCs as JSON, pictures and documents to
//! link to, imports of recordings, and the page.
//!
//! Invariant: a request reaches the RPCs by the same guard, admission and bounds as on the gRPC port. Requests of pages
//! of other origins are refused. Without tokens the port is for reading, unless the operator sets `http_write`.

use std::sync::Arc;

use axum::{
    Router,
    http::StatusCode,
    middleware::from_fn_with_state,
    response::Response,
    routing::{get, post},
};
use prost_reflect::DescriptorPool;
use tidemap_base::connections::unread::{NoRoom, SharedContent};
use tidemap_proto::v1::DESCRIPTORS;
use tidemap_rpc::serve::{GuardedQueries, GuardedServices};
use tonic_web::GrpcWebLayer;
use tower_http::compression::{CompressionLayer, CompressionLevel, predicate::SizeAbove};
use tower_layer::Layer as _;

#[cfg(test)]
mod api_page;
mod assets;
mod calls;
mod json;
mod links;
mod openapi;
mod origin;
mod recordings;
mod reference;
mod times;

pub use assets::has_page;
pub use origin::{KnownHosts, is_own};
pub use recordings::Recordings;

/// The RPC that answers with grids. Only its replies are sent to browsers compressed: this reduces them to a fifth.
/// Other replies are small, or streams of which every message must leave at once.
const PREDICT_GRID: &str = "/tidemap.v1.QueryService/PredictGrid";

/// The RPCs behind JSON, and the queries behind pictures.
#[derive(Clone)]
struct Gateway {
    services: GuardedServices,
    queries: GuardedQueries,
    pool: DescriptorPool,
    /// Turns to convert a large message, one permit each.
    large: Arc<tokio::sync::Semaphore>,
}

/// The routes of gRPC-Web, JSON and the page.
///
/// # Errors
/// The descriptors of the wire cannot be read, which is a defect of the build.
pub fn router(
    services: &GuardedServices,
    queries: GuardedQueries,
    recordings: Recordings,
    hosts: KnownHosts,
) -> anyhow::Result<Router> {
    let pool = DescriptorPool::decode(DESCRIPTORS)?;
    let openapi = openapi::document(&pool);
    let reference = reference::router(&openapi)?;
    let grpc_web = GrpcWebLayer::new().layer(services.clone());
    let mut router = Router::new()
        .route("/api/v1/openapi.json", get(|| async { shared(json::ok(openapi)) }))
        .route("/api/v1/{service}/{method}", post(json::call))
        .route("/api/v1/maps/{name}/grid.png", get(links::grid_png))
        .route("/api/v1/maps/{name}/topology.geojson", get(links::topology_geojson));
    for service in pool.services() {
        for method in service.methods() {
            let path = format!("/{}/{}", service.full_name(), method.name());
            router = if path == PREDICT_GRID {
                let gzip = CompressionLayer::new().quality(CompressionLevel::Fastest);
                router.route_service(&path, gzip.compress_when(SizeAbove::default()).layer(grpc_web.clone()))
            } else {
                router.route_service(&path, grpc_web.clone())
            };
        }
    }
    // Half of the processors are left to other work, except on a machine with one processor.
    let at_once = std::thread::available_parallelism().map_or(1, |processors| processors.get().div_ceil(2));
    let large = Arc::new(tokio::sync::Semaphore::new(at_once));
    let gateway = Gateway { services: services.clone(), queries, pool, large };
    Ok(router
        .with_state(gateway)
        .merge(recordings::router(recordings))
        .merge(reference)
        .merge(assets::router())
        .layer(from_fn_with_state(hosts, origin::check)))
}

/// A response whose content all readers share.
fn shared(mut response: Response) -> Response {
    response.extensions_mut().insert(SharedContent);
    response
}

/// The response when there is no room for a reply.
pub fn no_room(refusal: NoRoom) -> Response {
    json::failure(StatusCode::TOO_MANY_REQUESTS, "RESOURCE_EXHAUSTED", "UNREAD_REPLIES", &refusal.to_string())
}
