//! `TopologyService`, `RouteService` and `SearchService`: the topological map, and plans over it.
//!
//! An edit of the topology is one event of the log; the writer takes one at a time, so that a load is checked against
//! the topology that it replaces, and is taken whole. Searches take the nodes whose state was observed as goals, with
//! probabilities by any model ([`super::series`]).
//!
//! Invariant: an edit is durable and published when it is answered. A plan is made from one view, off the async
//! threads, with its own permits, and ends at its deadline or when its client is gone.

use std::{sync::Arc, time::Duration};

use tidemap_map::{
    site::SiteEdit,
    topology::{Topology, TopologyEdit},
    view::MapView,
};
use tidemap_model::StopSignal;
use tidemap_proto::{
    convert::{
        topology::{edit_from_wire, load_from_wire, topology_to_wire},
        traversals::{failure_to_wire, is_of},
    },
    v1::{
        self, route_service_server::RouteService, search_service_server::SearchService,
        topology_service_server::TopologyService,
    },
};
use tonic::{Request, Response};

use super::{
    RpcReply,
    fitting::ModelFitter,
    lookup::find_map,
    map::edit_site,
    permits::{Permits, processors, run_blocking, run_while_awaited},
    query::Queries,
    series::PredictContext,
    status::RpcError,
};
use crate::{catalog::Catalog, ingest::handle::MapHandle};

mod edges;
mod places;
mod plan;
mod presence;
mod search;

#[derive(Debug)]
pub(crate) struct Routes {
    catalog: Arc<Catalog>,
    /// Maximum number of predictions of one request.
    predictions: u64,
    fitting: Arc<ModelFitter>,
    permits: Permits,
}

impl Routes {
    /// Plans within this limit; models are trained by the fitter of `queries`.
    pub(crate) fn new(catalog: Arc<Catalog>, queries: &Queries, predictions: u64) -> Self {
        Self { catalog, predictions, fitting: queries.fitting(), permits: Permits::new(processors().max(2)) }
    }

    fn predict_context(&self) -> PredictContext<'_> {
        PredictContext { fitting: &self.fitting, permits: &self.permits, predictions: self.predictions }
    }

    /// A map, its present view and its topology.
    async fn find(&self, map: &str) -> Result<(Arc<MapHandle>, Arc<MapView>, Arc<Topology>), RpcError> {
        let handle = find_map(&self.catalog, map).await?;
        let view = handle.view();
        let topology = Arc::clone(view.site().topology());
        Ok((handle, view, topology))
    }

    /// Runs work on a blocking thread, with a permit.
    async fn run_blocking<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Result<T, RpcError> {
        run_blocking(self.permits.take().await?, work).await
    }

    /// Runs a plan on a blocking thread, with a permit. It is told to stop `within` a time of its start, and when its
    /// client is gone.
    async fn run_plan<T: Send + 'static>(
        &self,
        within: Option<Duration>,
        work: impl FnOnce(StopSignal<'_>) -> T + Send + 'static,
    ) -> Result<T, RpcError> {
        run_while_awaited(self.permits.take().await?, within, work).await
    }

    /// Edits a map's topology. Gives the numbers of nodes and edges after that.
    async fn edit(&self, map: &str, edit: TopologyEdit) -> Result<(u32, u32), RpcError> {
        let handle = find_map(&self.catalog, map).await?;
        edit_site(&handle, SiteEdit::Topology(edit)).await?;
        let view = handle.view();
        let topology = view.site().topology();
        let count = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
        Ok((count(topology.nodes().len()), count(topology.edges().len())))
    }
}

#[tonic::async_trait]
impl TopologyService for Routes {
    async fn load_topology(&self, request: Request<v1::LoadTopologyRequest>) -> RpcReply<v1::LoadTopologyResponse> {
        let request = request.into_inner();
        let map = request.map.clone();
        find_map(&self.catalog, &map).await?;
        let edit = self.run_blocking(move || load_from_wire(&request)).await?.map_err(RpcError::from)?;
        let (nodes, edges) = self.edit(&map, edit).await?;
        Ok(Response::new(v1::LoadTopologyResponse { nodes, edges }))
    }

    async fn edit_topology(&self, request: Request<v1::EditTopologyRequest>) -> RpcReply<v1::EditTopologyResponse> {
        let v1::EditTopologyRequest { map, edit } = request.into_inner();
        find_map(&self.catalog, &map).await?;
        let edit = edit_from_wire(edit.as_ref()).map_err(RpcError::from)?;
        let (nodes, edges) = self.edit(&map, edit).await?;
        Ok(Response::new(v1::EditTopologyResponse { nodes, edges }))
    }

    async fn get_topology(&self, request: Request<v1::GetTopologyRequest>) -> RpcReply<v1::GetTopologyResponse> {
        let view = find_map(&self.catalog, &request.get_ref().map).await?.view();
        Ok(Response::new(self.run_blocking(move || topology_to_wire(view.site().topology())).await?))
    }

    async fn list_failures(&self, request: Request<v1::ListFailuresRequest>) -> RpcReply<v1::ListFailuresResponse> {
        let v1::ListFailuresRequest { map, limit, edge } = request.into_inner();
        let view = find_map(&self.catalog, &map).await?.view();
        let max_count = if limit == 0 { usize::MAX } else { usize::try_from(limit).unwrap_or(usize::MAX) };
        let asked = view.site().failures().newest_first();
        let asked = asked.filter(|failure| edge.as_ref().is_none_or(|edge| is_of(failure, edge)));
        let failures = asked.take(max_count).map(failure_to_wire).collect();
        Ok(Response::new(v1::ListFailuresResponse { failures }))
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
