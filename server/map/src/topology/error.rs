//! Why a topological map would be invalid.
//!
//! Invariant: each message names the node or edge that is wrong, with its value.

use super::{EDGES_MAX, LENGTH_MAX_M, NODES_MAX, NOMINAL_MAX_SECS};

/// Why a topological map would be invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TopologyError {
    /// No node has this name.
    #[error("there is no node {0:?}")]
    UnknownNode(String),
    /// No node has this number.
    #[error("there is no node of number {0}")]
    UnknownNodeId(u32),
    /// No edge has this number.
    #[error("there is no edge of number {0}")]
    UnknownEdgeId(u32),
    /// No edge joins these nodes.
    #[error("there is no edge {0}")]
    UnknownEdge(String),
    /// Two nodes would have the same name.
    #[error("node {0:?} exists already: names of nodes are unique")]
    DuplicateNode(String),
    /// Two edges would be the same.
    #[error("edge {0} exists already: edges between the same nodes need different actions")]
    DuplicateEdge(String),
    /// Two nodes or edges would have the same number, or a number that was not assigned yet.
    #[error("{what} number {found} is used twice or not below the next one, {next}")]
    Number {
        /// Either "node" or "edge".
        what: &'static str,
        /// The number.
        found: u32,
        /// The next number to assign.
        next: u32,
    },
    /// An edge would end where it begins.
    #[error("the edge from {0:?} leads to itself: an edge joins two different nodes")]
    ToItself(String),
    /// The time of an edge is invalid.
    #[error("edge {edge} takes {found} s: its time is above 0 s and at most {NOMINAL_MAX_SECS} s")]
    Duration {
        /// Names of both ends.
        edge: String,
        /// The value, in seconds.
        found: f64,
    },
    /// The length of an edge is invalid.
    #[error("edge {edge} is {found} m long: its length is above 0 m and at most {LENGTH_MAX_M} m")]
    Length {
        /// Names of both ends.
        edge: String,
        /// The value, in metres.
        found: f64,
    },
    /// An edge has neither length nor time.
    #[error("edge {edge} has neither a length nor a time: give one of them")]
    NoExtent {
        /// Names of both ends.
        edge: String,
    },
    /// The duration of a visit is invalid.
    #[error("a visit of node {node:?} takes {found} s: its time is 0 s to {NOMINAL_MAX_SECS} s")]
    Dwell {
        /// The node's name.
        node: String,
        /// The value, in seconds.
        found: f64,
    },
    /// A pose is invalid.
    #[error("the pose of node {node:?} has the number {found}: coordinates are -{LENGTH_MAX_M} to {LENGTH_MAX_M} m")]
    Pose {
        /// The node's name.
        node: String,
        /// The value given.
        found: f64,
    },
    /// The map would have too many nodes.
    #[error("a map has at most {NODES_MAX} nodes")]
    TooManyNodes,
    /// The map would have too many edges.
    #[error("a map has at most {EDGES_MAX} edges, and a link is two of them")]
    TooManyEdges,
    /// All numbers are used up.
    #[error("this map has used all numbers for its nodes or edges")]
    NumbersUsedUp,
}
