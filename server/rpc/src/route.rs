//! `TopologyService`, `LandmarkService`, `RouteService` and `SearchService`: the topological map, its landmarks, and
//! plans over it.
//!
//! Searches take the nodes whose state was observed as goals, with probabilities by any model ([`super::series`]).
//!
//! Invariant: a plan is made from one view, off the async threads, with its own permits, and ends at its deadline or
//! when its client is gone.

use std::{sync::Arc, time::Duration};

use tidemap_ingest::{catalog::Catalog, handle::MapHandle};
use tidemap_map::{topology::Topology, view::MapView};
use tidemap_model::StopSignal;
use tidemap_proto::v1::{self, route_service_server::RouteService, search_service_server::SearchService};
use tonic::{Request, Response};

use super::{
    RpcReply,
    lookup::find_map,
    permits::{Permits, processors, run_blocking, run_while_awaited},
    query::Queries,
    series::PredictContext,
    status::RpcError,
    training::ModelTrainer,
};

mod edges;
mod landmarks;
mod places;
mod plan;
mod presence;
mod search;
mod tasks;
mod topology;

#[derive(Debug)]
pub(crate) struct Routes {
    catalog: Arc<Catalog>,
    /// Maximum number of predictions of one request.
    predictions: u64,
    trainer: Arc<ModelTrainer>,
    permits: Permits,
}

impl Routes {
    /// Creates the services with this limit. The trainer of `queries` trains their models.
    pub(crate) fn new(catalog: Arc<Catalog>, queries: &Queries, predictions: u64) -> Self {
        Self { catalog, predictions, trainer: queries.trainer(), permits: Permits::new(processors().max(2)) }
    }

    fn predict_context(&self) -> PredictContext<'_> {
        PredictContext { trainer: &self.trainer, permits: &self.permits, predictions: self.predictions }
    }

    /// A map, its present view and its topology, without the edges through no-go areas.
    async fn find(&self, map: &str) -> Result<(Arc<MapHandle>, Arc<MapView>, Arc<Topology>), RpcError> {
        let handle = find_map(&self.catalog, map).await?;
        let view = handle.view();
        let topology = self.open_topology(&view).await?;
        Ok((handle, view, topology))
    }

    /// The topology without the edges through no-go areas.
    async fn open_topology(&self, view: &Arc<MapView>) -> Result<Arc<Topology>, RpcError> {
        if view.site().no_go().is_empty() {
            return Ok(Arc::clone(view.site().topology()));
        }
        let view = Arc::clone(view);
        self.run_blocking(move || view.site().open_topology()).await
    }

    /// Runs work on a blocking thread, with a permit.
    async fn run_blocking<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Result<T, RpcError> {
        run_blocking(self.permits.take().await?, work).await
    }

    /// Runs a plan on a blocking thread, with a permit. The plan gets a stop signal at `within` after its start, or
    /// when its client is gone.
    async fn run_plan<T: Send + 'static>(
        &self,
        within: Option<Duration>,
        work: impl FnOnce(StopSignal<'_>) -> T + Send + 'static,
    ) -> Result<T, RpcError> {
        run_while_awaited(self.permits.take().await?, within, work).await
    }
}

#[tonic::async_trait]
impl SearchService for Routes {
    async fn plan_search(&self, request: Request<v1::PlanSearchRequest>) -> RpcReply<v1::PlanSearchResponse> {
        Ok(Response::new(search::plan_search(self, request.into_inner()).await?))
    }

    async fn predict_presence(
        &self,
        request: Request<v1::PredictPresenceRequest>,
    ) -> RpcReply<v1::PredictPresenceResponse> {
        Ok(Response::new(presence::predict_presence(self, request.into_inner()).await?))
    }

    async fn next_joint(&self, request: Request<v1::NextJointRequest>) -> RpcReply<v1::NextJointResponse> {
        Ok(Response::new(presence::next_joint(self, request.into_inner()).await?))
    }
}

#[tonic::async_trait]
impl RouteService for Routes {
    async fn plan_route(&self, request: Request<v1::PlanRouteRequest>) -> RpcReply<v1::PlanRouteResponse> {
        Ok(Response::new(plan::plan_route(self, request.into_inner()).await?))
    }

    async fn plan_policy(&self, request: Request<v1::PlanPolicyRequest>) -> RpcReply<v1::PlanPolicyResponse> {
        Ok(Response::new(plan::plan_policy(self, request.into_inner()).await?))
    }

    async fn predict_edges(&self, request: Request<v1::PredictEdgesRequest>) -> RpcReply<v1::PredictEdgesResponse> {
        Ok(Response::new(plan::predict_edges(self, request.into_inner()).await?))
    }
}
