//! The topological map at a time as GeoJSON, as the route server of Nav2 reads it.
//!
//! A node is a `Point`, an edge is a `MultiLineString` from one node to another, in that direction only. Coordinates
//! are metres of the map's frame. The cost of an edge is in seconds, and `overridable` is false: otherwise the scorers
//! of the route server would replace the cost by the length.
//!
//! Nav2 knows nodes and edges by numbers below 65,536, which are unique among both. The daemon numbers the nodes of a
//! map and its edges apart, and never uses a number again. Here the numbers come in fours: node `n` is `4 n`, and the
//! edges `3 k`, `3 k + 1` and `3 k + 2` are `4 k + 1`, `4 k + 2` and `4 k + 3`. So a number follows from the daemon's
//! alone: if an element is added, renamed or removed, all others keep their numbers.
//!
//! Invariant: no two features have the same number; every edge joins two nodes of the file; every cost is above 0.

use std::{collections::HashMap, sync::Arc};

use serde_json::{Value, json};
use tidemap_map::{
    name::{EdgeName, StateName},
    no_go::{NoGoAreas, NoGoEdit, NoGoError},
    topology::{Edge, EdgeId, NodeId, NodePose, Topology},
};
use tidemap_model::time::format_rfc3339;

/// The cost of passing an edge at the time of the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeCost {
    /// Probability that an attempt succeeds.
    pub success: f64,
    /// Duration of an attempt that succeeds, seconds.
    pub duration_secs: f64,
    /// Expected duration with failed attempts, seconds; above 0.
    pub expected_secs: f64,
}

/// The data of a file about itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GraphHead<'a> {
    /// Name of the map.
    pub map: &'a str,
    /// The frame of its coordinates.
    pub frame: &'a str,
    /// The time of its costs, nanoseconds UTC.
    pub time_nanos: i64,
}

/// A file, and the counts of its contents.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RouteGraph {
    /// The text of the file.
    pub text: String,
    /// Number of nodes.
    pub nodes: u64,
    /// Number of edges.
    pub edges: u64,
    /// Number of nodes without a position; they and their edges are left out.
    pub unplaced_nodes: u64,
    /// Number of edges that touch a no-go area; they are left out.
    pub closed_edges: u64,
}

/// Why a topological map cannot be written.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum RouteGraphError {
    /// There is nothing to write.
    #[error("no node of the map has a position: set positions with topology edit set-node")]
    NoNodes,
    /// A number is too large for Nav2.
    #[error(
        "{what} has the number {number}, which becomes {becomes} for Nav2, and its numbers end at {}: load the topological \
         map into a new map, whose numbers begin at 0",
        u16::MAX
    )]
    Number { what: String, number: u32, becomes: u64 },
    /// An edge has no cost.
    #[error("edge {0} has no forecast: the topological map was changed meanwhile, try again")]
    NoCost(String),
    /// A cost is invalid.
    #[error("the cost of edge {edge} is {cost} s: it has to be a number above 0")]
    Cost { edge: String, cost: f64 },
    /// A no-go area is invalid.
    #[error(transparent)]
    Area(#[from] NoGoError),
}

/// The number of a node in the file; `None`: it is too large.
#[must_use]
pub fn node_number(NodeId(number): NodeId) -> Option<u16> {
    u16::try_from(4 * u64::from(number)).ok()
}

/// The number of an edge in the file; `None`: it is too large.
#[must_use]
pub fn edge_number(EdgeId(number): EdgeId) -> Option<u16> {
    u16::try_from(4 * u64::from(number / 3) + u64::from(number % 3) + 1).ok()
}

/// Writes the nodes that have positions, and the edges between them that touch none of the areas.
///
/// # Errors
/// [`RouteGraphError`].
pub fn write(
    topology: Topology,
    costs: &HashMap<EdgeName, EdgeCost>,
    areas: &[(StateName, Vec<[f64; 2]>)],
    head: GraphHead<'_>,
) -> Result<RouteGraph, RouteGraphError> {
    let mut no_go = NoGoAreas::default();
    for (name, corners) in areas {
        no_go.apply(&NoGoEdit::Set(name.clone(), corners.clone()))?;
    }
    let whole = Arc::new(topology);
    let open = no_go.without_closed(&whole);
    let mut features = Vec::new();
    let mut unplaced_nodes = 0;
    for node in open.nodes() {
        let Some(NodePose { x_m, y_m, yaw_rad }) = node.pose else {
            unplaced_nodes += 1;
            continue;
        };
        let id = node_number(node.id)
            .ok_or_else(|| too_large("node", node.name.as_str(), node.id.0, 4 * u64::from(node.id.0)))?;
        features.push(json!({
            "type": "Feature",
            "properties": {
                "id": id,
                "frame": head.frame,
                "metadata": { "name": node.name.as_str(), "yaw_rad": yaw_rad },
            },
            "geometry": { "type": "Point", "coordinates": [x_m, y_m] },
        }));
    }
    let nodes = features.len() as u64;
    if nodes == 0 {
        return Err(RouteGraphError::NoNodes);
    }
    for edge in open.edges() {
        features.extend(edge_feature(&open, edge, costs)?);
    }
    let edges = features.len() as u64 - nodes;
    let closed_edges = (whole.edges().len() - open.edges().len()) as u64;
    let text = text(&features, head);
    Ok(RouteGraph { text, nodes, edges, unplaced_nodes, closed_edges })
}

