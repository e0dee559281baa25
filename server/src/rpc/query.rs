//! `QueryService`: questions to an immutable view, and to what is kept of the past.
//!
//! Invariant: a request is answered from one view, off the async threads, in pieces that wait for the reader, and for a
//! bounded time. Only so many requests look up and compute at once; the others wait for them.

use std::sync::Arc;

use tidemap_map::{event::StateId, view::MapView};
use tidemap_proto::v1::{self, query_service_server::QueryService};
use tonic::{Request, Response, Status, Streaming};

use super::status::RpcError;
use crate::catalog::Catalog;

mod evaluate;
mod grid;
mod reconstruct;
mod replies;
mod states;

#[cfg(test)]
mod tests;

use replies::{Replies, Turns};

/// Most states of one request.
const STATES_MAX: usize = 10_000;

/// The service.
#[derive(Debug)]
pub struct Queries {
    catalog: Arc<Catalog>,
    max_predictions: u64,
    max_batch: usize,
    turns: Turns,
    /// Turns to ask about the past. They are others: who has one may wait for an update, and predictions go on meanwhile.
    recalls: Turns,
}

impl Queries {
    /// Answers with at most so many predictions a request, and takes at most so many observations a message.
    #[must_use]
    pub fn new(catalog: Arc<Catalog>, max_predictions: u64, max_batch: usize) -> Self {
        Self { catalog, max_predictions, max_batch, turns: Turns::default(), recalls: Turns::default() }
    }
}

/// The state of this name, or an error that lists some that exist.
fn find_state(view: &MapView, name: &str) -> Result<StateId, RpcError> {
    view.find(name).ok_or_else(|| RpcError::UnknownState {
        map: view.spec().name.as_str().to_owned(),
        name: name.chars().take(80).collect(),
        known: view.infos().take(11).map(|info| info.name.as_str().to_owned()).collect(),
    })
}

fn check_limit(what: &'static str, got: u64, max: u64, setting: &'static str) -> Result<(), RpcError> {
    if got > max { Err(RpcError::Limit { what, got, max, setting }) } else { Ok(()) }
}

#[tonic::async_trait]
impl QueryService for Queries {
    type PredictStatesStream = Replies<v1::PredictStatesResponse>;
    type PredictGridStream = Replies<v1::PredictGridResponse>;
    type ReconstructStream = Replies<v1::ReconstructResponse>;

    async fn predict_states(
        &self,
        request: Request<v1::PredictStatesRequest>,
    ) -> Result<Response<Self::PredictStatesStream>, Status> {
        Ok(Response::new(states::predict_states(self, request.into_inner()).await?))
    }

    async fn evaluate_states(
        &self,
        request: Request<Streaming<v1::EvaluateStatesRequest>>,
    ) -> Result<Response<v1::EvaluateStatesResponse>, Status> {
        Ok(Response::new(evaluate::evaluate_states(self, request.into_inner()).await?))
    }

    async fn describe_model(
        &self,
        request: Request<v1::DescribeModelRequest>,
    ) -> Result<Response<v1::DescribeModelResponse>, Status> {
        Ok(Response::new(states::describe_model(self, request.into_inner()).await?))
    }

    async fn predict_grid(
        &self,
        request: Request<v1::PredictGridRequest>,
    ) -> Result<Response<Self::PredictGridStream>, Status> {
        Ok(Response::new(grid::predict_grid(self, request.into_inner()).await?))
    }

    async fn reconstruct(
        &self,
        request: Request<v1::ReconstructRequest>,
    ) -> Result<Response<Self::ReconstructStream>, Status> {
        Ok(Response::new(reconstruct::reconstruct(self, request.into_inner()).await?))
    }
}
