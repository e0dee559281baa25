//! `EvaluateViews`: the expected observations of a sensor from viewpoints at several times.
//!
//! Invariant: a reply per viewpoint, in their order; an unusable viewpoint does not affect the others.

use std::ops::ControlFlow;

use tidemap_model::StopSignal;
use tidemap_plan::{
    predicted::{PredictOptions, PredictedTimes},
    view::{TimedScene, view_many},
};
use tidemap_proto::{
    convert::exploration::{ViewsQuestion, view_to_wire, views_from_wire},
    v1,
};

use super::Explorations;
use crate::{
    lookup::{check_limit, find_map},
    replies::{Replies, compute_replies},
    status::{PlanError, RpcError},
};

pub(super) async fn evaluate_views(
    explorations: &Explorations,
    request: v1::EvaluateViewsRequest,
) -> Result<Replies<v1::EvaluateViewsResponse>, RpcError> {
    let view = find_map(&explorations.catalog, &request.map).await?.view();
    let ViewsQuestion { times_nanos, selector, viewpoints, scene, sensor } = views_from_wire(request)?;
    let looks = viewpoints.len() as u64 * times_nanos.len() as u64;
    check_limit("viewpoints x times", looks, explorations.limits.predictions, "setting max_predictions")?;
    Explorations::check_grid_times(&times_nanos)?;
    let options = PredictOptions { selector, ..explorations.predict_options() };
    let limits = explorations.look_limits();
    let permit = explorations.permits.take().await?;
    Ok(compute_replies(vec![permit], move |sink| {
        let is_left = || sink.is_closed();
        let stop = StopSignal::new(&is_left);
        let grid = PredictedTimes::new(&view, &times_nanos, &options, stop).map_err(PlanError::from)?;
        let scene = TimedScene::new(&grid, &scene, stop).map_err(PlanError::from)?;
        let send = |number: usize, seen: Result<Vec<Option<f64>>, _>| {
            let reply = view_to_wire(number, seen);
            if sink.send(reply) { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        view_many(&scene, &sensor, &viewpoints, limits, stop, send).map_err(PlanError::from)?;
        Ok(())
    }))
}
