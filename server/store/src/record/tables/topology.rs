//! The topological map on the disk: one row.
//!
//! Invariant: written data is read back bit by bit.

use tidemap_layout::topology as layout;
use tidemap_map::{
    name::StateName,
    site::{Site, SiteEdit},
    topology::{
        Edge, EdgeEnds, EdgeId, Extent, NewEdge, NewNode, Node, NodeId, NodePose, Topology, TopologyEdit, TopologyParts,
    },
};

use super::StoredTable;
use crate::record::{Invalid, ids::decode_state_name};

fn encode_pose(pose: NodePose) -> layout::Pose {
    let [x_bits, y_bits, yaw_bits] = [pose.x_m, pose.y_m, pose.yaw_rad].map(f64::to_bits);
    layout::Pose { x_bits, y_bits, yaw_bits }
}

fn decode_pose(message: layout::Pose) -> NodePose {
    let [x_m, y_m, yaw_rad] = [message.x_bits, message.y_bits, message.yaw_bits].map(f64::from_bits);
    NodePose { x_m, y_m, yaw_rad }
}

fn encode_node(id: u32, name: &StateName, pose: Option<NodePose>, dwell_secs: Option<f64>) -> layout::Node {
    let name = name.as_str().to_owned();
    layout::Node { id, name, pose: pose.map(encode_pose), dwell_bits: dwell_secs.map(f64::to_bits) }
}

fn encode_new_node(node: &NewNode) -> layout::Node {
    encode_node(0, &node.name, node.pose, node.dwell_secs)
}

fn decode_new_node(message: &layout::Node) -> Result<NewNode, Invalid> {
    let layout::Node { name, pose, dwell_bits, .. } = message;
    let name = decode_state_name(name)?;
    Ok(NewNode { name, pose: pose.map(decode_pose), dwell_secs: dwell_bits.map(f64::from_bits) })
}

fn extent(length_bits: Option<u64>, nominal_bits: Option<u64>) -> Extent {
    Extent { length_m: length_bits.map(f64::from_bits), nominal_secs: nominal_bits.map(f64::from_bits) }
}