/// An edge; `None` if one of its nodes has no position.
fn edge_feature(
    topology: &Topology,
    edge: &Edge,
    costs: &HashMap<EdgeName, EdgeCost>,
) -> Result<Option<Value>, RouteGraphError> {
    let shown = || topology.edge_name(edge);
    let ends = [edge.from, edge.to].map(|node| {
        let pose = topology.node(node).ok()?.pose?;
        Some((node_number(node)?, [pose.x_m, pose.y_m]))
    });
    let [Some((start, from_m)), Some((end, to_m))] = ends else { return Ok(None) };
    let name = topology.edge_in_words(edge).map_err(|_| RouteGraphError::NoCost(shown()))?;
    let cost = costs.get(&name).ok_or_else(|| RouteGraphError::NoCost(shown()))?;
    let becomes = 4 * u64::from(edge.id.0 / 3) + u64::from(edge.id.0 % 3) + 1;
    let id = edge_number(edge.id).ok_or_else(|| too_large("edge", &shown(), edge.id.0, becomes))?;
    if !(cost.expected_secs.is_finite() && cost.expected_secs > 0.0) {
        return Err(RouteGraphError::Cost { edge: shown(), cost: cost.expected_secs });
    }
    let mut metadata = json!({ "name": shown(), "success": cost.success, "duration_secs": cost.duration_secs });
    if let (Some(action), Some(metadata)) = (&edge.action, metadata.as_object_mut()) {
        metadata.insert("action".to_owned(), action.as_str().into());
    }
    Ok(Some(json!({
        "type": "Feature",
        "properties": {
            "id": id,
            "startid": start,
            "endid": end,
            "cost": cost.expected_secs,
            "overridable": false,
            "metadata": metadata,
        },
        "geometry": { "type": "MultiLineString", "coordinates": [[from_m, to_m]] },
    })))
}

fn too_large(kind: &str, name: &str, number: u32, becomes: u64) -> RouteGraphError {
    RouteGraphError::Number { what: format!("{kind} {name:?}"), number, becomes }
}

