//! Shortest times over a topological map, with a time for each of its edges.
//!
//! Invariant: every time is finite and above 0, so that a shortest path never visits a node twice. The cost of a query
//! for all pairs is bounded before it is answered.

use std::{cmp::Reverse, collections::BinaryHeap};

use super::{Edge, NOMINAL_MAX_SECS, NodeId, Topology};

/// Maximum number of pairs of nodes for [`Roads::all_pairs`]: 5,000 by 5,000, 200 MB.
pub const ROADS_PAIRS_MAX: usize = 25_000_000;

/// The reason why times cannot be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RoadsError {
    /// The time of an edge is invalid.
    #[error("edge {edge} would take {found} s: its time is above 0 s and at most {NOMINAL_MAX_SECS} s")]
    Duration {
        /// Names of both ends.
        edge: String,
        /// The time given, seconds.
        found: f64,
    },
    /// There are too many pairs.
    #[error("times between {found} nodes: at most {ROADS_PAIRS_MAX} pairs are kept")]
    TooManyPairs {
        /// The number of nodes requested.
        found: usize,
    },
}

/// The time at which a node is reached, and the node before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// Index of the node.
    pub node: usize,
    /// Seconds after leaving the start.
    pub secs: f64,
}

/// A topological map with a time for each edge, for path searches. Nodes have indices here: 0 up, ascending by id.
#[derive(Clone, Debug)]
pub struct Roads {
    nodes: Vec<NodeId>,
    dwell_secs: Vec<f64>,
    /// Where the edges of each node begin in `ways`; one more than nodes.
    first: Vec<u32>,
    /// Target and time of each edge.
    ways: Vec<(u32, f64)>,
}

impl Roads {
    /// Takes the time of each edge, in seconds, from `secs`: nominal, predicted or assumed. `None` closes an edge.
    ///
    /// # Errors
    /// [`RoadsError::Duration`] for a time that is not above 0 and at most [`NOMINAL_MAX_SECS`].
    pub fn new(topology: &Topology, mut secs: impl FnMut(&Edge) -> Option<f64>) -> Result<Roads, RoadsError> {
        let nodes: Vec<NodeId> = topology.nodes().map(|node| node.id).collect();
        let dwell_secs = topology.nodes().map(|node| node.dwell_secs.unwrap_or(0.0)).collect();
        let mut edges = Vec::with_capacity(topology.edges().len());
        for edge in topology.edges() {
            let Some(found) = secs(edge) else { continue };
            if !(found > 0.0 && found <= NOMINAL_MAX_SECS) {
                return Err(RoadsError::Duration { edge: topology.edge_name(edge), found });
            }
            // Both ends exist by the invariant of the map.
            if let (Ok(from), Ok(to)) = (nodes.binary_search(&edge.from), nodes.binary_search(&edge.to)) {
                edges.push((from as u32, to as u32, found));
            }
        }
        edges.sort_by_key(|&(from, to, _)| (from, to));
        let mut first = vec![0_u32; nodes.len() + 1];
        for &(from, ..) in &edges {
            first[from as usize + 1] += 1;
        }
        for node in 0..nodes.len() {
            first[node + 1] += first[node];
        }
        let ways = edges.into_iter().map(|(_, to, secs)| (to, secs)).collect();
        Ok(Roads { nodes, dwell_secs, first, ways })
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether there is no node.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// The index of a node; `None` if the map has no node of this number.
    pub fn index_of(&self, node: NodeId) -> Option<usize> {
        self.nodes.binary_search(&node).ok()
    }

    /// The node of an index below [`Roads::len`].
    pub fn node(&self, index: usize) -> NodeId {
        self.nodes[index]
    }

    /// Duration of a visit of a node, in seconds; 0 if the map does not give it.
    pub fn dwell_secs(&self, index: usize) -> f64 {
        self.dwell_secs[index]
    }

    /// Targets and times of the edges of a node; several may lead to the same node.
    pub fn ways(&self, index: usize) -> impl ExactSizeIterator<Item = (usize, f64)> {
        let range = self.first[index] as usize..self.first[index + 1] as usize;
        self.ways[range].iter().map(|&(to, secs)| (to as usize, secs))
    }

    /// Shortest times between all nodes, in seconds, one row per start; infinite without a path.
    ///
    /// # Errors
    /// [`RoadsError::TooManyPairs`].
    pub fn all_pairs(&self) -> Result<Vec<f64>, RoadsError> {
        if self.len().saturating_mul(self.len()) > ROADS_PAIRS_MAX {
            return Err(RoadsError::TooManyPairs { found: self.len() });
        }
        let mut shortest = ShortestTimes::default();
        let mut times = Vec::with_capacity(self.len() * self.len());
        for from in 0..self.len() {
            shortest.from(self, from);
            times.extend_from_slice(shortest.secs());
        }
        Ok(times)
    }
}

/// Shortest times from one node (Dijkstra); reuses its buffers.
#[derive(Clone, Debug, Default)]
pub struct ShortestTimes {
    secs: Vec<f64>,
    before: Vec<u32>,
    /// Times as bits, which have the order of the numbers because none is negative.
    open: BinaryHeap<Reverse<(u64, u32)>>,
}

impl ShortestTimes {
    /// Computes the times from a node to all others.
    pub fn from(&mut self, roads: &Roads, start: usize) {
        self.run(roads, start, |_| false);
    }

    /// Computes the times from a node until the time to a goal node is known; other times may be missing, or too long.
    pub fn between(&mut self, roads: &Roads, start: usize, goal: usize) {
        self.run(roads, start, |node| node == goal);
    }

    /// Computes the times from a node along nodes that `open` accepts; the start is accepted.
    pub fn from_through(&mut self, roads: &Roads, start: usize, open: impl Fn(usize) -> bool) {
        self.run_through(roads, start, |_| false, open);
    }

    fn run(&mut self, roads: &Roads, start: usize, done: impl Fn(usize) -> bool) {
        self.run_through(roads, start, done, |_| true);
    }

    fn run_through(
        &mut self,
        roads: &Roads,
        start: usize,
        done: impl Fn(usize) -> bool,
        through: impl Fn(usize) -> bool,
    ) {
        self.secs.clear();
        self.secs.resize(roads.len(), f64::INFINITY);
        self.before.clear();
        self.before.resize(roads.len(), u32::MAX);
        self.open.clear();
        self.secs[start] = 0.0;
        self.open.push(Reverse((0, start as u32)));
        while let Some(Reverse((bits, node))) = self.open.pop() {
            let (secs, index) = (f64::from_bits(bits), node as usize);
            if secs > self.secs[index] {
                continue;
            }
            if done(index) {
                return;
            }
            if index != start && !through(index) {
                continue;
            }
            for (to, way_secs) in roads.ways(index) {
                let arrival_secs = secs + way_secs;
                if arrival_secs < self.secs[to] {
                    self.secs[to] = arrival_secs;
                    self.before[to] = node;
                    self.open.push(Reverse((arrival_secs.to_bits(), to as u32)));
                }
            }
        }
    }

    /// The time to each node, in seconds; infinite without a path.
    pub fn secs(&self) -> &[f64] {
        &self.secs
    }

    /// The path to a node, without the start; empty without a path, and for the start itself.
    pub fn way_to(&self, node: usize) -> Vec<Arrival> {
        let mut way = Vec::new();
        let mut at = node;
        while self.before[at] != u32::MAX {
            way.push(Arrival { node: at, secs: self.secs[at] });
            at = self.before[at] as usize;
        }
        way.reverse();
        way
    }
}
