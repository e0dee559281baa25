//! Topological maps: nodes, edges, their edits, and failed traversals.
//!
//! Invariant: an error names the field of the invalid name; the map itself checks the rest.

use tidemap_map::{
    name::StateName,
    topology::{Edge, EdgeEnds, Extent, NewEdge, NewNode, NodeId, NodePose, Topology, TopologyEdit},
};

use super::InvalidField;
use crate::v1;

fn name(field: &str, name: &str) -> Result<StateName, InvalidField> {
    StateName::new(name).map_err(|error| InvalidField::new(field, error))
}

fn node_from_wire(field: &str, wire: &v1::TopologyNode) -> Result<NewNode, InvalidField> {
    let v1::TopologyNode { name: text, pose, dwell_secs, .. } = wire;
    let pose = pose.map(|v1::NodePose { x_m, y_m, yaw_rad }| NodePose { x_m, y_m, yaw_rad });
    Ok(NewNode { name: name(&format!("{field}.name"), text)?, pose, dwell_secs: *dwell_secs })
}

fn ends_from_wire(field: &str, wire: Option<&v1::EdgeEnds>) -> Result<EdgeEnds, InvalidField> {
    let missing = || InvalidField::new(field, "say between which nodes");
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
pub fn edit_from_wire(edit: Option<&v1::edit_topology_request::Edit>) -> Result<TopologyEdit, InvalidField> {
    use v1::edit_topology_request::Edit;
    Ok(match edit.ok_or_else(|| InvalidField::new("edit", "say what is to change"))? {
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

/// All nodes and edges for the wire.
#[must_use]
pub fn topology_to_wire(topology: &Topology) -> v1::GetTopologyResponse {
    let nodes = topology.nodes().map(|node| v1::TopologyNode {
        name: node.name.as_str().to_owned(),
        pose: node.pose.map(|NodePose { x_m, y_m, yaw_rad }| v1::NodePose { x_m, y_m, yaw_rad }),
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
    }
}
