//! The topological map of a site, and its edits.
//!
//! Invariant: doubles are stored as their bits; an absent value was not given. Edits identify nodes by name, the map
//! identifies them by number.

/// Position and heading of a node, as bits.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct Pose {
    /// Metres along x.
    #[prost(fixed64, tag = "1")]
    pub x_bits: u64,
    /// Metres along y.
    #[prost(fixed64, tag = "2")]
    pub y_bits: u64,
    /// Heading, radians.
    #[prost(fixed64, tag = "3")]
    pub yaw_bits: u64,
}

/// A node. In an edit it has no number.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Node {
    #[prost(uint32, tag = "1")]
    pub id: u32,
    #[prost(string, tag = "2")]
    pub name: String,
    /// Position and heading of the node.
    #[prost(message, optional, tag = "3")]
    pub pose: Option<Pose>,
    /// Duration of a visit, seconds.
    #[prost(fixed64, optional, tag = "4")]
    pub dwell_bits: Option<u64>,
}

/// An edge between two nodes that are given by number.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Edge {
    #[prost(uint32, tag = "1")]
    pub id: u32,
    /// Number of the node where the edge begins.
    #[prost(uint32, tag = "2")]
    pub from: u32,
    /// Number of the node where the edge ends.
    #[prost(uint32, tag = "3")]
    pub to: u32,
    /// Action by which the edge is travelled.
    #[prost(string, optional, tag = "4")]
    pub action: Option<String>,
    /// Length of the edge, metres.
    #[prost(fixed64, optional, tag = "5")]
    pub length_bits: Option<u64>,
    /// Nominal duration of a traversal, seconds.
    #[prost(fixed64, optional, tag = "6")]
    pub nominal_bits: Option<u64>,
}

/// The whole topological map.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Topology {
    /// The number that the next node gets.
    #[prost(uint32, tag = "1")]
    pub next_node: u32,
    /// The number that the next edge gets.
    #[prost(uint32, tag = "2")]
    pub next_edge: u32,
    /// Nodes, ascending by number.
    #[prost(message, repeated, tag = "3")]
    pub nodes: Vec<Node>,
    /// Edges, ascending by number.
    #[prost(message, repeated, tag = "4")]
    pub edges: Vec<Edge>,
}

/// An edge between two nodes that are given by name.
#[derive(Clone, PartialEq, prost::Message)]
pub struct NamedEdge {
    /// Name of the node where the edge begins.
    #[prost(string, tag = "1")]
    pub from: String,
    /// Name of the node where the edge ends.
    #[prost(string, tag = "2")]
    pub to: String,
    /// Action by which the edge is travelled.
    #[prost(string, optional, tag = "3")]
    pub action: Option<String>,
    /// Whether the edit also contains the edge back.
    #[prost(bool, tag = "4")]
    pub both_ways: bool,
    /// Length of the edge, metres.
    #[prost(fixed64, optional, tag = "5")]
    pub length_bits: Option<u64>,
    /// Nominal duration of a traversal, seconds.
    #[prost(fixed64, optional, tag = "6")]
    pub nominal_bits: Option<u64>,
}

/// A whole map at once.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Load {
    /// Nodes.
    #[prost(message, repeated, tag = "1")]
    pub nodes: Vec<Node>,
    /// Edges.
    #[prost(message, repeated, tag = "2")]
    pub edges: Vec<NamedEdge>,
    /// Whether nodes and edges that are not listed are removed.
    #[prost(bool, tag = "3")]
    pub replaces: bool,
}

/// Another name of a node.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Rename {
    /// The old name.
    #[prost(string, tag = "1")]
    pub from: String,
    /// The new name.
    #[prost(string, tag = "2")]
    pub to: String,
}

/// One change.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Edit {
    /// The change.
    #[prost(oneof = "Change", tags = "1, 2, 3, 4, 5, 6, 7, 8")]
    pub change: Option<Change>,
}

/// The kinds of changes of the topological map.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum Change {
    /// Many nodes and edges are added, or all are replaced.
    #[prost(message, tag = "1")]
    Load(Load),
    /// A node is added.
    #[prost(message, tag = "2")]
    AddNode(Node),
    /// The pose and the visit duration of a node are set.
    #[prost(message, tag = "3")]
    SetNode(Node),
    /// The node of this name is removed.
    #[prost(string, tag = "4")]
    RemoveNode(String),
    /// A node gets another name.
    #[prost(message, tag = "5")]
    RenameNode(Rename),
    /// An edge is added.
    #[prost(message, tag = "6")]
    AddEdge(NamedEdge),
    /// The length and the nominal duration of an edge are set.
    #[prost(message, tag = "7")]
    SetExtent(NamedEdge),
    /// An edge is removed.
    #[prost(message, tag = "8")]
    RemoveEdge(NamedEdge),
}
