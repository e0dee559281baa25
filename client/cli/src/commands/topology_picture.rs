//! Pictures of the topological map at a time: the presence at its nodes, and the success of its edges.
//!
//! Invariant: nodes and edges without observations are grey; a map without any presence data is drawn anyway.

use std::collections::HashMap;

use tidemap_client::{
    queries::ModelSelector,
    routes::{EdgeName, NodePose, PresenceForecast, PresenceQuery},
};
use tonic::Code;

use super::Session;
use tidemap_formats::topology_svg::{self, PictureEdge, PictureNode, TopologyPicture};

/// A route drawn over the map.
#[derive(Clone, Debug, Default)]
pub(crate) struct Overlay {
    /// Edges of the route.
    pub(crate) way: Vec<EdgeName>,
    /// Whether an edge of the route represents all edges between its nodes, whatever their actions.
    pub(crate) any_action: bool,
    /// Nodes to number, in their order.
    pub(crate) numbered: Vec<String>,
}

/// Draws the map at a time.
pub(crate) async fn draw(
    session: &Session,
    map: &str,
    time_nanos: i64,
    model: ModelSelector,
    speed_m_per_s: Option<f64>,
    object: &str,
    overlay: Overlay,
) -> anyhow::Result<String> {
    let topology = session.client.topology(map).await?;
    let edges = session.client.predict_edges(map, time_nanos, model, speed_m_per_s).await?;
    let query = PresenceQuery { map: map.to_owned(), object: object.to_owned(), times_nanos: vec![time_nanos], model };
    // No one ever searched for a person: nodes are grey.
    let presence = match session.client.predict_presence(query).await {
        Ok(presence) => presence,
        Err(error) if error.code() == Some(Code::FailedPrecondition) => PresenceForecast::default(),
        Err(error) => return Err(error.into()),
    };
    let likely = presence.times.first().map(|at| at.probabilities.as_slice()).unwrap_or_default();
    let likely: HashMap<&str, f64> = presence.nodes.iter().map(String::as_str).zip(likely.iter().copied()).collect();
    let index: HashMap<&str, usize> =
        topology.nodes().enumerate().map(|(index, node)| (node.name.as_str(), index)).collect();
    let step = |name: &str| overlay.numbered.iter().position(|other| other == name).map(|place| place + 1);
    let nodes = topology.nodes().map(|node| PictureNode {
        name: node.name.to_string(),
        at_m: node.pose.map(|NodePose { x_m, y_m, .. }| [x_m, y_m]),
        probability: likely.get(node.name.as_str()).copied(),
        step: step(node.name.as_str()),
    });
    let is_on_path = |edge: &EdgeName| {
        let is_it = |step: &EdgeName| {
            step.from == edge.from && step.to == edge.to && (overlay.any_action || step.action == edge.action)
        };
        overlay.way.iter().any(is_it)
    };
    let drawn = edges.iter().filter_map(|edge| {
        Some(PictureEdge {
            from: *index.get(edge.edge.from.as_str())?,
            to: *index.get(edge.edge.to.as_str())?,
            length: edge.duration_secs,
            success: (edge.reports > 0).then_some(edge.success),
            is_on_path: is_on_path(&edge.edge),
        })
    });
    let picture = TopologyPicture {
        title: format!("{map} at {}", session.times.heading(time_nanos)),
        nodes: nodes.collect(),
        edges: drawn.collect(),
    };
    Ok(topology_svg::write(&picture)?)
}
