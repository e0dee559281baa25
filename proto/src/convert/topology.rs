//! Topological maps: nodes, edges, their edits, and names of edges.
//!
//! Invariant: an error names the field of the invalid name; the map itself checks the rest.

use std::collections::BTreeMap;

use tidemap_map::{
    name::{EdgeName, StateName},
    topology::{
        Edge, EdgeEnds, EdgeId, Extent, NewEdge, NewNode, Node, NodeId, NodePose, Topology, TopologyEdit, TopologyParts,
    },
};

use super::InvalidField;
use crate::v1::{self, edit_topology_request::Edit};

fn name(field: &str, name: &str) -> Result<StateName, InvalidField> {
    StateName::new(name).map_err(|error| InvalidField::new(field, error))
}

fn node_from_wire(field: &str, wire: &v1::TopologyNode) -> Result<NewNode, InvalidField> {
    let v1::TopologyNode { name: text, pose, dwell_secs, .. } = wire;
    let pose = pose.map(|v1::NodePose { x_m, y_m, yaw_rad }| NodePose { x_m, y_m, yaw_rad });
    Ok(NewNode { name: name(&format!("{field}.name"), text)?, pose, dwell_secs: *dwell_secs })
}

fn ends_from_wire(field: &str, wire: Option<&v1::EdgeEnds>) -> Result<EdgeEnds, InvalidField> {
    let missing = || InvalidField::new(field, "missing: name the two nodes");
    let v1::EdgeEnds { from, to, action, both_ways } = wire.ok_or_else(missing)?;
    let action = if action.is_empty() { None } else { Some(name(&format!("{field}.action"), action)?) };
    Ok(EdgeEnds {
        from: name(&format!("{field}.from"), from)?,
        to: name(&format!("{field}.to"), to)?,
        action,
        both_ways: *both_ways,
    })
}

fn edge_from_wire(field: &str, wire: &v1::TopologyEdge) -> Result<NewEdge, InvalidField> {
    let v1::TopologyEdge { ends, length_m, nominal_secs, .. } = wire;
    let extent = Extent { length_m: *length_m, nominal_secs: *nominal_secs };
    Ok(NewEdge { ends: ends_from_wire(&format!("{field}.ends"), ends.as_ref())?, extent })
}

/// Loads a whole topological map.
///
/// # Errors
/// An invalid name.
pub fn load_from_wire(request: &v1::LoadTopologyRequest) -> Result<TopologyEdit, InvalidField> {
    let nodes = request.nodes.iter().enumerate().map(|(i, node)| node_from_wire(&format!("nodes[{i}]"), node));
    let edges = request.edges.iter().enumerate().map(|(i, edge)| edge_from_wire(&format!("edges[{i}]"), edge));
    Ok(TopologyEdit::Load {
        nodes: nodes.collect::<Result<_, _>>()?,
        edges: edges.collect::<Result<_, _>>()?,
        replaces: !request.adds,
    })
}

/// One edit of a topological map.
///
/// # Errors
/// The edit is missing, or a name is invalid.
pub fn edit_from_wire(edit: Option<&Edit>) -> Result<TopologyEdit, InvalidField> {
    Ok(match edit.ok_or_else(|| InvalidField::new("edit", "missing: set what is to change"))? {
        Edit::AddNode(node) => TopologyEdit::AddNode(node_from_wire("add_node", node)?),
        Edit::SetNode(node) => TopologyEdit::SetNode(node_from_wire("set_node", node)?),
        Edit::RemoveNode(text) => TopologyEdit::RemoveNode(name("remove_node", text)?),
        Edit::RenameNode(v1::RenameNode { from, to }) => {
            TopologyEdit::RenameNode { from: name("rename_node.from", from)?, to: name("rename_node.to", to)? }
        }
        Edit::AddEdge(edge) => TopologyEdit::AddEdge(edge_from_wire("add_edge", edge)?),
        Edit::SetEdge(edge) => TopologyEdit::SetExtent(edge_from_wire("set_edge", edge)?),
        Edit::RemoveEdge(ends) => TopologyEdit::RemoveEdge(ends_from_wire("remove_edge", Some(ends))?),
    })
}

