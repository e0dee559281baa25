//! `PlanRoute`, `PlanPolicy` and `PredictEdges`: routes, policies and edge forecasts.
//!
//! Invariant: each edge is predicted for the time when the robot reaches it, and an answer is of one view.

use std::{sync::Arc, time::Duration};

use tidemap_map::topology::Edge;
use tidemap_model::{EarlyStop, StopSignal};
use tidemap_plan::{
    encounters::{NEAR_M, NEAR_MAX_CELLS},
    policy::solve_policy,
    route::{PlanRouteError, plan_routes, success_interval},
};
use tidemap_proto::{
    convert::{
        query::selector_from_wire,
        route::{
            POLICY_CELLS_MAX, confidence_from_wire, later, policy_from_wire, policy_to_wire, prediction_to_wire,
            route_from_wire, routes_to_wire,
        },
        search::{plan_within_from_wire, speed_from_wire},
        time::instant_from_wire,
    },
    v1,
};

use super::{
    Routes,
    edges::{Edges, ForecastsFrom, PeopleAhead},
    places::find_node,
};
use crate::status::{Problem, RouteError, RpcError};

/// Maximum number of edges of a reply.
const REPORTED_EDGES_MAX: usize = 100_000;

pub(super) async fn plan_route(
    routes: &Routes,
    request: v1::PlanRouteRequest,
) -> Result<v1::PlanRouteResponse, RpcError> {
    let (handle, view, topology) = routes.find(&request.map).await?;
    let from = find_node(&request.map, &topology, &request.from)?;
    let to = find_node(&request.map, &topology, &request.to)?;
    let question = route_from_wire(&request)?;
    let selector = selector_from_wire("model", request.model)?;
    let within = Duration::from_nanos(plan_within_from_wire(request.plan_within)?);
    let speed = speed_from_wire(request.speed_m_per_s)?;
    let edges = Edges::new(routes, &handle, &view, selector, speed).await?;
    let people = match &question.avoided {
        Some(_) if topology.nodes().all(|node| node.pose.is_none()) => {
            return Err(Problem::NoNodePositions.of("avoid_people").into());
        }
        Some(avoided) => Some(routes.trainer.flow(&handle, &view, ("avoid_people", &avoided.source)).await?),
        None => None,
    };
    if let (Some(avoided), Some(flow)) = (&question.avoided, &people) {
        let max_m = NEAR_MAX_CELLS * flow.options().raster.edge_m;
        if avoided.near_m > max_m {
            return Err(Problem::TooFar { near_m: avoided.near_m, max_m }.of("near_m").into());
        }
    }

    let (over, ends) = (Arc::clone(&topology), (request.from, request.to));
    let work = move |stop: StopSignal<'_>| {
        let near_m = question.avoided.as_ref().map_or(NEAR_M, |avoided| avoided.near_m);
        let people = people.as_ref().map(|flow| PeopleAhead::new(flow, near_m, &view, &over));
        let mut ahead = ForecastsFrom { edges: &edges, reference_nanos: question.reference_nanos, people };
        let planned = plan_routes(&over, from, to, question.when, &question.options, &mut ahead, || stop.is_set());
        match planned {
            Ok(planned) => Ok(routes_to_wire(&planned, question.reference_nanos, &over, |edge| {
                [edges.reports(edge), edges.pending_reports(edge)]
            })),
            Err(error) => Err(with_node_names(error, ends, question.reference_nanos)),
        }
    };
    Ok(routes.run_plan(Some(within), work).await??)
}

/// Replaces the node numbers in a planner's error by names.
fn with_node_names(error: PlanRouteError, (from, to): (String, String), reference_nanos: i64) -> RouteError {
    match error {
        PlanRouteError::Unreachable { .. } => RouteError::NoWay { from, to },
        PlanRouteError::BeyondHorizon { horizon_secs, .. } => RouteError::TooLong { from, to, horizon_secs },
        PlanRouteError::TooLate { by_secs, .. } => {
            RouteError::TooLate { from, to, by_nanos: later(reference_nanos, by_secs) }
        }
        other => RouteError::Plan(other),
    }
}

pub(super) async fn plan_policy(
    routes: &Routes,
    request: v1::PlanPolicyRequest,
) -> Result<v1::PlanPolicyResponse, RpcError> {
    let (handle, view, topology) = routes.find(&request.map).await?;
    let to = find_node(&request.map, &topology, &request.to)?;
    let time_nanos = instant_from_wire("start_time", request.start_time)?;
    let options = policy_from_wire(&request)?;
    let selector = selector_from_wire("model", request.model)?;
    let speed = speed_from_wire(request.speed_m_per_s)?;
    let (nodes, slots) = (topology.nodes().len(), options.slots);
    if nodes.saturating_mul(slots) > POLICY_CELLS_MAX {
        return Err(RouteError::PolicyTooLarge { nodes, slots }.into());
    }
    let edges = Edges::new(routes, &handle, &view, selector, speed).await?;
    let work = move |stop: StopSignal<'_>| {
        let mut ahead = ForecastsFrom { edges: &edges, reference_nanos: time_nanos, people: None };
        let table = solve_policy(&topology, to, &options, &mut ahead, || stop.is_set()).map_err(RouteError::from)?;
        Ok::<_, RouteError>(policy_to_wire(&table, time_nanos, &topology))
    };
    Ok(routes.run_plan(None, work).await??)
}

pub(super) async fn predict_edges(
    routes: &Routes,
    request: v1::PredictEdgesRequest,
) -> Result<v1::PredictEdgesResponse, RpcError> {
    let (handle, view, _) = routes.find(&request.map).await?;
    // Closed edges are predicted as well.
    let topology = Arc::clone(view.site().topology());
    let time_nanos = instant_from_wire("time", request.time)?;
    let selector = selector_from_wire("model", request.model)?;
    let speed = speed_from_wire(request.speed_m_per_s)?;
    let confidence = confidence_from_wire(request.confidence)?;
    let found = topology.edges().len();
    if found > REPORTED_EDGES_MAX {
        return Err(RouteError::TooManyEdges { found, max: REPORTED_EDGES_MAX }.into());
    }
    let edges = Edges::new(routes, &handle, &view, selector, speed).await?;
    let work = move |stop: StopSignal<'_>| {
        let predict = |edge: &Edge| {
            stop.check()?;
            let forecast = edges.forecast(edge, time_nanos);
            let interval = success_interval(forecast.success, forecast.evidence, confidence);
            Ok(prediction_to_wire((&topology, edge), forecast, interval, edges.reports(edge.id)))
        };
        topology.edges().map(predict).collect::<Result<_, EarlyStop>>()
    };
    Ok(v1::PredictEdgesResponse { edges: routes.run_plan(None, work).await?? })
}
