//! Reads a topological map: by name, by number, by neighbourhood, and as parts that are stored.
//!
//! Invariant: a map made of the parts of another is equal to it; parts that break a rule of the map are refused.

use super::{Edge, EdgeId, Node, NodeId, Topology, TopologyError};
use crate::name::{EdgeName, StateName};

/// The parts of a topological map.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TopologyParts {
    /// The number of the next node: above the numbers of all nodes that ever existed.
    pub next_node: u32,
    /// The number of the next edge.
    pub next_edge: u32,
    /// Nodes, ascending by number.
    pub nodes: Vec<Node>,
    /// Edges, ascending by number.
    pub edges: Vec<Edge>,
}

impl Topology {
    /// The node of a number.
    ///
    /// # Errors
    /// [`TopologyError::UnknownNodeId`].
    pub fn node(&self, id: NodeId) -> Result<&Node, TopologyError> {
        self.nodes.get(&id).ok_or(TopologyError::UnknownNodeId(id.0))
    }

    /// The node of a name.
    ///
    /// # Errors
    /// [`TopologyError::UnknownNode`].
    pub fn node_named(&self, name: &str) -> Result<&Node, TopologyError> {
        let node = self.by_name.get(name).and_then(|id| self.nodes.get(id));
        node.ok_or_else(|| TopologyError::UnknownNode(name.chars().take(40).collect()))
    }

    /// The edge of a number.
    ///
    /// # Errors
    /// [`TopologyError::UnknownEdgeId`].
    pub fn edge(&self, id: EdgeId) -> Result<&Edge, TopologyError> {
        self.edges.get(&id).ok_or(TopologyError::UnknownEdgeId(id.0))
    }

    /// The edge from one node to another with an action.
    pub fn edge_between(&self, from: NodeId, to: NodeId, action: Option<&StateName>) -> Option<&Edge> {
        // The search uses the end with fewer edges, because a hub has many.
        let count = |node: NodeId| self.at_node.get(&node).map_or(0, Vec::len);
        let end = if count(from) <= count(to) { from } else { to };
        self.at(end).find(|edge| edge.from == from && edge.to == to && edge.action.as_ref() == action)
    }

    /// The edge of a name.
    ///
    /// # Errors
    /// [`TopologyError::UnknownNode`], [`TopologyError::UnknownEdge`].
    pub fn edge_named(&self, name: &EdgeName) -> Result<&Edge, TopologyError> {
        let (from, to) = (self.node_named(name.from.as_str())?.id, self.node_named(name.to.as_str())?.id);
        let unknown = || TopologyError::UnknownEdge(name.to_string().chars().take(60).collect());
        self.edge_between(from, to, name.action.as_ref()).ok_or_else(unknown)
    }

    /// An edge by the names of its nodes.
    ///
    /// # Errors
    /// [`TopologyError::UnknownNodeId`] where the edge is of another map.
    pub fn edge_in_words(&self, edge: &Edge) -> Result<EdgeName, TopologyError> {
        let (from, to) = (self.node(edge.from)?.name.clone(), self.node(edge.to)?.name.clone());
        Ok(EdgeName { from, to, action: edge.action.clone() })
    }

    /// An edge's name: `A/B`, or `A/B/ACTION`.
    pub fn edge_name(&self, edge: &Edge) -> String {
        let name = |id| self.nodes.get(&id).map_or("?", |node| node.name.as_str());
        let ends = format!("{}/{}", name(edge.from), name(edge.to));
        edge.action.as_ref().map_or(ends.clone(), |action| format!("{ends}/{action}"))
    }

    /// All nodes, ascending by number.
    pub fn nodes(&self) -> impl ExactSizeIterator<Item = &Node> {
        self.nodes.values()
    }

    /// All edges, ascending by number.
    pub fn edges(&self) -> impl ExactSizeIterator<Item = &Edge> {
        self.edges.values()
    }

    /// The edges that leave a node; none for an unknown node.
    pub fn leaving(&self, node: NodeId) -> impl Iterator<Item = &Edge> {
        self.at(node).filter(move |edge| edge.from == node)
    }

    /// The edges that begin or end at a node; none for an unknown node.
    pub fn at(&self, node: NodeId) -> impl Iterator<Item = &Edge> {
        self.at_node.get(&node).into_iter().flatten().filter_map(|id| self.edges.get(id))
    }

    /// The parts in the form that is stored.
    pub fn to_parts(&self) -> TopologyParts {
        TopologyParts {
            next_node: self.next_node,
            next_edge: self.next_edge,
            nodes: self.nodes().cloned().collect(),
            edges: self.edges().cloned().collect(),
        }
    }

    /// The map of these parts.
    ///
    /// # Errors
    /// [`TopologyError`], in the cases in which the edits that make the map would return it.
    pub fn from_parts(parts: TopologyParts) -> Result<Topology, TopologyError> {
        let mut topology = Topology::new();
        (topology.next_node, topology.next_edge) = (parts.next_node, parts.next_edge);
        let number = |what, found, next, used| match used || found >= next {
            true => Err(TopologyError::Number { what, found, next }),
            false => Ok(()),
        };
        for node in parts.nodes {
            number("node", node.id.0, parts.next_node, topology.nodes.contains_key(&node.id))?;
            topology.insert_node(node)?;
        }
        for edge in parts.edges {
            number("edge", edge.id.0, parts.next_edge, topology.edges.contains_key(&edge.id))?;
            topology.insert_edge(edge)?;
        }
        Ok(topology)
    }
}
