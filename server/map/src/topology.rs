//! The topological map: named nodes, and the edges between them.
//!
//! The topological map is a part of the site of its map. Each edit (`topology/edit.rs`) names nodes and is one event of
//! the log, so that it has the same meaning whenever it is applied; a load is one edit. Checkpoint and index hold the
//! topological map in the record of the site.
//!
//! Invariant: every edge joins two different nodes that exist; names of nodes are unique; edges from one node to
//! another have different actions; lengths and times are finite and in range. Ids are never reused, so that what was
//! learned under one survives a rename or a changed length and is never mistaken for another's.

mod edit;
mod error;
mod parts;
mod roads;

use std::collections::BTreeMap;

pub use edit::{EdgeEnds, NewEdge, NewNode, TopologyEdit};
pub use error::TopologyError;
pub use parts::TopologyParts;
pub use roads::{Arrival, ROADS_PAIRS_MAX, Roads, RoadsError, ShortestTimes};

use crate::name::StateName;

/// Maximum number of nodes of a map.
pub(crate) const NODES_MAX: usize = 100_000;
/// Maximum number of edges of a map; a link is two edges.
pub(crate) const EDGES_MAX: usize = 1_000_000;
/// Maximum length of an edge, in metres, and maximum coordinate of a pose.
pub(crate) const LENGTH_MAX_M: f64 = 1e7;
/// Maximum nominal time of an edge or a visit, in seconds: about 30 years.
pub const NOMINAL_MAX_SECS: f64 = 1e9;

/// Identifies a node for as long as its map exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct NodeId(pub u32);

/// Identifies an edge for as long as its map exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct EdgeId(pub u32);

/// The pose of a node in the frame of its map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodePose {
    /// Metres along the first axis.
    pub x_m: f64,
    /// Metres along the second axis.
    pub y_m: f64,
    /// Heading about the vertical, radians, counterclockwise from the first axis.
    pub yaw_rad: f64,
}

/// A node of the topological map: a place.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Identifies the node in this map; never used again.
    pub id: NodeId,
    /// The name of the node, unique in the map.
    pub name: StateName,
    /// The pose of the node, if it is known.
    pub pose: Option<NodePose>,
    /// Duration of a visit once the robot is there, in seconds, 0 to [`NOMINAL_MAX_SECS`]; `None` if not given.
    pub dwell_secs: Option<f64>,
}

/// Length and nominal time of an edge, as the map's author states them; at least one of the two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Metres, above 0, to [`LENGTH_MAX_M`].
    pub length_m: Option<f64>,
    /// Seconds that the edge nominally takes, above 0, to [`NOMINAL_MAX_SECS`].
    pub nominal_secs: Option<f64>,
}

impl Extent {
    /// An extent with a nominal time alone.
    pub fn secs(nominal_secs: f64) -> Extent {
        Extent { length_m: None, nominal_secs: Some(nominal_secs) }
    }

    /// An extent with a length alone.
    pub fn metres(length_m: f64) -> Extent {
        Extent { length_m: Some(length_m), nominal_secs: None }
    }

    /// The nominal time, or the time that the length takes at a speed in metres per second.
    pub fn secs_at(&self, speed_m_per_s: f64) -> f64 {
        self.nominal_secs.unwrap_or_else(|| self.length_m.unwrap_or(f64::INFINITY) / speed_m_per_s)
    }

    fn check(&self, what: impl Fn() -> String) -> Result<(), TopologyError> {
        let bad = |value: Option<f64>, max: f64| value.filter(|value| !(*value > 0.0 && *value <= max));
        if let Some(found) = bad(self.length_m, LENGTH_MAX_M) {
            return Err(TopologyError::Length { edge: what(), found });
        }
        if let Some(found) = bad(self.nominal_secs, NOMINAL_MAX_SECS) {
            return Err(TopologyError::Duration { edge: what(), found });
        }
        if self.length_m.is_none() && self.nominal_secs.is_none() {
            return Err(TopologyError::NoExtent { edge: what() });
        }
        Ok(())
    }
}

