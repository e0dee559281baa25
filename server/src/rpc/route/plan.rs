//! `PlanRoute`, `PlanPolicy` and `PredictEdges`: the ways of a map at a time.
//!
//! Invariant: each edge is predicted for when the robot reaches it, and everything of an answer is of one view.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use tidemap_map::{
    edge_forecast::EdgeForecast,
    topology::{Edge, EdgeId, NodeId, Topology},
};
use tidemap_plan::{
    policy::{PolicyAction, PolicyTable, solve_policy},
    route::{Route, RouteError as PlanRouteError, Routes as Planned, plan_routes, success_interval},
};
use tidemap_proto::{
    convert::{
        query::selector_from_wire,
        route::{POLICY_CELLS_MAX, certainty_to_wire, confidence_from_wire, policy_from_wire, route_from_wire},
        search::{plan_within_from_wire, speed_from_wire},
        time::{duration, instant_from_wire, timestamp},
        topology::edge_to_wire,
    },
    v1,
};

use super::{
    Routes,
    edges::{Ahead, Edges, later},
    error::RouteError,
    places::find_node,
    search::Waiting,
};
use crate::rpc::{lookup::find_map, status::RpcError};

/// Most edges that are told of at once.
const EDGES_TOLD_MAX: usize = 100_000;

pub(super) async fn plan_route(
    routes: &Routes,
    request: v1::PlanRouteRequest,
) -> Result<v1::PlanRouteResponse, RpcError> {
    let handle = find_map(&routes.catalog, &request.map)?;
    let view = handle.view();
    let topology = Arc::clone(view.site().topology());
    let from = find_node(&request.map, &topology, &request.from)?;
    let to = find_node(&request.map, &topology, &request.to)?;
    let question = route_from_wire(&request)?;
    let selector = selector_from_wire("model", request.model)?;
    let within = Duration::from_nanos(plan_within_from_wire(request.plan_within)?);
    let speed = speed_from_wire(request.speed_m_per_s)?;
    let edges = Edges::new(routes, &handle, &view, selector, speed).await?;

    let is_given_up = Arc::new(AtomicBool::new(false));
    let _waiting = Waiting(Arc::clone(&is_given_up));
    let (over, ends) = (Arc::clone(&topology), (request.from, request.to));
    let work = move || {
        let deadline = Instant::now() + within;
        let until = || is_given_up.load(Ordering::Relaxed) || Instant::now() >= deadline;
        let mut ahead = Ahead { edges: &edges, reference_nanos: question.reference_nanos };
        let planned = plan_routes(&over, from, to, question.when, &question.options, &mut ahead, until);
        match planned {
            Ok(planned) => Ok(to_wire(&planned, question.reference_nanos, &over, &edges)),
            Err(error) => Err(with_node_names(error, ends, question.reference_nanos)),
        }
    };
    Ok(routes.off_threads(work).await??)
}

/// A planner's refusal in the words of who asked: names for numbers.
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

fn to_wire(planned: &Planned, reference_nanos: i64, topology: &Topology, edges: &Edges) -> v1::PlanRouteResponse {
    let time = |secs| later(reference_nanos, secs);
    let route = |route: &Route| v1::Route {
        steps: route
            .steps
            .iter()
            .map(|step| v1::RouteStep {
                edge: ends(topology, step.edge),
                start_nanos: time(step.start_secs),
                duration_secs: step.duration_secs,
                success: step.success,
                success_lower: step.success_interval.lower,
                success_upper: step.success_interval.upper,
                reports: edges.reports(step.edge),
            })
            .collect(),
        departure_nanos: time(route.departure_secs),
        arrival_nanos: time(route.arrival_secs),
        expected_secs: route.expected_secs,
        success: route.success,
        success_lower: route.success_interval.lower,
        success_upper: route.success_interval.upper,
        cost: route.cost,
    };
    v1::PlanRouteResponse {
        routes: planned.routes.iter().map(route).collect(),
        certainty: certainty_to_wire(planned.certainty).into(),
    }
}

fn ends(topology: &Topology, edge: EdgeId) -> Option<v1::EdgeEnds> {
    topology.edge(edge).ok().map(|edge| edge_to_wire(topology, edge))
}

