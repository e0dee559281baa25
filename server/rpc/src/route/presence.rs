//! `PredictPresence` and `NextJoint`: where the target is, and when several states are 1 at once.
//!
//! Invariant: persons, objects and nodes are independent; a share is relative to the sum over all nodes.

use tidemap_answer::StateOrCell;
use tidemap_plan::search::{anyone, next_above};
use tidemap_proto::{
    convert::{
        search::{JointQuestion, PresenceQuestion, joint_from_wire, presence_from_wire},
        time::timestamp,
    },
    v1,
};

use super::{Routes, places::NodeStates};
use crate::{
    lookup::{check_kind, check_limit, find_all, find_map},
    series::predict_series,
    status::{RouteError, RpcError},
};

/// Times whose probabilities are held at once.
const TIMES_PER_BLOCK: usize = 1_024;

pub(super) async fn predict_presence(
    routes: &Routes,
    request: v1::PredictPresenceRequest,
) -> Result<v1::PredictPresenceResponse, RpcError> {
    let handle = find_map(&routes.catalog, &request.map).await?;
    let view = handle.view();
    let PresenceQuestion { times_nanos: times, selector, object } = presence_from_wire(request)?;
    let NodeStates { nodes, states, unobserved, unobserved_nodes } =
        NodeStates::find(routes, handle.spec.name.as_str(), &view, &object).await?;
    let rows = predict_series(routes.predict_context(), &handle, &view, (states, times.clone()), selector).await?;
    let at = |(index, &time_nanos): (usize, &i64)| {
        let probabilities: Vec<f64> = rows.iter().map(|row| row[index].clamp(0.0, 1.0)).collect();
        let sum: f64 = probabilities.iter().sum();
        let shares = if sum > 0.0 { probabilities.iter().map(|p| p / sum).collect() } else { Vec::new() };
        v1::PresenceAt { time_nanos, shares, anybody: anyone(probabilities.iter().copied()), probabilities }
    };
    let topology = view.site().topology();
    let name = |&id| topology.node(id).map_or_else(|_| String::new(), |node| node.name.as_str().to_owned());
    Ok(v1::PredictPresenceResponse {
        nodes: nodes.iter().map(name).collect(),
        times: times.iter().enumerate().map(at).collect(),
        unobserved,
        unobserved_nodes,
    })
}

pub(super) async fn next_joint(
    routes: &Routes,
    request: v1::NextJointRequest,
) -> Result<v1::NextJointResponse, RpcError> {
    let handle = find_map(&routes.catalog, &request.map).await?;
    let view = handle.view();
    let JointQuestion { states: names, times_nanos: times, threshold, selector } = joint_from_wire(request)?;
    let predictions = times.len() as u64 * names.len() as u64;
    check_limit("predictions", predictions, routes.predictions, "setting max_predictions")?;
    let states = find_all(&view, |i| format!("states[{i}]"), names).await?;
    for state in &states {
        if let StateOrCell::State(id) = state {
            check_kind(&view, *id, "states")?;
        }
    }
    let mut best = (times[0], -1.0);
    // Later blocks are predicted only if no earlier one passes the threshold.
    for block in times.chunks(TIMES_PER_BLOCK) {
        let rows = predict_series(routes.predict_context(), &handle, &view, (states.clone(), block.to_vec()), selector)
            .await?;
        let together = |index: usize| rows.iter().map(move |row| row[index].clamp(0.0, 1.0));
        for (index, &time) in block.iter().enumerate() {
            let joint: f64 = together(index).product();
            if joint > best.1 {
                best = (time, joint);
            }
        }
        let passed = next_above((0..block.len()).map(together), threshold);
        if let Some(joint) = passed.map_err(RouteError::from)? {
            let (time, best_time) = (Some(timestamp(block[joint.index])), Some(timestamp(best.0)));
            return Ok(v1::NextJointResponse { time, probability: joint.probability, best_time });
        }
    }
    Ok(v1::NextJointResponse { time: None, probability: best.1, best_time: Some(timestamp(best.0)) })
}
