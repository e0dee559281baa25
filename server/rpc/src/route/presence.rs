//! `PredictPresence` and `NextJoint`: where the target is, and when several states are 1 at once.
//!
//! Invariant: persons, objects and nodes are independent; a share is relative to the sum over all nodes.

use tidemap_answer::StateOrCell;
use tidemap_plan::search::{anyone, next_above};
use tidemap_proto::{
    convert::search::{
        JointAt, JointQuestion, NodePresence, PresenceQuestion, joint_from_wire, joint_to_wire, presence_from_wire,
        presence_to_wire,
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
        NodePresence { time_nanos, shares, anybody: anyone(probabilities.iter().copied()), probabilities }
    };
    let presence = times.iter().enumerate().map(at).collect();
    let wire = presence_to_wire(view.site().topology(), &nodes, presence);
    Ok(v1::PredictPresenceResponse { unobserved, unobserved_nodes, ..wire })
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
    let mut best = JointAt { time_nanos: times[0], probability: -1.0 };
    // Later blocks are predicted only if no earlier one passes the threshold.
    for block in times.chunks(TIMES_PER_BLOCK) {
        let rows = predict_series(routes.predict_context(), &handle, &view, (states.clone(), block.to_vec()), selector)
            .await?;
        let together = |index: usize| rows.iter().map(move |row| row[index].clamp(0.0, 1.0));
        for (index, &time_nanos) in block.iter().enumerate() {
            let probability: f64 = together(index).product();
            if probability > best.probability {
                best = JointAt { time_nanos, probability };
            }
        }
        let passed = next_above((0..block.len()).map(together), threshold);
        if let Some(joint) = passed.map_err(RouteError::from)? {
            let passed = JointAt { time_nanos: block[joint.index], probability: joint.probability };
            return Ok(joint_to_wire(Some(passed), best));
        }
    }
    Ok(joint_to_wire(None, best))
}
