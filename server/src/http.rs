//! The HTTP port: health for everybody, metrics (beyond this machine, for holders of tokens only), and the routes of
//! [`web`].
//!
//! Invariant: health and metrics reveal nothing of the content of a map, and are available by any host name. Names of
//! maps and producers are among the metrics only for callers who may list them. Whether the daemon lives and serves is
//! answered also when all connections of the port are busy, by its reserve. All replies are counted until they are
//! read.

use std::{io, path::PathBuf, sync::Arc};

use axum::{
    Extension, Router,
    body::Bytes,
    extract::{Request, State},
    http::{HeaderValue, StatusCode, header},
    middleware::{Next, from_fn_with_state, map_response},
    response::Response,
    routing::get,
};
use metrics_exporter_prometheus::PrometheusHandle;
use tidemap_base::{
    connections::{Remote, accept::Accepted, http1, unread::UnreadReplies},
    telemetry::process,
};
use tidemap_ingest::{
    backups::Schedule,
    catalog::Catalog,
    handle::{MapHandle, OpenProgress},
    statistics,
};
use tidemap_rpc::{admission::note_denial, guard::Access, status::RpcError};
use tidemap_store::Trouble;
use tidemap_web::KnownHosts;
use tokio::sync::{mpsc, watch};

use crate::{cluster_figures::figures, silent_producers::SilentProducers};

mod shared_text;

use shared_text::SharedText;

const INDEX: &str = "tidemapd\n\n/api/v1/openapi.json  the requests as JSON\n/healthz  the process runs\n/readyz   requests are served\n/metrics  Prometheus\n";

/// Maximum number of problems of the storage that are listed one by one.
const TROUBLE_SHOWN: usize = 20;

/// A line for each map that is being opened. It has no names, because this page needs no token.
fn opening(catalog: &Catalog) -> String {
    let line = |handle: &Arc<MapHandle>| match handle.opening() {
        OpenProgress::Open => None,
        OpenProgress::Replay { done, total } => {
            Some(format!("opening map number {}: {done} of {total} records of its log are replayed\n", handle.id.0))
        }
    };
    catalog.all().values().filter_map(line).collect()
}

/// A line for each problem of the storage; and whether observations, generations or lists are not kept correctly.
fn trouble(catalog: &Catalog) -> (String, bool) {
    let trouble = catalog.context().store.trouble();
    let serves = |trouble: &Trouble| matches!(trouble, Trouble::NoIndex(_) | Trouble::Damaged { .. });
    let is_severe = !trouble.iter().all(serves);
    let mut text: String = trouble.iter().take(TROUBLE_SHOWN).map(|trouble| format!("{trouble}\n")).collect();
    if trouble.len() > TROUBLE_SHOWN {
        text += &format!("and {} more problems: see the log\n", trouble.len() - TROUBLE_SHOWN);
    }
    (text, is_severe)
}

/// A line for each map that is set aside. It has the map's number, not its name; the log and `map list` have the name.
fn unavailable(catalog: &Catalog) -> String {
    let maps = catalog.unavailable();
    maps.iter().map(|map| format!("map number {} is unavailable: {}\n", map.id.0, map.reason)).collect()
}

/// Whether requests are served normally, and the text that describes it.
pub(crate) fn readiness(catalog: &Catalog, is_stopping: bool) -> (bool, String) {
    let (trouble, is_severe) = trouble(catalog);
    let (opening, unavailable) = (opening(catalog), unavailable(catalog));
    if is_stopping {
        (false, "stopping\n".to_owned())
    } else if is_severe {
        (false, trouble + &unavailable)
    } else if opening.is_empty() {
        (true, format!("ready\n{trouble}{unavailable}"))
    } else {
        (false, opening)
    }
}

/// The sources of the metrics.
#[derive(Clone, Debug)]
pub(crate) struct Metrics {
    /// The counters of the process.
    pub handle: PrometheusHandle,
    /// The data folder, whose disk is watched.
    pub data_dir: PathBuf,
    /// The schedule of backups, if there is one.
    pub backups: Option<Schedule>,
    /// Finds the producers that are silent.
    pub silent: Arc<SilentProducers>,
    /// The access to names: callers who may list names by the RPCs may read them here, also where the port itself is
    /// open to this machine.
    pub names_for: Access,
    /// The host names by which pages of browsers may read the names.
    pub hosts: KnownHosts,
}

impl Metrics {
    fn may_read_names(&self, request: &Request) -> bool {
        matches!(self.names_for.may_read_metrics(request.headers()), Ok(true))
            && tidemap_web::is_own(&self.hosts, request)
    }
}

