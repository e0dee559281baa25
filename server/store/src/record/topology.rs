//! A topological map and its edits as messages, and back.
//!
//! Invariant: decoding gives the encoded value, bit by bit.

use tidemap_map::{
    name::StateName,
    topology::{
        Edge, EdgeEnds, EdgeId, Extent, NewEdge, NewNode, Node, NodeId, NodePose, Topology, TopologyEdit, TopologyParts,
    },
};
use tidemap_migrations::v1::topology as v1;

use super::{Invalid, ids::decode_state_name};

fn encode_pose(pose: NodePose) -> v1::Pose {
    let [x_bits, y_bits, yaw_bits] = [pose.x_m, pose.y_m, pose.yaw_rad].map(f64::to_bits);
    v1::Pose { x_bits, y_bits, yaw_bits }
}

fn decode_pose(message: v1::Pose) -> NodePose {
    let [x_m, y_m, yaw_rad] = [message.x_bits, message.y_bits, message.yaw_bits].map(f64::from_bits);
    NodePose { x_m, y_m, yaw_rad }
}

fn encode_node(id: u32, name: &StateName, pose: Option<NodePose>, dwell_secs: Option<f64>) -> v1::Node {
    let name = name.as_str().to_owned();
    v1::Node { id, name, pose: pose.map(encode_pose), dwell_bits: dwell_secs.map(f64::to_bits) }
}

fn encode_new_node(node: &NewNode) -> v1::Node {
    encode_node(0, &node.name, node.pose, node.dwell_secs)
}

fn decode_new_node(message: &v1::Node) -> Result<NewNode, Invalid> {
    let v1::Node { name, pose, dwell_bits, .. } = message;
    let name = decode_state_name(name)?;
    Ok(NewNode { name, pose: pose.map(decode_pose), dwell_secs: dwell_bits.map(f64::from_bits) })
}

fn extent(length_bits: Option<u64>, nominal_bits: Option<u64>) -> Extent {
    Extent { length_m: length_bits.map(f64::from_bits), nominal_secs: nominal_bits.map(f64::from_bits) }
}

fn encode_edge(edge: &Edge) -> v1::Edge {
    v1::Edge {
        id: edge.id.0,
        from: edge.from.0,
        to: edge.to.0,
        action: edge.action.as_ref().map(|action| action.as_str().to_owned()),
        length_bits: edge.extent.length_m.map(f64::to_bits),
        nominal_bits: edge.extent.nominal_secs.map(f64::to_bits),
    }
}

fn decode_action(action: Option<&String>) -> Result<Option<StateName>, Invalid> {
    action.map(|action| decode_state_name(action)).transpose()
}

fn decode_edge(message: &v1::Edge) -> Result<Edge, Invalid> {
    Ok(Edge {
        id: EdgeId(message.id),
        from: NodeId(message.from),
        to: NodeId(message.to),
        action: decode_action(message.action.as_ref())?,
        extent: extent(message.length_bits, message.nominal_bits),
    })
}

/// A topological map; `None` if the map never had one.
pub(super) fn encode(topology: &Topology) -> Option<v1::Topology> {
    let TopologyParts { next_node, next_edge, nodes, edges } = topology.to_parts();
    let node = |node: &Node| encode_node(node.id.0, &node.name, node.pose, node.dwell_secs);
    (next_node > 0).then(|| v1::Topology {
        next_node,
        next_edge,
        nodes: nodes.iter().map(node).collect(),
        edges: edges.iter().map(encode_edge).collect(),
    })
}

pub(super) fn decode(message: &v1::Topology) -> Result<Topology, String> {
    let node = |message: &v1::Node| {
        let NewNode { name, pose, dwell_secs } = decode_new_node(message)?;
        Ok(Node { id: NodeId(message.id), name, pose, dwell_secs })
    };
    let parts = TopologyParts {
        next_node: message.next_node,
        next_edge: message.next_edge,
        nodes: message.nodes.iter().map(node).collect::<Result<_, Invalid>>()?,
        edges: message.edges.iter().map(decode_edge).collect::<Result<_, Invalid>>()?,
    };
    Topology::from_parts(parts).map_err(|error| error.to_string())
}

