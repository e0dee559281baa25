//! Why a request about topology, routes or searches fails.
//!
//! Invariant: each error has one gRPC code and one reason.

use tidemap_map::topology::{RoadsError, TopologyError};
use tidemap_plan::{policy::PolicyError, route::PlanRouteError, search::SearchError};
use tidemap_proto::convert::route::POLICY_CELLS_MAX;
use tonic::Code;

/// Why there is no walk.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum RouteError {
    /// The map has no nodes.
    #[error("map {0:?} has no nodes: load a topological map, with `tidemap topology load`")]
    NoNodes(String),
    /// A node is not known.
    #[error("there is no node {name:?}; nodes here: {known}")]
    UnknownNode {
        /// The name, shortened.
        name: String,
        /// Some that there are.
        known: String,
    },
    /// Nothing is known of any node.
    #[error(
        "nothing was observed at any node of map {map:?}: observe states like {example:?}, 1 where somebody is, else 0"
    )]
    NothingObserved {
        /// The map.
        map: String,
        /// Name of a state that would be asked.
        example: String,
    },
    /// Nobody is expected.
    #[error("nobody is to be found: each of the {0} nodes that were observed has a probability of 0 at that time")]
    Nobody(usize),
    /// No way leads to anybody.
    #[error("from node {start:?} no way leads to any of the {goals} nodes that were observed")]
    Unreachable {
        /// Where the search begins.
        start: String,
        /// How many places there are.
        goals: usize,
    },
    /// No way leads there.
    #[error("no way leads from node {from:?} to node {to:?}")]
    NoWay {
        /// Where the route begins.
        from: String,
        /// Where it would end.
        to: String,
    },
    /// All ways take too long.
    #[error("no way from node {from:?} to node {to:?} takes at most {horizon_secs} s: raise the horizon")]
    TooLong {
        /// Where the route begins.
        from: String,
        /// Where it would end.
        to: String,
        /// The longest that was allowed.
        horizon_secs: f64,
    },
    /// No departure is early enough.
    #[error(
        "no departure from node {from:?} is expected to arrive at node {to:?} by {by_nanos} ns: arrive later, or raise the \
         horizon"
    )]
    TooLate {
        /// Where the route begins.
        from: String,
        /// Where it would end.
        to: String,
        /// The latest arrival, nanoseconds UTC.
        by_nanos: i64,
    },
    /// A route that is none.
    #[error(transparent)]
    Plan(PlanRouteError),
    /// A policy that is none.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// A policy would be too large for an answer.
    #[error("{nodes} nodes in {slots} slots: at most {POLICY_CELLS_MAX} of both together; take fewer, wider slots")]
    PolicyTooLarge {
        /// Nodes of the map.
        nodes: usize,
        /// Slots.
        slots: usize,
    },
    /// Too many edges for an answer.
    #[error("the map has {found} edges: at most {most} are told of at once")]
    TooManyEdges {
        /// How many there are.
        found: usize,
        /// How many may be.
        most: usize,
    },
    /// The edges have no times.
    #[error(transparent)]
    Roads(#[from] RoadsError),
    /// The search is none, or too large.
    #[error(transparent)]
    Search(#[from] SearchError),
}

impl RouteError {
    pub(in crate::rpc) fn code_and_reason(&self) -> (Code, &'static str) {
        match self {
            Self::NoNodes(_) => (Code::FailedPrecondition, "NO_TOPOLOGY"),
            Self::UnknownNode { .. } => (Code::NotFound, "UNKNOWN_NODE"),
            Self::NothingObserved { .. } => (Code::FailedPrecondition, "NOTHING_OBSERVED"),
            Self::Nobody(_) => (Code::FailedPrecondition, "NOBODY"),
            Self::Unreachable { .. } | Self::Search(SearchError::Unreachable { .. }) => {
                (Code::FailedPrecondition, "UNREACHABLE")
            }
            Self::NoWay { .. } | Self::TooLong { .. } | Self::TooLate { .. } => {
                (Code::FailedPrecondition, "UNREACHABLE")
            }
            Self::Plan(PlanRouteError::CutOff { .. }) => (Code::DeadlineExceeded, "CUT_OFF"),
            Self::Plan(PlanRouteError::TooManyDepartures { .. })
            | Self::Policy(PolicyError::TooManyStates { .. })
            | Self::PolicyTooLarge { .. }
            | Self::TooManyEdges { .. }
            | Self::Search(SearchError::TooManyForExact { .. } | SearchError::TooMany { .. })
            | Self::Roads(RoadsError::TooManyPairs { .. }) => (Code::ResourceExhausted, "LIMIT"),
            Self::Search(_) | Self::Roads(_) | Self::Plan(_) | Self::Policy(_) => {
                (Code::InvalidArgument, "INVALID_FIELD")
            }
        }
    }
}

/// Code and reason of an edit that is refused.
pub(in crate::rpc) fn refusal_of(error: &TopologyError) -> (Code, &'static str) {
    match error {
        TopologyError::UnknownNode(_) | TopologyError::UnknownNodeId(_) => (Code::NotFound, "UNKNOWN_NODE"),
        TopologyError::UnknownEdge(_) | TopologyError::UnknownEdgeId(_) => (Code::NotFound, "UNKNOWN_EDGE"),
        TopologyError::DuplicateNode(_) => (Code::AlreadyExists, "NODE_EXISTS"),
        TopologyError::DuplicateEdge(_) => (Code::AlreadyExists, "EDGE_EXISTS"),
        TopologyError::TooManyNodes | TopologyError::TooManyEdges | TopologyError::NumbersUsedUp => {
            (Code::ResourceExhausted, "LIMIT")
        }
        _ => (Code::InvalidArgument, "INVALID_FIELD"),
    }
}