/// An edge from one node to another, in that direction only.
#[derive(Clone, Debug, PartialEq)]
pub struct Edge {
    /// Identifies the edge in this map; never used again.
    pub id: EdgeId,
    /// The node where the edge begins.
    pub from: NodeId,
    /// The node where the edge ends.
    pub to: NodeId,
    /// The robot's action that travels the edge; `None` is the default action.
    pub action: Option<StateName>,
    /// Length and nominal time.
    pub extent: Extent,
}

/// Nodes and edges of a map.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Topology {
    next_node: u32,
    next_edge: u32,
    nodes: BTreeMap<NodeId, Node>,
    edges: BTreeMap<EdgeId, Edge>,
    by_name: BTreeMap<StateName, NodeId>,
    /// All edges at each node, incoming and outgoing.
    at_node: BTreeMap<NodeId, Vec<EdgeId>>,
}

impl Topology {
    /// A topological map without nodes.
    pub fn new() -> Topology {
        Topology::default()
    }

    /// Adds a node.
    ///
    /// # Errors
    /// [`TopologyError`] where the name is taken, a number is out of range, or the map is full.
    pub fn add_node(
        &mut self,
        name: StateName,
        pose: Option<NodePose>,
        dwell_secs: Option<f64>,
    ) -> Result<NodeId, TopologyError> {
        let id = NodeId(self.next_node);
        let next = self.next_node.checked_add(1).ok_or(TopologyError::NumbersUsedUp)?;
        self.insert_node(Node { id, name, pose, dwell_secs })?;
        self.next_node = next;
        Ok(id)
    }

    fn insert_node(&mut self, node: Node) -> Result<(), TopologyError> {
        if self.nodes.len() >= NODES_MAX {
            return Err(TopologyError::TooManyNodes);
        }
        if self.by_name.contains_key(&node.name) {
            return Err(TopologyError::DuplicateNode(node.name.to_string()));
        }
        check_visit(&node.name, node.pose, node.dwell_secs)?;
        self.by_name.insert(node.name.clone(), node.id);
        self.at_node.insert(node.id, Vec::new());
        self.nodes.insert(node.id, node);
        Ok(())
    }

    /// Renames a node; its number stays.
    ///
    /// # Errors
    /// [`TopologyError::UnknownNodeId`], [`TopologyError::DuplicateNode`].
    pub fn rename_node(&mut self, id: NodeId, name: StateName) -> Result<(), TopologyError> {
        let node = self.nodes.get_mut(&id).ok_or(TopologyError::UnknownNodeId(id.0))?;
        match self.by_name.get(&name) {
            Some(&other) if other != id => return Err(TopologyError::DuplicateNode(name.to_string())),
            _ => {}
        }
        self.by_name.remove(&node.name);
        node.name = name.clone();
        self.by_name.insert(name, id);
        Ok(())
    }

    /// Sets the pose of a node and the duration of a visit.
    ///
    /// # Errors
    /// [`TopologyError`] where the node is unknown or a number is out of range.
    pub fn set_node(
        &mut self,
        id: NodeId,
        pose: Option<NodePose>,
        dwell_secs: Option<f64>,
    ) -> Result<(), TopologyError> {
        let node = self.nodes.get_mut(&id).ok_or(TopologyError::UnknownNodeId(id.0))?;
        check_visit(&node.name, pose, dwell_secs)?;
        (node.pose, node.dwell_secs) = (pose, dwell_secs);
        Ok(())
    }

    /// Removes a node with all edges at it, and returns the edges.
    ///
    /// # Errors
    /// [`TopologyError::UnknownNodeId`].
    pub fn remove_node(&mut self, id: NodeId) -> Result<Vec<Edge>, TopologyError> {
        let node = self.nodes.remove(&id).ok_or(TopologyError::UnknownNodeId(id.0))?;
        self.by_name.remove(&node.name);
        let edges = self.at_node.remove(&id).unwrap_or_default();
        Ok(edges.into_iter().filter_map(|edge| self.remove_edge(edge).ok()).collect())
    }

    /// Adds an edge in one direction.
    ///
    /// # Errors
    /// [`TopologyError`] where an end is unknown, both ends are equal, the edge exists, a number is out of range, or
    /// the map is full.
    pub fn add_edge(
        &mut self,
        from: NodeId,
        to: NodeId,
        action: Option<StateName>,
        extent: Extent,
    ) -> Result<EdgeId, TopologyError> {
        let id = EdgeId(self.next_edge);
        let next = self.next_edge.checked_add(1).ok_or(TopologyError::NumbersUsedUp)?;
        self.insert_edge(Edge { id, from, to, action, extent })?;
        self.next_edge = next;
        Ok(id)
    }