fn encode_ends(ends: &EdgeEnds) -> v1::NamedEdge {
    v1::NamedEdge {
        from: ends.from.as_str().to_owned(),
        to: ends.to.as_str().to_owned(),
        action: ends.action.as_ref().map(|action| action.as_str().to_owned()),
        both_ways: ends.both_ways,
        length_bits: None,
        nominal_bits: None,
    }
}

fn encode_new_edge(edge: &NewEdge) -> v1::NamedEdge {
    v1::NamedEdge {
        length_bits: edge.extent.length_m.map(f64::to_bits),
        nominal_bits: edge.extent.nominal_secs.map(f64::to_bits),
        ..encode_ends(&edge.ends)
    }
}

fn decode_ends(message: &v1::NamedEdge) -> Result<EdgeEnds, Invalid> {
    Ok(EdgeEnds {
        from: decode_state_name(&message.from)?,
        to: decode_state_name(&message.to)?,
        action: decode_action(message.action.as_ref())?,
        both_ways: message.both_ways,
    })
}

fn decode_new_edge(message: &v1::NamedEdge) -> Result<NewEdge, Invalid> {
    Ok(NewEdge { ends: decode_ends(message)?, extent: extent(message.length_bits, message.nominal_bits) })
}

pub(super) fn encode_edit(edit: &TopologyEdit) -> v1::Edit {
    let change = match edit {
        TopologyEdit::Load { nodes, edges, replaces } => v1::Change::Load(v1::Load {
            nodes: nodes.iter().map(encode_new_node).collect(),
            edges: edges.iter().map(encode_new_edge).collect(),
            replaces: *replaces,
        }),
        TopologyEdit::AddNode(node) => v1::Change::AddNode(encode_new_node(node)),
        TopologyEdit::SetNode(node) => v1::Change::SetNode(encode_new_node(node)),
        TopologyEdit::RemoveNode(name) => v1::Change::RemoveNode(name.as_str().to_owned()),
        TopologyEdit::RenameNode { from, to } => {
            v1::Change::RenameNode(v1::Rename { from: from.as_str().to_owned(), to: to.as_str().to_owned() })
        }
        TopologyEdit::AddEdge(edge) => v1::Change::AddEdge(encode_new_edge(edge)),
        TopologyEdit::SetExtent(edge) => v1::Change::SetExtent(encode_new_edge(edge)),
        TopologyEdit::RemoveEdge(ends) => v1::Change::RemoveEdge(encode_ends(ends)),
    };
    v1::Edit { change: Some(change) }
}

pub(super) fn decode_edit(message: &v1::Edit) -> Result<TopologyEdit, Invalid> {
    Ok(match message.change.as_ref().ok_or("an edit of the topological map changes nothing")? {
        v1::Change::Load(v1::Load { nodes, edges, replaces }) => TopologyEdit::Load {
            nodes: nodes.iter().map(decode_new_node).collect::<Result<_, _>>()?,
            edges: edges.iter().map(decode_new_edge).collect::<Result<_, _>>()?,
            replaces: *replaces,
        },
        v1::Change::AddNode(node) => TopologyEdit::AddNode(decode_new_node(node)?),
        v1::Change::SetNode(node) => TopologyEdit::SetNode(decode_new_node(node)?),
        v1::Change::RemoveNode(name) => TopologyEdit::RemoveNode(decode_state_name(name)?),
        v1::Change::RenameNode(v1::Rename { from, to }) => {
            TopologyEdit::RenameNode { from: decode_state_name(from)?, to: decode_state_name(to)? }
        }
        v1::Change::AddEdge(edge) => TopologyEdit::AddEdge(decode_new_edge(edge)?),
        v1::Change::SetExtent(edge) => TopologyEdit::SetExtent(decode_new_edge(edge)?),
        v1::Change::RemoveEdge(edge) => TopologyEdit::RemoveEdge(decode_ends(edge)?),
    })
}
