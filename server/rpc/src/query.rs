//! `QueryService`: questions about an immutable view, and about the past.
//!
//! Invariant: a request is answered from one view, off the async threads, in pieces that wait for the reader for a
//! bounded time. A bounded number of requests compute at once; the others wait, and small requests never wait for large
//! ones.

use std::{sync::Arc, time::Duration};

use tidemap_base::shares::Shares;
use tidemap_ingest::catalog::Catalog;
use tidemap_proto::v1::{self, query_service_server::QueryService};
use tonic::{Request, Response, Streaming};

use super::{
    RpcReply,
    permits::{PROMPT, Permit, Permits, processors},
    replies::Replies,
    status::RpcError,
    training::ModelTrainer,
};

mod anomalies;
mod cell_alarms;
mod evaluate;
mod flow;
mod grid;
mod places;
mod positions;
mod reconstruct;
pub(super) mod states;
mod surprises;
mod watch;

#[cfg(test)]
mod tests;

use watch::Watches;

/// Maximum number of states of one request.
const STATES_MAX: usize = 10_000;

/// Maximum number of predictions of a small request: it computes for some milliseconds.
const SMALL_PREDICTIONS: u64 = 50_000;

/// A large request is refused if it would wait for longer than this: a long queue helps nobody.
const LARGE_WITHIN: Duration = Duration::from_secs(10);

/// The service of queries.
#[derive(Debug)]
pub struct Queries {
    catalog: Arc<Catalog>,
    max_predictions: u64,
    max_batch: usize,
    /// Permits of small requests.
    permits: Permits,
    /// Permits of large requests, so that small ones never wait for them.
    large_permits: Permits,
    /// Permits to read the past. They are separate, because their holder may wait for an update.
    past_permits: Permits,
    trainer: Arc<ModelTrainer>,
    watches: Watches,
}

/// Limits of questions.
#[derive(Clone, Copy, Debug)]
pub struct QueryLimits {
    /// Maximum number of predictions of one request.
    pub predictions: u64,
    /// Maximum number of observations of one message.
    pub batch: usize,
    /// Maximum number of trained models in the cache.
    pub trained_models: usize,
    /// Maximum number of readings that a model is trained on.
    pub training_readings: u64,
}

impl Queries {
    /// Creates the service with these limits; evaluations and watches take from these shares.
    pub fn new(catalog: Arc<Catalog>, limits: QueryLimits, shares: Shares) -> Self {
        let trainer = Arc::new(ModelTrainer::new(
            Arc::clone(&catalog),
            limits.trained_models,
            limits.training_readings,
            shares.clone(),
        ));
        let (max_predictions, max_batch) = (limits.predictions, limits.batch);
        Self {
            catalog,
            max_predictions,
            max_batch,
            permits: Permits::default().beginning_within(PROMPT),
            large_permits: Permits::new((processors() / 2).max(1)).beginning_within(LARGE_WITHIN),
            past_permits: Permits::default(),
            trainer,
            watches: Watches::new(shares),
        }
    }

    /// Takes a permit for this number of predictions.
    async fn permit_for(&self, predictions: u64) -> Result<Permit, RpcError> {
        if predictions <= SMALL_PREDICTIONS { self.permits.take().await } else { self.large_permits.take().await }
    }

    /// The trainer of models, for other services.
    pub(super) fn trainer(&self) -> Arc<ModelTrainer> {
        Arc::clone(&self.trainer)
    }
}

#[tonic::async_trait]
impl QueryService for Queries {
    type PredictStatesStream = Replies<v1::PredictStatesResponse>;
    type PredictFlowStream = Replies<v1::PredictFlowResponse>;
    type PredictPositionsStream = Replies<v1::PredictPositionsResponse>;
    type PredictGridStream = Replies<v1::PredictGridResponse>;
    type ReconstructStream = Replies<v1::ReconstructResponse>;
    type FindAnomaliesStream = Replies<v1::FindAnomaliesResponse>;
    type WatchAnomaliesStream = Replies<v1::WatchAnomaliesResponse>;
    type ListCellAlarmsStream = Replies<v1::ListCellAlarmsResponse>;

    async fn predict_states(&self, request: Request<v1::PredictStatesRequest>) -> RpcReply<Self::PredictStatesStream> {
        Ok(Response::new(states::predict_states(self, request.into_inner()).await?))
    }

    async fn evaluate_states(
        &self,
        request: Request<Streaming<v1::EvaluateStatesRequest>>,
    ) -> RpcReply<v1::EvaluateStatesResponse> {
        Ok(Response::new(evaluate::evaluate_states(self, request.into_inner()).await?))
    }

    async fn describe_model(&self, request: Request<v1::DescribeModelRequest>) -> RpcReply<v1::DescribeModelResponse> {
        Ok(Response::new(states::describe_model(self, request.into_inner()).await?))
    }

    async fn predict_grid(&self, request: Request<v1::PredictGridRequest>) -> RpcReply<Self::PredictGridStream> {
        Ok(Response::new(grid::predict_grid(self, request.into_inner()).await?))
    }

    async fn predict_flow(&self, request: Request<v1::PredictFlowRequest>) -> RpcReply<Self::PredictFlowStream> {
        Ok(Response::new(flow::predict_flow(self, request.into_inner()).await?))
    }

    async fn predict_positions(
        &self,
        request: Request<v1::PredictPositionsRequest>,
    ) -> RpcReply<Self::PredictPositionsStream> {
        Ok(Response::new(positions::predict_positions(self, request.into_inner()).await?))
    }

    async fn predict_at_places(
        &self,
        request: Request<v1::PredictAtPlacesRequest>,
    ) -> RpcReply<v1::PredictAtPlacesResponse> {
        Ok(Response::new(places::predict_at_places(self, request.into_inner()).await?))
    }

    async fn reconstruct(&self, request: Request<v1::ReconstructRequest>) -> RpcReply<Self::ReconstructStream> {
        Ok(Response::new(reconstruct::reconstruct(self, request.into_inner()).await?))
    }

    async fn find_anomalies(&self, request: Request<v1::FindAnomaliesRequest>) -> RpcReply<Self::FindAnomaliesStream> {
        Ok(Response::new(anomalies::find_anomalies(self, request.into_inner()).await?))
    }

    async fn list_surprises(&self, request: Request<v1::ListSurprisesRequest>) -> RpcReply<v1::ListSurprisesResponse> {
        Ok(Response::new(surprises::list_surprises(self, request.into_inner()).await?))
    }

    async fn watch_anomalies(
        &self,
        request: Request<v1::WatchAnomaliesRequest>,
    ) -> RpcReply<Self::WatchAnomaliesStream> {
        Ok(Response::new(watch::watch_anomalies(self, request.into_inner()).await?))
    }

    async fn list_cell_alarms(
        &self,
        request: Request<v1::ListCellAlarmsRequest>,
    ) -> RpcReply<Self::ListCellAlarmsStream> {
        Ok(Response::new(cell_alarms::list_cell_alarms(self, request.into_inner()).await?))
    }
}