pub(super) async fn plan_policy(
    routes: &Routes,
    request: v1::PlanPolicyRequest,
) -> Result<v1::PlanPolicyResponse, RpcError> {
    let handle = find_map(&routes.catalog, &request.map)?;
    let view = handle.view();
    let topology = Arc::clone(view.site().topology());
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
    let is_given_up = Arc::new(AtomicBool::new(false));
    let _waiting = Waiting(Arc::clone(&is_given_up));
    let work = move || {
        let until = || is_given_up.load(Ordering::Relaxed);
        let mut ahead = Ahead { edges: &edges, reference_nanos: time_nanos };
        let table = solve_policy(&topology, to, &options, &mut ahead, until).map_err(RouteError::from)?;
        Ok::<_, RouteError>(policy_to_wire(&table, time_nanos, &topology))
    };
    Ok(routes.off_threads(work).await??)
}

fn policy_to_wire(table: &PolicyTable, time_nanos: i64, topology: &Topology) -> v1::PlanPolicyResponse {
    let node = |&node: &NodeId| {
        let name = topology.node(node).map_or_else(|_| String::new(), |node| node.name.as_str().to_owned());
        let mut told = v1::NodePolicy { node: name, ..v1::NodePolicy::default() };
        let mut taken: Vec<EdgeId> = Vec::new();
        for entry in (0..table.slots()).filter_map(|slot| table.entry(node, slot)) {
            let mut index = 0;
            let action = match entry.action {
                PolicyAction::Take(edge) => {
                    index = taken.iter().position(|&other| other == edge).unwrap_or_else(|| {
                        taken.push(edge);
                        taken.len() - 1
                    });
                    v1::PolicyAction::Edge
                }
                PolicyAction::Wait => v1::PolicyAction::Wait,
                PolicyAction::Arrived => v1::PolicyAction::Arrived,
                PolicyAction::Nothing => v1::PolicyAction::None,
            };
            told.actions.push(action.into());
            told.edge_indices.push(u32::try_from(index).unwrap_or(u32::MAX));
            told.expected_secs.push(entry.expected_secs);
            told.reach.push(entry.reach);
        }
        told.edges = taken.into_iter().filter_map(|edge| ends(topology, edge)).collect();
        told
    };
    let slot_nanos = (table.slot_secs() * 1e9).round() as i64;
    v1::PlanPolicyResponse {
        start_time: Some(timestamp(time_nanos)),
        slot: Some(duration(slot_nanos)),
        slots: u32::try_from(table.slots()).unwrap_or(u32::MAX),
        nodes: table.nodes().iter().map(node).collect(),
    }
}

pub(super) async fn predict_edges(
    routes: &Routes,
    request: v1::PredictEdgesRequest,
) -> Result<v1::PredictEdgesResponse, RpcError> {
    let handle = find_map(&routes.catalog, &request.map)?;
    let view = handle.view();
    let topology = Arc::clone(view.site().topology());
    let time_nanos = instant_from_wire("time", request.time)?;
    let selector = selector_from_wire("model", request.model)?;
    let speed = speed_from_wire(request.speed_m_per_s)?;
    let confidence = confidence_from_wire(request.confidence)?;
    let found = topology.edges().len();
    if found > EDGES_TOLD_MAX {
        return Err(RouteError::TooManyEdges { found, most: EDGES_TOLD_MAX }.into());
    }
    let edges = Edges::new(routes, &handle, &view, selector, speed).await?;
    let work = move || {
        let told = |edge: &Edge| {
            let EdgeForecast { success, evidence, duration_secs } = edges.forecast(edge, time_nanos);
            let interval = success_interval(success, evidence, confidence);
            v1::PredictedEdge {
                edge: Some(edge_to_wire(&topology, edge)),
                success,
                success_lower: interval.lower,
                success_upper: interval.upper,
                duration_secs,
                reports: edges.reports(edge.id),
            }
        };
        v1::PredictEdgesResponse { edges: topology.edges().map(told).collect() }
    };
    routes.off_threads(work).await
}