fn encode_edge(edge: &Edge) -> layout::Edge {
    layout::Edge {
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

fn decode_edge(message: &layout::Edge) -> Result<Edge, Invalid> {
    Ok(Edge {
        id: EdgeId(message.id),
        from: NodeId(message.from),
        to: NodeId(message.to),
        action: decode_action(message.action.as_ref())?,
        extent: extent(message.length_bits, message.nominal_bits),
    })
}

fn encode(topology: &Topology) -> layout::Topology {
    let TopologyParts { next_node, next_edge, nodes, edges } = topology.to_parts();
    let node = |node: &Node| encode_node(node.id.0, &node.name, node.pose, node.dwell_secs);
    layout::Topology {
        next_node,
        next_edge,
        nodes: nodes.iter().map(node).collect(),
        edges: edges.iter().map(encode_edge).collect(),
    }
}

fn decode(message: &layout::Topology) -> Result<Topology, String> {
    let node = |message: &layout::Node| {
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

fn encode_ends(ends: &EdgeEnds) -> layout::NamedEdge {
    layout::NamedEdge {
        from: ends.from.as_str().to_owned(),
        to: ends.to.as_str().to_owned(),
        action: ends.action.as_ref().map(|action| action.as_str().to_owned()),
        both_ways: ends.both_ways,
        length_bits: None,
        nominal_bits: None,
    }
}

fn encode_new_edge(edge: &NewEdge) -> layout::NamedEdge {
    layout::NamedEdge {
        length_bits: edge.extent.length_m.map(f64::to_bits),
        nominal_bits: edge.extent.nominal_secs.map(f64::to_bits),
        ..encode_ends(&edge.ends)
    }
}

fn decode_ends(message: &layout::NamedEdge) -> Result<EdgeEnds, Invalid> {
    Ok(EdgeEnds {
        from: decode_state_name(&message.from)?,
        to: decode_state_name(&message.to)?,
        action: decode_action(message.action.as_ref())?,
        both_ways: message.both_ways,
    })
}

fn decode_new_edge(message: &layout::NamedEdge) -> Result<NewEdge, Invalid> {
    Ok(NewEdge { ends: decode_ends(message)?, extent: extent(message.length_bits, message.nominal_bits) })
}

fn encode_change(edit: &TopologyEdit) -> layout::Edit {
    let change = match edit {
        TopologyEdit::Load { nodes, edges, replaces } => layout::Change::Load(layout::Load {
            nodes: nodes.iter().map(encode_new_node).collect(),
            edges: edges.iter().map(encode_new_edge).collect(),
            replaces: *replaces,
        }),
        TopologyEdit::AddNode(node) => layout::Change::AddNode(encode_new_node(node)),
        TopologyEdit::SetNode(node) => layout::Change::SetNode(encode_new_node(node)),
        TopologyEdit::RemoveNode(name) => layout::Change::RemoveNode(name.as_str().to_owned()),
        TopologyEdit::RenameNode { from, to } => {
            layout::Change::RenameNode(layout::Rename { from: from.as_str().to_owned(), to: to.as_str().to_owned() })
        }
        TopologyEdit::AddEdge(edge) => layout::Change::AddEdge(encode_new_edge(edge)),
        TopologyEdit::SetExtent(edge) => layout::Change::SetExtent(encode_new_edge(edge)),
        TopologyEdit::RemoveEdge(ends) => layout::Change::RemoveEdge(encode_ends(ends)),
    };
    layout::Edit { change: Some(change) }
}

fn decode_change(message: &layout::Edit) -> Result<TopologyEdit, Invalid> {
    Ok(match message.change.as_ref().ok_or("an edit of the topological map changes nothing")? {
        layout::Change::Load(layout::Load { nodes, edges, replaces }) => TopologyEdit::Load {
            nodes: nodes.iter().map(decode_new_node).collect::<Result<_, _>>()?,
            edges: edges.iter().map(decode_new_edge).collect::<Result<_, _>>()?,
            replaces: *replaces,
        },
        layout::Change::AddNode(node) => TopologyEdit::AddNode(decode_new_node(node)?),
        layout::Change::SetNode(node) => TopologyEdit::SetNode(decode_new_node(node)?),
        layout::Change::RemoveNode(name) => TopologyEdit::RemoveNode(decode_state_name(name)?),
        layout::Change::RenameNode(layout::Rename { from, to }) => {
            TopologyEdit::RenameNode { from: decode_state_name(from)?, to: decode_state_name(to)? }
        }
        layout::Change::AddEdge(edge) => TopologyEdit::AddEdge(decode_new_edge(edge)?),
        layout::Change::SetExtent(edge) => TopologyEdit::SetExtent(decode_new_edge(edge)?),
        layout::Change::RemoveEdge(edge) => TopologyEdit::RemoveEdge(decode_ends(edge)?),
    })
}

pub(super) enum TopologicalMap {}

impl StoredTable for TopologicalMap {
    const NUMBER: u32 = 5;
    type Row = layout::Topology;
    type Edit = layout::Edit;

    fn count(site: &Site) -> usize {
        // A topological map from which everything was removed has still used numbers, so it has a row.
        usize::from(**site.topology() != Topology::new())
    }

    fn rows(site: &Site) -> impl Iterator<Item = layout::Topology> {
        (Self::count(site) > 0).then(|| encode(site.topology())).into_iter()
    }

    fn restore(site: Site, rows: Vec<layout::Topology>, _: usize) -> Result<Site, String> {
        let [row] = rows.as_slice() else { return Err("a map has one topological map at most".to_owned()) };
        Ok(site.with_topology(decode(row)?))
    }

    fn encode_edit(edit: &SiteEdit) -> Option<layout::Edit> {
        if let SiteEdit::Topology(edit) = edit { Some(encode_change(edit)) } else { None }
    }

    fn decode_edit(edit: layout::Edit) -> Result<SiteEdit, Invalid> {
        Ok(SiteEdit::Topology(decode_change(&edit)?))
    }
}
