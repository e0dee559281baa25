//! The HTTP port: health for everybody, metrics, beyond this machine for holders of tokens, and what [`web`] adds.
//!
//! Invariant: health and metrics reveal nothing of the content of a map, and are asked by any host name.

use std::{future::Future, path::PathBuf, sync::Arc};

use axum::{Router, extract::Request, http::StatusCode, routing::get};
use metrics_exporter_prometheus::PrometheusHandle;
use tidemap_store::Trouble;
use tokio::sync::watch;

use crate::{
    catalog::Catalog,
    connections::Peer,
    connections::accept::HttpListener,
    ingest::handle::{MapHandle, OpenProgress},
    rpc::guard::Access,
    statistics,
    telemetry::process,
    web,
};

const INDEX: &str = "tidemapd\n\n/api/v1/openapi.json  what can be asked as JSON\n/healthz  the process lives\n/readyz   requests are served\n/metrics  Prometheus\n";

/// Problems of the storage that are told one by one.
const TROUBLE_SHOWN: usize = 20;

/// A line for each map that is being opened; no names, because nobody has to log in here.
fn opening(catalog: &Catalog) -> String {
    let line = |handle: &Arc<MapHandle>| match handle.opening() {
        OpenProgress::Open => None,
        OpenProgress::Replay { done, total } => {
            Some(format!("opening map number {}: {done} of {total} records of its log are replayed\n", handle.id.0))
        }
    };
    catalog.all().values().filter_map(line).collect()
}

/// A line for each problem of the storage; whether observations or generations are not kept as they should be.
fn trouble(catalog: &Catalog) -> (String, bool) {
    let trouble = catalog.context().store.trouble();
    let serves = |trouble: &Trouble| matches!(trouble, Trouble::NoIndex | Trouble::Damaged { .. });
    let is_severe = !trouble.iter().all(serves);
    let mut text: String = trouble.iter().take(TROUBLE_SHOWN).map(|trouble| format!("{trouble}\n")).collect();
    if trouble.len() > TROUBLE_SHOWN {
        text += &format!("and {} more problems: see the log\n", trouble.len() - TROUBLE_SHOWN);
    }
    (text, is_severe)
}

/// A line for each map that is set aside; its number, as above. The log and `map list` name it.
fn unavailable(catalog: &Catalog) -> String {
    let maps = catalog.unavailable();
    maps.iter().map(|map| format!("map number {} is unavailable: {}\n", map.id.0, map.reason)).collect()
}

/// Where metrics come from.
#[derive(Clone, Debug)]
pub(crate) struct Metrics {
    /// What the process has counted.
    pub handle: PrometheusHandle,
    /// The data folder, whose disk is watched.
    pub data_dir: PathBuf,
}

/// Serves until `stop` is ready.
///
/// # Errors
/// The listener failed.
pub(crate) async fn serve(
    listener: HttpListener,
    catalog: Arc<Catalog>,
    metrics: Metrics,
    access: Access,
    web: Router,
    stopping: watch::Receiver<bool>,
    stop: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    let maps = Arc::clone(&catalog);
    let ready = move || {
        let stopping = *stopping.borrow();
        let (trouble, is_severe) = trouble(&maps);
        let (opening, unavailable) = (opening(&maps), unavailable(&maps));
        async move {
            if stopping {
                (StatusCode::SERVICE_UNAVAILABLE, "stopping\n".to_owned())
            } else if is_severe {
                (StatusCode::SERVICE_UNAVAILABLE, trouble + &unavailable)
            } else if opening.is_empty() {
                (StatusCode::OK, format!("ready\n{trouble}{unavailable}"))
            } else {
                (StatusCode::SERVICE_UNAVAILABLE, opening)
            }
        }
    };
    let router = if web::has_page() { web } else { web.route("/", get(|| async { INDEX })) };
    let router = router.route("/healthz", get(|| async { "alive\n" })).route("/readyz", get(ready)).route(
        "/metrics",
        get(move |request: Request| {
            let (catalog, metrics) = (Arc::clone(&catalog), metrics.clone());
            let allowed = access.may_read_metrics(&request);
            async move {
                match allowed {
                    Ok(true) => {}
                    Ok(false) => return Err(StatusCode::FORBIDDEN),
                    Err(_) => return Err(StatusCode::UNAUTHORIZED),
                }
                // Sizes are read from the disk.
                let text = tokio::task::spawn_blocking(move || {
                    for (name, value, _) in statistics::of_daemon(&catalog) {
                        metrics::gauge!(format!("tidemap_{name}")).set(value);
                    }
                    let process = process::metrics(&metrics.data_dir);
                    for (name, value) in statistics::of_updates(&catalog).into_iter().chain(process) {
                        metrics::gauge!(name).set(value);
                    }
                    metrics.handle.render()
                });
                text.await.map_err(|_| StatusCode::INTERNAL_SERVER_ERROR)
            }
        }),
    );
    axum::serve(listener, router.into_make_service_with_connect_info::<Peer>()).with_graceful_shutdown(stop).await
}