/// The routes for programs that watch the daemon.
fn probes(catalog: Arc<Catalog>, stopping: watch::Receiver<bool>) -> Router {
    let ready = move || {
        let (is_ready, text) = readiness(&catalog, *stopping.borrow());
        async move { (if is_ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE }, text) }
    };
    Router::new().route("/healthz", get(|| async { "alive\n" })).route("/readyz", get(ready))
}

/// A connection that works on a request does not make room for another, until its reply is read.
async fn keep_busy(
    State(unread): State<UnreadReplies>,
    Extension(remote): Extension<Remote>,
    request: Request,
    next: Next,
) -> Response {
    remote.note_request();
    // The admission decides whether the request is served.
    let busy = remote.busy(false);
    // The task handles one request per turn: many that arrive at once over one connection do not delay others.
    tokio::task::yield_now().await;
    unread.counted(next.run(request).await, &remote, busy).unwrap_or_else(tidemap_web::no_room)
}

/// The routes for connections beyond the limits; each connection gets one answer.
fn reserve(probes: Router) -> Router {
    let full = "all connections of this port are busy: try again later\n";
    probes.fallback(move || async move { (StatusCode::SERVICE_UNAVAILABLE, full) }).layer(map_response(
        async |mut response: Response| {
            response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
            response
        },
    ))
}

/// Serves the port and its reserve until `stop` becomes true.
pub(crate) async fn serve(
    [connections, in_reserve]: [mpsc::Receiver<io::Result<Accepted>>; 2],
    catalog: Arc<Catalog>,
    metrics: Metrics,
    access: Access,
    web: Router,
    stopping: watch::Receiver<bool>,
    stop: watch::Receiver<bool>,
) {
    let probes = probes(Arc::clone(&catalog), stopping);
    let reserve = reserve(probes.clone());
    let router = if tidemap_web::has_page() { web } else { web.route("/", get(|| async { INDEX })) };
    let page = Arc::new(MetricsPage { catalog, metrics, access, texts: Default::default() });
    let unread = UnreadReplies::default();
    let router = router
        .merge(probes)
        .route("/metrics", get(metrics_page).with_state(page))
        .layer(from_fn_with_state(unread, keep_busy));
    tokio::join!(http1::serve(connections, router, stop.clone()), http1::serve(in_reserve, reserve, stop));
}

/// The sources of `/metrics`.
struct MetricsPage {
    catalog: Arc<Catalog>,
    metrics: Metrics,
    access: Access,
    /// The text without names, and the one with names.
    texts: [SharedText; 2],
}

async fn metrics_page(
    State(page): State<Arc<MetricsPage>>,
    Extension(remote): Extension<Remote>,
    request: Request,
) -> Result<([(header::HeaderName, &'static str); 1], Bytes), StatusCode> {
    match page.access.may_read_metrics(request.headers()) {
        Ok(true) => {}
        Ok(false) => return Err(StatusCode::FORBIDDEN),
        Err(denial) => {
            note_denial(remote.peer(), "/metrics", &RpcError::Denial(denial));
            return Err(StatusCode::UNAUTHORIZED);
        }
    }
    let may_read_names = page.metrics.may_read_names(&request);
    let gathering = Arc::clone(&page);
    let silent = async move {
        if may_read_names { gathering.metrics.silent.metrics(&gathering.catalog).await } else { String::new() }
    };
    let writing = Arc::clone(&page);
    let text = page.texts[usize::from(may_read_names)].get(silent, move |silent| writing.text() + &silent).await;
    text.map(|text| ([(header::CONTENT_TYPE, "text/plain; charset=utf-8")], text))
        .map_err(|_| StatusCode::INTERNAL_SERVER_ERROR)
}

impl MetricsPage {
    /// All metrics except those of names. Sizes and backups are read from the disk.
    fn text(&self) -> String {
        let Self { catalog, metrics, .. } = self;
        for (name, value, _) in statistics::of_daemon(catalog) {
            metrics::gauge!(format!("tidemap_{name}")).set(value);
        }
        let process = process::metrics(&metrics.data_dir);
        let context = catalog.context();
        let (id, now) = (context.store.store_id(), context.clock.now_nanos());
        let backups = metrics.backups.iter().flat_map(|backups| backups.metrics(id, now));
        for (name, value) in statistics::of_updates(catalog).into_iter().chain(process).chain(backups) {
            metrics::gauge!(name).set(value);
        }
        for (name, label, value) in figures(catalog) {
            metrics::gauge!(name, label.as_slice()).set(value);
        }
        metrics.handle.render()
    }
}
