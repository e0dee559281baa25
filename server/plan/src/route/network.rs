//! A topological map laid out for searches: indices instead of numbers, edges by their ends.
//!
//! Invariant: nodes are ascending by number, and so are the edges of a node, so that the choice among equal routes is
//! always the same.

use tidemap_map::topology::{Edge, NodeId, Topology};

/// Nodes and edges by index.
pub(crate) struct Network<'a> {
    pub topology: &'a Topology,
    pub nodes: Vec<NodeId>,
    /// The edges, ordered by their start nodes.
    pub edges: Vec<&'a Edge>,
    /// Indices of the nodes at both ends of each edge.
    pub ends: Vec<(u32, u32)>,
    /// Start index of each node's edges; one entry more than nodes.
    first: Vec<u32>,
    /// The edges, ordered by their end nodes.
    into: Vec<u32>,
    into_first: Vec<u32>,
}

impl<'a> Network<'a> {
    pub(crate) fn new(topology: &'a Topology) -> Network<'a> {
        let nodes: Vec<NodeId> = topology.nodes().map(|node| node.id).collect();
        // Both end nodes exist: this is an invariant of the map.
        let index = |node: NodeId| nodes.binary_search(&node).ok().map(|index| index as u32);
        let mut found: Vec<(u32, u32, &Edge)> = topology
            .edges()
            .filter_map(|edge| index(edge.from).zip(index(edge.to)).map(|(from, to)| (from, to, edge)))
            .collect();
        found.sort_by_key(|&(from, _, edge)| (from, edge.id));
        let ends: Vec<(u32, u32)> = found.iter().map(|&(from, to, _)| (from, to)).collect();
        let first = beginnings(nodes.len(), ends.iter().map(|ends| ends.0));
        let into_first = beginnings(nodes.len(), ends.iter().map(|ends| ends.1));
        let mut into: Vec<u32> = (0..ends.len() as u32).collect();
        into.sort_by_key(|&edge| ends[edge as usize].1);
        let edges: Vec<&Edge> = found.into_iter().map(|(_, _, edge)| edge).collect();
        debug_assert!(nodes.is_sorted() && ends.is_sorted_by_key(|ends| ends.0), "nodes and the edges of nodes ascend");
        debug_assert_eq!(edges.len(), topology.edges().count(), "both ends of every edge exist");
        Network { topology, nodes, edges, ends, first, into, into_first }
    }

    pub(crate) fn index_of(&self, node: NodeId) -> Option<usize> {
        self.nodes.binary_search(&node).ok()
    }

    /// Indices of the edges that begin at a node.
    pub(crate) fn leaving(&self, node: usize) -> std::ops::Range<usize> {
        self.first[node] as usize..self.first[node + 1] as usize
    }

    /// Indices of the edges that end at a node.
    pub(crate) fn arriving(&self, node: usize) -> impl Iterator<Item = usize> {
        let range = self.into_first[node] as usize..self.into_first[node + 1] as usize;
        self.into[range].iter().map(|&edge| edge as usize)
    }

    pub(crate) fn to(&self, edge: usize) -> usize {
        self.ends[edge].1 as usize
    }

    pub(crate) fn from(&self, edge: usize) -> usize {
        self.ends[edge].0 as usize
    }

    pub(crate) fn edge_name(&self, edge: usize) -> String {
        self.topology.edge_name(self.edges[edge])
    }
}

/// Start index of the run of each of `count` keys, and the end of the last.
fn beginnings(count: usize, keys: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut first = vec![0; count + 1];
    for key in keys {
        first[key as usize + 1] += 1;
    }
    for key in 0..count {
        first[key + 1] += first[key];
    }
    first
}
