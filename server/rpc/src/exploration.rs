//! `ExplorationService`: the expected information of observations, and plans of where and when to observe.
//!
//! Invariant: a request is answered from one view, off the async threads. Its cost is checked before anything is
//! computed, and plans have permits of their own, so that predictions do not wait for them.

use std::sync::Arc;

use tidemap_ingest::{catalog::Catalog, handle::MapHandle};
use tidemap_map::site::SiteEdit;
use tidemap_plan::{predicted::PredictOptions, view::ViewLimits};
use tidemap_proto::{
    convert::exploration::{VisitReport, reachability_to_wire, reached_places_to_wire, visit_from_wire},
    v1::{self, exploration_service_server::ExplorationService},
};
use tonic::{Request, Response};

use super::{
    RpcReply,
    lookup::{check_limit, check_on_grid, find_map},
    map::edit_site,
    permits::{Permits, processors},
    query::Queries,
    replies::{Replies, compute_replies},
    route::Routes,
    series::PredictContext,
    status::RpcError,
    training::ModelTrainer,
};

mod day;
mod information;
mod locations;
mod presence;
mod slot;
mod tour;
mod views;
mod worth;

/// Maximum number of times of a grid in one request. The phasors of all times are held at once: 33 KB per time with the
/// maximum number of periodicities.
const GRID_TIMES_MAX: u64 = 2_000;

/// Number of places in one reply.
const PLACES_PER_REPLY: usize = 1_000;

/// Limits of plans.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlanLimits {
    /// Maximum number of predictions of one request.
    pub predictions: u64,
    /// Maximum number of grid cells of one request.
    pub cells: u64,
    /// Maximum of viewpoints × times × cells that the rays of one view pass, of one request.
    pub view_work: u64,
}

/// The service.
#[derive(Clone, Debug)]
pub(crate) struct Explorations {
    catalog: Arc<Catalog>,
    limits: PlanLimits,
    trainer: Arc<ModelTrainer>,
    permits: Permits,
    /// Plans tasks over the topological map.
    routes: Arc<Routes>,
}

impl Explorations {
    /// Creates the service with these limits. The trainer of `queries` trains its models.
    pub(crate) fn new(catalog: Arc<Catalog>, queries: &Queries, limits: PlanLimits, routes: Arc<Routes>) -> Self {
        // A plan keeps all processors busy; with more plans at once, each would only wait for the others.
        Self { catalog, limits, trainer: queries.trainer(), permits: Permits::new(processors().max(2)), routes }
    }

    fn predict_options(&self) -> PredictOptions {
        PredictOptions { max_cells: self.limits.cells, ..PredictOptions::default() }
    }

    fn predict_context(&self) -> PredictContext<'_> {
        PredictContext { trainer: &self.trainer, permits: &self.permits, predictions: self.limits.predictions }
    }

    /// Checks the number of times of a grid.
    fn check_grid_times(times_nanos: &[i64]) -> Result<(), RpcError> {
        check_limit("times", times_nanos.len() as u64, GRID_TIMES_MAX, "one request about a grid")
    }

    fn look_limits(&self) -> ViewLimits {
        ViewLimits { max_work: self.limits.view_work }
    }

    async fn visited(&self, request: v1::ReportVisitRequest) -> Result<v1::ReportVisitResponse, RpcError> {
        let handle = find_map(&self.catalog, &request.map).await?;
        let VisitReport { at_m, reached, utc_nanos } = visit_from_wire(&request)?;
        check_on_grid(&handle.view(), "at", at_m)?;
        let utc_nanos = utc_nanos.unwrap_or_else(|| self.catalog.context().clock.now_nanos());
        edit_site(&handle, SiteEdit::Visit { at_m, reached, utc_nanos }).await?;
        let rate = handle.view().site().reachability().rate(at_m[0], at_m[1]);
        Ok(reachability_to_wire(rate))
    }
}

/// Sends the places that robots have tried to reach.
async fn reached_places(
    permits: &Permits,
    handle: &MapHandle,
) -> Result<Replies<v1::ListReachabilityResponse>, RpcError> {
    let (view, permit) = (handle.view(), permits.take().await?);
    Ok(compute_replies(vec![permit], move |sink| {
        let mut places = view.site().reachability().parts().peekable();
        while places.peek().is_some() {
            let next: Vec<_> = places.by_ref().take(PLACES_PER_REPLY).collect();
            if !sink.send(reached_places_to_wire(&next)) {
                break;
            }
        }
        Ok(())
    }))
}

#[tonic::async_trait]
impl ExplorationService for Explorations {
    type GetInformationStream = Replies<v1::GetInformationResponse>;
    type EvaluateViewsStream = Replies<v1::EvaluateViewsResponse>;
    type ListReachabilityStream = Replies<v1::ListReachabilityResponse>;

    async fn get_information(
        &self,
        request: Request<v1::GetInformationRequest>,
    ) -> RpcReply<Self::GetInformationStream> {
        Ok(Response::new(information::get_information(self, request.into_inner()).await?))
    }

    async fn evaluate_views(&self, request: Request<v1::EvaluateViewsRequest>) -> RpcReply<Self::EvaluateViewsStream> {
        Ok(Response::new(views::evaluate_views(self, request.into_inner()).await?))
    }

    async fn plan_tour(&self, request: Request<v1::PlanTourRequest>) -> RpcReply<v1::PlanTourResponse> {
        Ok(Response::new(tour::plan_tour(self, request.into_inner()).await?))
    }

    async fn plan_day(&self, request: Request<v1::PlanDayRequest>) -> RpcReply<v1::PlanDayResponse> {
        Ok(Response::new(day::plan_day(self, request.into_inner()).await?))
    }

    async fn plan_slot(&self, request: Request<v1::PlanSlotRequest>) -> RpcReply<v1::PlanSlotResponse> {
        Ok(Response::new(slot::plan_slot(self, request.into_inner()).await?))
    }

    async fn report_visit(&self, request: Request<v1::ReportVisitRequest>) -> RpcReply<v1::ReportVisitResponse> {
        Ok(Response::new(self.visited(request.into_inner()).await?))
    }

    async fn list_reachability(
        &self,
        request: Request<v1::ListReachabilityRequest>,
    ) -> RpcReply<Self::ListReachabilityStream> {
        let handle = find_map(&self.catalog, &request.into_inner().map).await?;
        Ok(Response::new(reached_places(&self.permits, &handle).await?))
    }
}
