//! Serves the connections of the HTTP port, by HTTP/1.1 alone.
//!
//! Invariant: a connection works on one request at a time, and holds at most [`BUFFER_BYTES`] of the incoming data and
//! about as much of the outgoing data. HTTP/2 would let one connection hold many replies; browsers do not use it
//! without TLS, gRPC-Web does not need it, and gRPC has its own port.

use std::{convert::Infallible, io, pin::pin, time::Duration};

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use tokio::sync::{mpsc, watch};
use tower_layer::Layer as _;
use tracing::info;

use super::accept::Accepted;
use crate::telemetry::occasional::Occasional;

/// Maximum time for the head of a request to arrive, and for which a connection may be idle.
const HEAD_WITHIN: Duration = Duration::from_secs(30);
/// Number of bytes of a request that are not read yet. The head of a request fits into them.
const BUFFER_BYTES: usize = 16 << 10;

static OTHER_VERSIONS: Occasional = Occasional::new();

/// Serves connections until `stop` becomes true and the requests under way have ended. Requests carry the other end of
/// their connection as an extension.
pub async fn serve(
    mut accepted: mpsc::Receiver<io::Result<Accepted>>,
    router: Router,
    mut stop: watch::Receiver<bool>,
) {
    let (open, mut all_closed) = mpsc::channel(1);
    loop {
        let next = tokio::select! {
            next = accepted.recv() => next,
            // An error means that the sender is gone, which is a stop as well.
            _ = stop.wait_for(|stop| *stop) => break,
        };
        match next {
            Some(Ok(connection)) => {
                crate::task::spawn(serve_one(connection, router.clone(), stop.clone(), open.clone()));
            }
            Some(Err(_)) => {}
            None => break,
        }
    }
    drop((accepted, open));
    let _: Option<Infallible> = all_closed.recv().await;
}

/// Serves a connection to its end.
async fn serve_one(
    connection: Accepted,
    router: Router,
    mut stop: watch::Receiver<bool>,
    _open: mpsc::Sender<Infallible>,
) {
    let remote = connection.remote();
    let peer = remote.peer();
    let service = TowerToHyperService::new(Extension(remote).layer(router));
    let mut serving = pin!(
        http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEAD_WITHIN)
            .max_buf_size(BUFFER_BYTES)
            .serve_connection(TokioIo::new(connection), service)
    );
    let ended = tokio::select! {
        ended = serving.as_mut() => Some(ended),
        _ = stop.wait_for(|stop| *stop) => None,
    };
    let ended = match ended {
        Some(ended) => ended,
        None => {
            serving.as_mut().graceful_shutdown();
            serving.await
        }
    };
    if ended.is_err_and(|error| error.is_parse_version_h2())
        && let Some(left_out) = OTHER_VERSIONS.next()
    {
        info!(%peer, left_out, "a client used HTTP/2 on the HTTP port, which supports HTTP/1.1: gRPC has its own port");
    }
}
