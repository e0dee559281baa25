//! Errors of a field of a request that does not fit the content of a map. Errors that can be found without the map are
//! found where the wire format is converted.
//!
//! Invariant: each error names its field, the value, and what would fit.

use std::fmt;

use tidemap_map::{
    event::{StateKind, StateShape},
    name::InvalidName,
};
use tidemap_model::label_evidence::InvalidEvidence;

/// A field of a request that does not fit the map.
#[derive(Clone, Debug, PartialEq)]
pub struct Misfit {
    /// Path of the field within the request.
    pub field: String,
    pub problem: Problem,
}

/// The problem of the field.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Problem {
    #[error("state {state:?} is a {}: a probability is needed here", .kind.name())]
    NoProbability { state: String, kind: StateKind },
    #[error("state {state:?} is a {}: presence needs probabilities", .kind.name())]
    NoPresence { state: String, kind: StateKind },
    #[error("{state:?} is a {} state, and only a vector has positions", .shape.name())]
    NoVector { state: String, shape: StateShape },
    #[error("{state:?} is a {} state, and only an angle or a vector has directions", .shape.name())]
    NoDirection { state: String, shape: StateShape },
    #[error("{near_m} m: at most 20 cells of the raster count as near, here {max_m} m; use larger cells")]
    TooFar { near_m: f64, max_m: f64 },
    #[error("no node of the topology has a position: give nodes one, so that people can be on edges")]
    NoNodePositions,
    #[error("{found} coordinates: the state has {expected}")]
    Coordinates { found: usize, expected: usize },
    #[error(
        "{state:?} is an angle: densities are of single values; request its cosine or its sine, {state}/cos or \
         {state}/sin"
    )]
    NoDensity { state: String },
    #[error("{found} numbers: each place has {each}")]
    Places { found: usize, each: usize },
    #[error(
        "{},{} lies outside of {area}: x from {} to {} m, y from {} to {} m",
        at_m[0], at_m[1], low_m[0], high_m[0], low_m[1], high_m[1]
    )]
    Outside { at_m: [f64; 2], area: &'static str, low_m: [f64; 2], high_m: [f64; 2] },
    #[error("the map has neither locations nor states to explore")]
    NothingToExplore,
    #[error("location {location:?} has {members} states and cells: it needs one state")]
    NotOneState { location: String, members: usize },
    #[error("{planned:?} is not one of the locations: name the one that is planned")]
    NotPlanned { planned: String },
    #[error("{states} states for {locations} locations: name one per location")]
    TaskStates { states: usize, locations: usize },
    #[error("value {value} is not {}", .shape.expected())]
    Value { value: f64, shape: StateShape },
    #[error("{name:?}: compare an angle or its cosine, or labels or one of their states, not both in one evaluation")]
    AngleAndCosine { name: String },
    #[error(transparent)]
    Evidence(InvalidEvidence),
    #[error(transparent)]
    Name(InvalidName),
    #[error("state {state:?} is a {}: only a categorical state has labels", .kind.name())]
    NoLabels { state: String, kind: StateKind },
    #[error("state {state:?} has no label {label:?}: its labels are {}", .labels.join(", "))]
    UnknownLabel { state: String, label: String, labels: Vec<String> },
}

impl Problem {
    /// The error of a field that has the problem.
    pub fn of(self, field: impl Into<String>) -> Misfit {
        Misfit { field: field.into(), problem: self }
    }
}

impl fmt::Display for Misfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.field, self.problem)
    }
}

impl std::error::Error for Misfit {}
