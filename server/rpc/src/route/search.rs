//! `PlanSearch`: in which order to search the nodes for the target.
//!
//! Invariant: a goal is a node whose state was observed; the probabilities, the nodes and the routes are of one view.

use std::{sync::Arc, time::Duration};

use tidemap_map::topology::{NodeId, Roads};
use tidemap_model::{StopSignal, selector::ModelSelector};
use tidemap_plan::search::{
    CHANGING_GOALS_MAX, EXACT_GOALS_MAX, Effort, GOALS_MAX, Goal, SearchError, search, search_changing,
};
use tidemap_proto::{
    convert::{
        query::selector_from_wire,
        search::{object_from_wire, plan_to_wire, plan_within_from_wire, search_from_wire, speed_from_wire},
        time::instant_from_wire,
    },
    v1,
};

use super::{
    Routes,
    edges::Edges,
    places::{NodeStates, find_node},
};
use crate::{
    series::{Predictor, predict_series},
    status::{RouteError, RpcError},
};

/// Checks the number of goals before anything is predicted.
fn check_count(found: usize, effort: Effort, for_arrival: bool) -> Result<(), SearchError> {
    if effort == Effort::Exact && found > EXACT_GOALS_MAX {
        return Err(SearchError::TooManyForExact { found });
    }
    let max = if for_arrival { CHANGING_GOALS_MAX } else { GOALS_MAX };
    if found > max { Err(SearchError::TooMany { found, max }) } else { Ok(()) }
}

pub(super) async fn plan_search(
    routes: &Routes,
    request: v1::PlanSearchRequest,
) -> Result<v1::PlanSearchResponse, RpcError> {
    let (handle, view, topology) = routes.find(&request.map).await?;
    let start = find_node(&request.map, &topology, &request.start)?;
    let time_nanos = instant_from_wire("start_time", request.start_time)?;
    let selector = selector_from_wire("model", request.model)?;
    let options = search_from_wire(&request)?;
    let within = Duration::from_nanos(plan_within_from_wire(request.plan_within)?);
    let speed = speed_from_wire(request.speed_m_per_s)?;
    let object = object_from_wire(request.object)?;
    let found = NodeStates::find(routes, &request.map, &view, &object).await?;
    let NodeStates { nodes, states, unobserved, unobserved_nodes } = found;
    check_count(nodes.len(), options.effort, request.for_arrival).map_err(RouteError::from)?;

    let requested = (states.clone(), vec![time_nanos]);
    let rows = predict_series(routes.predict_context(), &handle, &view, requested, selector).await?;
    let goals: Vec<Goal> =
        nodes.iter().zip(&rows).map(|(&node, row)| Goal { node, probability: row[0].clamp(0.0, 1.0) }).collect();
    if !request.for_arrival && goals.iter().all(|goal| goal.probability == 0.0) {
        return Err(RouteError::Nobody(goals.len()).into());
    }
    let predictor = match request.for_arrival {
        true => Some(Predictor::new(routes.predict_context(), &handle, &view, states, selector).await?),
        false => None,
    };

    let travelled = match request.as_travelled {
        true => Some(Edges::new(routes, &handle, &view, ModelSelector::default(), speed).await?),
        false => None,
    };

    let walked = Arc::clone(&topology);
    let work = move |stop: StopSignal<'_>| {
        let roads = Roads::new(&walked, |edge| match &travelled {
            Some(travelled) => Some(travelled.forecast(edge, time_nanos).duration_secs),
            None => Some(edge.extent.secs_at(speed)),
        })?;
        let plan = match predictor {
            None => search(&roads, start, &goals, &options, || stop.is_set()),
            Some(predictor) => {
                let probability = |node: NodeId, arrival_secs: f64| {
                    let later_nanos = (arrival_secs * 1e9) as i64;
                    // The nodes are in ascending order.
                    let index = nodes.binary_search(&node).unwrap_or(usize::MAX);
                    predictor.at(index, time_nanos.saturating_add(later_nanos)).clamp(0.0, 1.0)
                };
                search_changing(&roads, start, &nodes, probability, &options, || stop.is_set())
            }
        };
        plan.map_err(|error| match (error, walked.node(start)) {
            (SearchError::Unreachable { .. }, Ok(node)) => {
                RouteError::Unreachable { start: node.name.to_string(), goals: goals.len() }
            }
            (error, _) => error.into(),
        })
    };
    let plan = routes.run_plan(Some(within), work).await??;
    Ok(v1::PlanSearchResponse { unobserved, unobserved_nodes, ..plan_to_wire(&plan, &topology) })
}
