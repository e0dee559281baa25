//! `PlanTour`: goals for one exploration run.
//!
//! Invariant: the tour and the reachability are of one view.

use tidemap_map::view::MapView;
use tidemap_model::StopSignal;
use tidemap_plan::{
    predicted::{PredictOptions, PredictedGrid},
    tour::{TourQuestion, plan_tour as plan},
};
use tidemap_proto::{
    convert::{
        exploration::{tour_from_wire, tour_to_wire},
        query::{check_for_cells, selector_from_wire},
        site::point_from_wire,
        time::instant_from_wire,
    },
    v1,
};

use super::Explorations;
use crate::rpc::{
    lookup::find_map,
    permits::run_while_awaited,
    status::{PlanError, RpcError},
};

pub(super) async fn plan_tour(
    explorations: &Explorations,
    request: v1::PlanTourRequest,
) -> Result<v1::PlanTourResponse, RpcError> {
    let view = find_map(&explorations.catalog, &request.map).await?.view();
    let time_nanos = instant_from_wire("time", request.time)?;
    let selector = selector_from_wire("model", request.model)?;
    check_for_cells("model", selector)?;
    let question = tour_question(&view, &request)?;
    let options = PredictOptions { selector, ..explorations.predict_options() };
    let work = move |stop: StopSignal<'_>| {
        let grid = PredictedGrid::new(&view, time_nanos, &options, stop)?;
        Ok::<_, PlanError>(plan(&grid, view.site().reachability(), &question, stop)?)
    };
    let tour = run_while_awaited(explorations.permits.take().await?, None, work).await??;
    Ok(tour_to_wire(&tour))
}

/// The tour that is asked for, from the given start or the charger of the map.
///
/// # Errors
/// The map has no grid, or there is no start, or a field is invalid.
pub(super) fn tour_question(view: &MapView, request: &v1::PlanTourRequest) -> Result<TourQuestion, RpcError> {
    view.grid().ok_or(PlanError::from(tidemap_plan::predicted::PredictError::NoGrid))?;
    let start = request.start.map(|start| point_from_wire("start", start)).transpose()?;
    let start = start.or(view.site().charger_m()).ok_or(PlanError::NoStart)?;
    Ok(tour_from_wire(request, start)?)
}