/// The file: a line for each feature, so that a reader of its changes sees what changed.
fn text(features: &[Value], head: GraphHead<'_>) -> String {
    // With this reference system, GIS programs show the coordinates as metres.
    let crs = json!({ "type": "name", "properties": { "name": "urn:ogc:def:crs:EPSG::3857" } });
    let mut text = format!(
        "{{\n\"type\": \"FeatureCollection\",\n\"name\": {},\n\"time\": {},\n\"crs\": {crs},\n\"features\": [",
        Value::from(head.map),
        Value::from(format_rfc3339(head.time_nanos)),
    );
    for (at, feature) in features.iter().enumerate() {
        text.push_str(if at == 0 { "\n" } else { ",\n" });
        text.push_str(&feature.to_string());
    }
    text.push_str("\n]\n}\n");
    text
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use tidemap_map::topology::Extent;

    use super::*;

    const HEAD: GraphHead<'static> = GraphHead { map: "flat", frame: "map", time_nanos: 1_458_554_400_000_000_000 };

    fn name(text: &str) -> StateName {
        StateName::new(text).expect(text)
    }

    fn at(x_m: f64, y_m: f64) -> Option<NodePose> {
        Some(NodePose { x_m, y_m, yaw_rad: 0.0 })
    }

    /// A triangle of links, and a node without a position that is linked to one of its corners.
    fn triangle() -> Topology {
        let mut topology = Topology::new();
        let mut add = |text, pose| topology.add_node(name(text), pose, None).expect("a node");
        let nodes = [add("A", at(0.0, 0.0)), add("B", at(4.0, 0.0)), add("C", at(4.0, 3.0)), add("D", None)];
        for (from, to) in [(0, 1), (1, 2), (2, 0), (2, 3)] {
            topology.link(nodes[from], nodes[to], Extent::secs(10.0)).expect("a link");
        }
        topology
    }

    fn costs(topology: &Topology) -> HashMap<EdgeName, EdgeCost> {
        let cost = EdgeCost { success: 0.8, duration_secs: 10.0, expected_secs: 27.5 };
        topology.edges().filter_map(|edge| Some((topology.edge_in_words(edge).ok()?, cost))).collect()
    }

    fn written(topology: Topology, areas: &[(StateName, Vec<[f64; 2]>)]) -> (RouteGraph, Vec<Value>) {
        let costs = costs(&topology);
        let graph = write(topology, &costs, areas, HEAD).expect("a file");
        let json: Value = serde_json::from_str(&graph.text).expect("JSON");
        assert_eq!((&json["type"], &json["time"]), (&"FeatureCollection".into(), &"2016-03-21T10:00:00Z".into()));
        let features = json["features"].as_array().expect("features").clone();
        (graph, features)
    }

    #[test]
    fn nodes_and_edges_are_features_as_the_route_server_reads_them() {
        let (graph, features) = written(triangle(), &[]);
        assert_eq!((graph.nodes, graph.edges, graph.unplaced_nodes, graph.closed_edges), (3, 6, 1, 0));
        assert_eq!(features.len(), 9);
        assert_eq!(
            features[1],
            json!({ "type": "Feature",
                "properties": { "id": 4, "frame": "map", "metadata": { "name": "B", "yaw_rad": 0.0 } },
                "geometry": { "type": "Point", "coordinates": [4.0, 0.0] } })
        );
        assert_eq!(
            features[4],
            json!({ "type": "Feature",
                "properties": { "id": 2, "startid": 4, "endid": 0, "cost": 27.5, "overridable": false,
                    "metadata": { "name": "B/A", "success": 0.8, "duration_secs": 10.0 } },
                "geometry": { "type": "MultiLineString", "coordinates": [[[4.0, 0.0], [0.0, 0.0]]] } })
        );
    }

    fn ids(features: &[Value]) -> HashMap<String, u64> {
        let id = |feature: &Value| {
            let properties = &feature["properties"];
            Some((properties["metadata"]["name"].as_str()?.to_owned(), properties["id"].as_u64()?))
        };
        features.iter().filter_map(id).collect()
    }

    #[test]
    fn numbers_stay_whatever_else_changes() {
        let before = ids(&written(triangle(), &[]).1);
        let mut changed = triangle();
        let removed = changed.node_named("A").expect("A").id;
        changed.remove_node(removed).expect("A");
        let new = changed.add_node(name("0"), at(1.0, 1.0), None).expect("a node");
        let (b, c) = (changed.node_named("B").expect("B").id, changed.node_named("C").expect("C").id);
        changed.link(new, b, Extent::secs(1.0)).expect("a link");
        changed.rename_node(c, name("Z")).expect("C");
        let after = ids(&written(changed, &[]).1);
        assert_eq!((after["B"], after["Z"], after["B/Z"]), (before["B"], before["C"], before["B/C"]));
        let old: HashSet<u64> = before.values().copied().collect();
        assert!(["0", "0/B", "B/0"].iter().all(|name| !old.contains(&after[*name])), "{after:?}");
    }

    #[test]
    fn nodes_and_edges_share_numbers_without_overlap() {
        let nodes = (0..20_000).filter_map(|number| node_number(NodeId(number)));
        let edges = (0..60_000).filter_map(|number| edge_number(EdgeId(number)));
        let all: Vec<u16> = nodes.chain(edges).collect();
        assert_eq!(all.len(), 65_536);
        assert_eq!(all.iter().collect::<HashSet<_>>().len(), 65_536);
        assert_eq!((node_number(NodeId(16_384)), edge_number(EdgeId(49_152))), (None, None));
        assert_eq!((node_number(NodeId(u32::MAX)), edge_number(EdgeId(u32::MAX))), (None, None));
    }

    #[test]
    fn an_edge_through_a_no_go_area_is_left_out() {
        let area = (name("hole"), vec![[1.0, -1.0], [2.0, -1.0], [2.0, 0.5], [1.0, 0.5]]);
        let (graph, features) = written(triangle(), &[area]);
        assert_eq!((graph.edges, graph.closed_edges), (4, 2));
        assert!(!ids(&features).contains_key("A/B"));
    }

    #[test]
    fn what_cannot_be_written_is_refused() {
        let topology = triangle();
        let mut wrong = costs(&topology);
        for cost in wrong.values_mut() {
            cost.expected_secs = 0.0;
        }
        assert!(matches!(write(topology.clone(), &wrong, &[], HEAD), Err(RouteGraphError::Cost { cost: 0.0, .. })));
        assert!(
            matches!(write(topology, &HashMap::new(), &[], HEAD), Err(RouteGraphError::NoCost(edge)) if edge == "A/B")
        );
        assert_eq!(write(Topology::new(), &HashMap::new(), &[], HEAD), Err(RouteGraphError::NoNodes));
    }
}
