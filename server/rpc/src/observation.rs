//! `ObservationService`: a stream of observations in, acknowledgements out.
//!
//! Invariant: the size of the data that a stream has sent and that is not durable yet is bounded, per stream and in
//! total, because room is reserved before the next message is read. A stream has its own task: nothing that was handed
//! to the writer is lost when a client goes away.

use std::sync::Arc;

use tidemap_base::{
    shares::{Shares, client::Client, waited::WaitedShare},
    telemetry::traces::Span,
};
use tidemap_ingest::{catalog::Catalog, intake::IntakeLimits, peers::Peers};
use tidemap_proto::v1::{self, observation_service_server::ObservationService};
use tokio::sync::{mpsc, watch};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};
use tracing::debug;

use super::{RpcReply, guard::current_caller, permits::Permits, status::RpcError};

mod acknowledgements;
mod channel;
mod classify;
mod memory;
pub(crate) mod open_streams;
mod opening;
mod report;
mod session;
mod stream;

use channel::{READ_WITHIN, Requests};
use open_streams::OpenStreams;
pub(super) use opening::HELLO_WITHIN;
use opening::open_and_serve;
pub(super) use report::SentAs;

/// Number of replies that wait for the client.
const REPLIES_AHEAD: usize = 16;

/// Limits of streams.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StreamLimits {
    /// Limits of the data that a stream sends.
    pub intake: IntakeLimits,
    /// Maximum size of one message, in bytes.
    pub max_message_bytes: usize,
    /// Maximum size of the data that one stream has sent and that is not durable yet, in bytes.
    pub max_stream_buffer: usize,
}

/// The service. Clones share its bounds.
#[derive(Clone, Debug)]
pub(crate) struct Observations {
    pub catalog: Arc<Catalog>,
    /// The daemons that share maps, if this is one of them.
    pub peers: Option<Arc<dyn Peers>>,
    pub limits: StreamLimits,
    /// Room for all streams together, in bytes.
    pub buffers: WaitedShare,
    /// The bounded resources that clients share.
    pub shares: Shares,
    /// Permits to classify.
    pub(super) permits: Permits,
    /// The open streams.
    pub streams: OpenStreams,
    /// Becomes true when the daemon stops.
    pub stopping: watch::Receiver<bool>,
}

#[tonic::async_trait]
impl ObservationService for Observations {
    type ObserveStream = ReceiverStream<Result<v1::ObserveResponse, Status>>;

    async fn observe(&self, request: Request<Streaming<v1::ObserveRequest>>) -> RpcReply<Self::ObserveStream> {
        Ok(Response::new(ReceiverStream::new(self.start(request.into_inner())?)))
    }

    async fn classify_activity(
        &self,
        request: Request<v1::ClassifyActivityRequest>,
    ) -> RpcReply<v1::ClassifyActivityResponse> {
        Ok(Response::new(self.classify(request.into_inner()).await?))
    }

    async fn report(&self, request: Request<v1::ReportRequest>) -> RpcReply<v1::ReportResponse> {
        Ok(Response::new(self.take_readings(request.into_inner()).await?))
    }
}

impl Observations {
    /// Starts a stream and returns its replies. The stream has a task of its own, which works for the same caller.
    fn start(
        &self,
        mut requests: impl Requests + 'static,
    ) -> Result<mpsc::Receiver<Result<v1::ObserveResponse, Status>>, RpcError> {
        let mut entry = self.streams.enter(&Client::current())?;
        let (replies, stream) = mpsc::channel(REPLIES_AHEAD);
        let service = self.clone();
        tidemap_base::task::spawn(Span::current().scope(current_caller().scope(async move {
            let result = open_and_serve(&service, &mut entry, &mut requests, &replies).await;
            if let Err(error) = result {
                debug!(%error, "stream ended");
                // The client may be gone.
                let _ = tokio::time::timeout(READ_WITHIN, replies.send(Err(error.into()))).await;
            }
            drop(entry);
        })));
        Ok(stream)
    }
}