fn text(name: &StateName) -> String {
    name.as_str().to_owned()
}

/// A node to add or set, for the wire.
#[must_use]
pub fn node_to_wire(node: &NewNode) -> v1::TopologyNode {
    let NewNode { name, pose, dwell_secs } = node;
    v1::TopologyNode { name: text(name), pose: pose.map(pose_to_wire), dwell_secs: *dwell_secs, id: 0 }
}

fn pose_to_wire(NodePose { x_m, y_m, yaw_rad }: NodePose) -> v1::NodePose {
    v1::NodePose { x_m, y_m, yaw_rad }
}

/// An edge to add or set, for the wire.
#[must_use]
pub fn new_edge_to_wire(edge: &NewEdge) -> v1::TopologyEdge {
    let NewEdge { ends, extent: Extent { length_m, nominal_secs } } = edge;
    v1::TopologyEdge { ends: Some(ends_to_wire(ends)), length_m: *length_m, nominal_secs: *nominal_secs, id: 0 }
}

fn ends_to_wire(EdgeEnds { from, to, action, both_ways }: &EdgeEnds) -> v1::EdgeEnds {
    let action = action.as_ref().map(text).unwrap_or_default();
    v1::EdgeEnds { from: text(from), to: text(to), action, both_ways: *both_ways }
}

/// An edit of one node or edge, for the wire; `None` for a load, which is a request of its own.
#[must_use]
pub fn edit_to_wire(edit: &TopologyEdit) -> Option<Edit> {
    Some(match edit {
        TopologyEdit::Load { .. } => return None,
        TopologyEdit::AddNode(node) => Edit::AddNode(node_to_wire(node)),
        TopologyEdit::SetNode(node) => Edit::SetNode(node_to_wire(node)),
        TopologyEdit::RemoveNode(name) => Edit::RemoveNode(text(name)),
        TopologyEdit::RenameNode { from, to } => Edit::RenameNode(v1::RenameNode { from: text(from), to: text(to) }),
        TopologyEdit::AddEdge(edge) => Edit::AddEdge(new_edge_to_wire(edge)),
        TopologyEdit::SetExtent(edge) => Edit::SetEdge(new_edge_to_wire(edge)),
        TopologyEdit::RemoveEdge(ends) => Edit::RemoveEdge(ends_to_wire(ends)),
    })
}

/// The name of an edge for the wire.
#[must_use]
pub fn edge_name_to_wire(EdgeName { from, to, action }: &EdgeName) -> v1::EdgeEnds {
    let action = action.as_ref().map(text).unwrap_or_default();
    v1::EdgeEnds { from: text(from), to: text(to), action, both_ways: false }
}

/// The name of an edge from the wire.
///
/// # Errors
/// The edge is missing, or a name is invalid.
pub fn edge_name_from_wire(field: &str, wire: Option<&v1::EdgeEnds>) -> Result<EdgeName, InvalidField> {
    ends_from_wire(field, wire).map(|EdgeEnds { from, to, action, .. }| EdgeName { from, to, action })
}

