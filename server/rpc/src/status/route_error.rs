//! Errors of requests about topology, routes or searches.
//!
//! Invariant: each error has one gRPC code and one reason.

use tidemap_map::{
    landmark::LandmarkError,
    sighting::SightingError,
    topology::{RoadsError, TopologyError},
};
use tidemap_plan::{
    localise::MixedDescriptors,
    policy::PolicyError,
    route::PlanRouteError,
    search::{PolicyError as JointError, SearchError},
};
use tidemap_proto::convert::route::POLICY_CELLS_MAX;
use tonic::Code;

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RouteError {
    #[error("map {0:?} has no nodes: load a topological map first")]
    NoNodes(String),
    #[error("there is no node {name:?}; nodes here: {known}")]
    UnknownNode { name: String, known: String },
    #[error(
        "nothing was observed at any node of map {map:?}: observe states like {example:?}, 1 if the target is there, else 0"
    )]
    NothingObserved { map: String, example: String },
    #[error("the target cannot be found: each of the {0} observed nodes has a probability of 0 at that time")]
    Nobody(usize),
    #[error("no route leads from node {start:?} to any of the {goals} observed nodes")]
    Unreachable { start: String, goals: usize },
    #[error("no route leads from node {from:?} to node {to:?}")]
    NoWay { from: String, to: String },
    #[error("no route from node {from:?} to node {to:?} takes at most {horizon_secs} s: raise the horizon")]
    TooLong { from: String, to: String, horizon_secs: f64 },
    #[error(
        "no departure from node {from:?} is expected to arrive at node {to:?} by {by_nanos} ns: arrive later, or raise the \
         horizon"
    )]
    TooLate { from: String, to: String, by_nanos: i64 },
    #[error(transparent)]
    Plan(PlanRouteError),
    #[error(transparent)]
    Policy(#[from] PolicyError),
    #[error("{nodes} nodes in {slots} slots: at most {POLICY_CELLS_MAX} of both together; use fewer, wider slots")]
    PolicyTooLarge { nodes: usize, slots: usize },
    #[error("the map has {found} edges: at most {max} fit into one reply")]
    TooManyEdges { found: usize, max: usize },
    #[error(transparent)]
    Roads(#[from] RoadsError),
    #[error("threshold: {0}")]
    Joint(#[from] JointError),
    #[error(transparent)]
    Search(#[from] SearchError),
    #[error("map {0:?} has no image features at nodes: add landmarks first")]
    NoLandmarks(String),
    #[error("{found} nodes have landmarks: name at most {max} of them")]
    TooManyNodes { found: usize, max: usize },
    #[error(transparent)]
    Descriptors(#[from] MixedDescriptors),
    #[error(transparent)]
    Sighting(#[from] SightingError),
}

impl RouteError {
    pub(super) fn code_and_reason(&self) -> (Code, &'static str) {
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
            | Self::TooManyNodes { .. }
            | Self::Search(SearchError::TooManyForExact { .. } | SearchError::TooMany { .. })
            | Self::Roads(RoadsError::TooManyPairs { .. }) => (Code::ResourceExhausted, "LIMIT"),
            Self::NoLandmarks(_) => (Code::FailedPrecondition, "NO_LANDMARKS"),
            Self::Sighting(SightingError::Landmark(error)) => landmark_refusal(error),
            Self::Descriptors(_)
            | Self::Sighting(_)
            | Self::Joint(_)
            | Self::Search(_)
            | Self::Roads(_)
            | Self::Plan(_)
            | Self::Policy(_) => (Code::InvalidArgument, "INVALID_FIELD"),
        }
    }
}

/// Code and reason of a refused edit of landmarks.
pub(super) fn landmark_refusal(error: &LandmarkError) -> (Code, &'static str) {
    match error {
        LandmarkError::Place(error) => refusal_of(error),
        LandmarkError::Unknown { .. } | LandmarkError::Nothing(_) => (Code::NotFound, "UNKNOWN_LANDMARK"),
        LandmarkError::OtherKind { .. } | LandmarkError::OtherLength { .. } => {
            (Code::FailedPrecondition, "OTHER_DESCRIPTORS")
        }
        LandmarkError::TooManyAt(_) | LandmarkError::TooMany | LandmarkError::LongProfiles(_) => {
            (Code::ResourceExhausted, "LIMIT")
        }
        _ => (Code::InvalidArgument, "INVALID_FIELD"),
    }
}

/// Code and reason of a refused edit.
pub(super) fn refusal_of(error: &TopologyError) -> (Code, &'static str) {
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
