//! `PlanTour`: goals for one exploration run.
//!
//! Invariant: the tour and the reachability are of one view.

use tidemap_map::view::MapView;
use tidemap_model::StopSignal;
use tidemap_plan::{
    predicted::{PredictError, PredictOptions, PredictedGrid},
    tour::{TourQuestion, plan_tour_around as plan},
};
use tidemap_proto::{
    convert::exploration::{TourRequest, tour_question_from_wire, tour_to_wire},
    v1,
};

use super::Explorations;
use crate::{
    lookup::find_map,
    permits::run_while_awaited,
    status::{PlanError, RpcError},
};

pub(super) async fn plan_tour(
    explorations: &Explorations,
    request: v1::PlanTourRequest,
) -> Result<v1::PlanTourResponse, RpcError> {
    let view = find_map(&explorations.catalog, &request.map).await?.view();
    let (time_nanos, selector, tour) = tour_question_from_wire(&request)?;
    let question = starting_on(&view, tour)?;
    let options = PredictOptions { selector, ..explorations.predict_options() };
    let work = move |stop: StopSignal<'_>| {
        let grid = PredictedGrid::new(&view, time_nanos, &options, stop)?;
        Ok::<_, PlanError>(plan(&grid, (view.site().reachability(), view.site().no_go()), &question, stop)?)
    };
    let tour = run_while_awaited(explorations.permits.take().await?, None, work).await??;
    Ok(tour_to_wire(&tour))
}

/// The question for a tour, from the given start or the charger of the map.
///
/// # Errors
/// The map has no grid, or there is no start.
pub(super) fn starting_on(view: &MapView, tour: TourRequest) -> Result<TourQuestion, PlanError> {
    view.grid().ok_or(PredictError::NoGrid)?;
    tour.starting_at(view.site().charger_m()).ok_or(PlanError::NoStart)
}