    /// Adds edges in both directions, of the same length or time. Both or none are added.
    ///
    /// # Errors
    /// The errors of [`Topology::add_edge`].
    pub fn link(&mut self, a: NodeId, b: NodeId, extent: Extent) -> Result<(EdgeId, EdgeId), TopologyError> {
        let there = self.add_edge(a, b, None, extent)?;
        match self.add_edge(b, a, None, extent) {
            Ok(back) => Ok((there, back)),
            Err(error) => {
                self.remove_edge(there)?;
                Err(error)
            }
        }
    }

    fn insert_edge(&mut self, edge: Edge) -> Result<(), TopologyError> {
        let from = &self.node(edge.from)?.name;
        let to = &self.node(edge.to)?.name;
        let shown = || match &edge.action {
            Some(action) => format!("{from}/{to}/{action}"),
            None => format!("{from}/{to}"),
        };
        if edge.from == edge.to {
            return Err(TopologyError::ToItself(from.to_string()));
        }
        edge.extent.check(shown)?;
        if self.edges.len() >= EDGES_MAX {
            return Err(TopologyError::TooManyEdges);
        }
        if self.edge_between(edge.from, edge.to, edge.action.as_ref()).is_some() {
            return Err(TopologyError::DuplicateEdge(shown()));
        }
        for end in [edge.from, edge.to] {
            self.at_node.entry(end).or_default().push(edge.id);
        }
        self.edges.insert(edge.id, edge);
        Ok(())
    }

    /// Changes an edge's length or time; its number and its learned data stay.
    ///
    /// # Errors
    /// [`TopologyError`] where the edge is unknown or a number is out of range.
    pub(crate) fn set_extent(&mut self, id: EdgeId, extent: Extent) -> Result<(), TopologyError> {
        let edge = self.edge(id)?;
        extent.check(|| self.edge_name(edge))?;
        if let Some(edge) = self.edges.get_mut(&id) {
            edge.extent = extent;
        }
        Ok(())
    }

    /// Changes the action of an edge; its number stays.
    ///
    /// # Errors
    /// [`TopologyError::UnknownEdgeId`], [`TopologyError::DuplicateEdge`].
    pub fn rename_edge(&mut self, id: EdgeId, action: Option<StateName>) -> Result<(), TopologyError> {
        let edge = self.edge(id)?;
        match self.edge_between(edge.from, edge.to, action.as_ref()) {
            Some(other) if other.id != id => return Err(TopologyError::DuplicateEdge(self.edge_name(other))),
            _ => {}
        }
        if let Some(edge) = self.edges.get_mut(&id) {
            edge.action = action;
        }
        Ok(())
    }

    /// Removes an edge, in its direction only, and returns it.
    ///
    /// # Errors
    /// [`TopologyError::UnknownEdgeId`].
    pub fn remove_edge(&mut self, id: EdgeId) -> Result<Edge, TopologyError> {
        let edge = self.edges.remove(&id).ok_or(TopologyError::UnknownEdgeId(id.0))?;
        for end in [edge.from, edge.to] {
            if let Some(edges) = self.at_node.get_mut(&end) {
                edges.retain(|&other| other != id);
            }
        }
        Ok(edge)
    }
}

fn check_visit(name: &StateName, pose: Option<NodePose>, dwell_secs: Option<f64>) -> Result<(), TopologyError> {
    if let Some(found) = dwell_secs.filter(|secs| !(0.0..=NOMINAL_MAX_SECS).contains(secs)) {
        return Err(TopologyError::Dwell { node: name.to_string(), found });
    }
    let numbers = pose.map_or([0.0; 3], |pose| [pose.x_m, pose.y_m, pose.yaw_rad]);
    match numbers.into_iter().find(|number| !(-LENGTH_MAX_M..=LENGTH_MAX_M).contains(number)) {
        Some(found) => Err(TopologyError::Pose { node: name.to_string(), found }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
