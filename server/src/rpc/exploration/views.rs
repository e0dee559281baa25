//! `EvaluateViews`: what a sensor is expected to see from viewpoints at several times.
//!
//! Invariant: a reply per viewpoint, in their order; an unusable viewpoint does not affect the others.

use std::ops::ControlFlow;

use tidemap_model::StopSignal;
use tidemap_plan::{
    predicted::{PredictOptions, PredictedTimes},
    view::{TimedScene, Viewpoint, view_many},
};
use tidemap_proto::{
    convert::{
        InvalidField,
        exploration::{scene_from_wire, sensor_from_wire, times_from_wire, viewpoint_from_wire},
        query::{check_for_cells, selector_from_wire},
    },
    v1,
};

use super::Explorations;
use crate::rpc::{
    lookup::{check_limit, find_map},
    replies::{Replies, compute_replies},
    status::{PlanError, RpcError},
};

pub(super) async fn evaluate_views(
    explorations: &Explorations,
    request: v1::EvaluateViewsRequest,
) -> Result<Replies<v1::EvaluateViewsResponse>, RpcError> {
    let view = find_map(&explorations.catalog, &request.map).await?.view();
    times_from_wire("times_nanos", &request.times_nanos)?;
    let selector = selector_from_wire("model", request.model)?;
    check_for_cells("model", selector)?;
    if request.viewpoints.is_empty() {
        return Err(InvalidField::new("viewpoints", "name at least one").into());
    }
    let looks = request.viewpoints.len() as u64 * request.times_nanos.len() as u64;
    check_limit("viewpoints x times", looks, explorations.limits.predictions, "setting max_predictions")?;
    Explorations::check_grid_times(&request.times_nanos)?;
    let scene_options = scene_from_wire(request.certainty, request.threshold)?;
    let sensor = sensor_from_wire(request.sensor);
    let viewpoints: Vec<Viewpoint> = request.viewpoints.iter().map(viewpoint_from_wire).collect();
    let options = PredictOptions { selector, ..explorations.predict_options() };
    let limits = explorations.look_limits();
    let permit = explorations.permits.take().await?;
    Ok(compute_replies(vec![permit], move |sink| {
        let is_left = || sink.is_closed();
        let stop = StopSignal::new(&is_left);
        let times = &request.times_nanos;
        let grid = PredictedTimes::new(&view, times, &options, stop).map_err(PlanError::from)?;
        let scene = TimedScene::new(&grid, &scene_options, stop).map_err(PlanError::from)?;
        let tell = |number: usize, told: Result<Vec<Option<f64>>, _>| {
            let mut reply = v1::EvaluateViewsResponse {
                viewpoint: u32::try_from(number).unwrap_or(u32::MAX),
                ..Default::default()
            };
            match told {
                Ok(bits) => reply.information_bits = bits.into_iter().map(|bits| bits.unwrap_or(f64::NAN)).collect(),
                Err(error) => reply.reason = ToString::to_string(&error),
            }
            if sink.send(reply) { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        view_many(&scene, &sensor, &viewpoints, limits, stop, tell).map_err(PlanError::from)?;
        Ok(())
    }))
}