/// All nodes and edges from the wire.
///
/// # Errors
/// An invalid name, or parts that do not make a topological map.
pub fn topology_from_wire(reply: &v1::GetTopologyResponse) -> Result<Topology, InvalidField> {
    let node = |wire: &v1::TopologyNode| {
        let NewNode { name, pose, dwell_secs } = node_from_wire("nodes", wire)?;
        Ok(Node { id: NodeId(wire.id), name, pose, dwell_secs })
    };
    let nodes = reply.nodes.iter().map(node).collect::<Result<Vec<Node>, InvalidField>>()?;
    let by_name: BTreeMap<&StateName, NodeId> = nodes.iter().map(|node| (&node.name, node.id)).collect();
    let edge = |wire: &v1::TopologyEdge| {
        let NewEdge { ends, extent } = edge_from_wire("edges", wire)?;
        let end = |name: &StateName| {
            let unknown = || InvalidField::new("edges.ends", format!("there is no node {:?}", name.as_str()));
            by_name.get(name).copied().ok_or_else(unknown)
        };
        Ok(Edge { id: EdgeId(wire.id), from: end(&ends.from)?, to: end(&ends.to)?, action: ends.action, extent })
    };
    let edges = reply.edges.iter().map(edge).collect::<Result<Vec<Edge>, InvalidField>>()?;
    let next = |last: Option<u32>| last.map_or(0, |last| last.saturating_add(1));
    let (next_node, next_edge) = (next(nodes.last().map(|node| node.id.0)), next(edges.last().map(|edge| edge.id.0)));
    Topology::from_parts(TopologyParts { next_node, next_edge, nodes, edges })
        .map_err(|error| InvalidField::new("edges", error))
}

/// All nodes and edges for the wire.
#[must_use]
pub fn topology_to_wire(topology: &Topology) -> v1::GetTopologyResponse {
    let nodes = topology.nodes().map(|node| v1::TopologyNode {
        name: node.name.as_str().to_owned(),
        pose: node.pose.map(pose_to_wire),
        dwell_secs: node.dwell_secs,
        id: node.id.0,
    });
    let edges = topology.edges().map(|edge| v1::TopologyEdge {
        ends: Some(edge_to_wire(topology, edge)),
        length_m: edge.extent.length_m,
        nominal_secs: edge.extent.nominal_secs,
        id: edge.id.0,
    });
    v1::GetTopologyResponse { nodes: nodes.collect(), edges: edges.collect() }
}

/// The name of a node; empty if the node does not exist.
#[must_use]
pub fn node_name(topology: &Topology, node: NodeId) -> String {
    topology.node(node).map_or_else(|_| String::new(), |node| node.name.as_str().to_owned())
}

/// The names of the ends of an edge, for the wire.
#[must_use]
pub fn edge_to_wire(topology: &Topology, edge: &Edge) -> v1::EdgeEnds {
    v1::EdgeEnds {
        from: node_name(topology, edge.from),
        to: node_name(topology, edge.to),
        action: edge.action.as_ref().map_or_else(String::new, |action| action.as_str().to_owned()),
        both_ways: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_names_are_refused_with_their_field() {
        let node = v1::TopologyNode { name: "a/b".to_owned(), ..Default::default() };
        let load = v1::LoadTopologyRequest { nodes: vec![node], ..Default::default() };
        assert_eq!(load_from_wire(&load).expect_err("wrong").field, "nodes[0].name");
        assert_eq!(edit_from_wire(None).expect_err("wrong").field, "edit");
    }

    #[test]
    fn a_loaded_map_comes_back() {
        let text = |text: &str| text.to_owned();
        let nodes =
            ["a", "b"].map(|name| v1::TopologyNode { name: text(name), dwell_secs: Some(2.0), ..Default::default() });
        let ends = v1::EdgeEnds { from: text("a"), to: text("b"), action: text("door"), both_ways: true };
        let edge = v1::TopologyEdge { ends: Some(ends), length_m: Some(3.0), ..Default::default() };
        let load = v1::LoadTopologyRequest { nodes: nodes.to_vec(), edges: vec![edge], ..Default::default() };
        let topology = Topology::new().edited(&load_from_wire(&load).expect("right")).expect("right");
        let wire = topology_to_wire(&topology);
        assert_eq!(wire.nodes[1], v1::TopologyNode { id: 1, ..nodes[1].clone() });
        let back = wire.edges[1].ends.clone().expect("ends");
        assert_eq!((back.from.as_str(), back.to.as_str(), back.action.as_str()), ("b", "a", "door"));
        assert_eq!((wire.edges[1].length_m, wire.edges[1].id), (Some(3.0), 1));
        assert_eq!(topology_from_wire(&wire), Ok(topology));
    }
}
