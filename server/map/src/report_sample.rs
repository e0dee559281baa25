//! The observations that reports of robots contain.
//!
//! Invariant: the state of an observation has the name of the observed object: an edge, a landmark or a task.

use tidemap_model::StateKind;

use crate::{
    name::{EdgeState, StateName},
    topology::Edge,
    traversal::{Traversal, TraversalError},
};

/// An observation in a report: of the state of an edge, a landmark or a task.
#[derive(Clone, Debug, PartialEq)]
pub struct ReportSample {
    /// The state.
    pub state: StateName,
    /// Kind of the state's values.
    pub kind: StateKind,
    /// The time, nanoseconds UTC.
    pub time_nanos: i64,
    /// The value.
    pub value: f64,
}

/// The observations of a traversal of an edge.
///
/// # Errors
/// [`TraversalError`]
pub(crate) fn traversal_samples(traversal: &Traversal, edge: &Edge) -> Result<Vec<ReportSample>, TraversalError> {
    let sample = |(what, value): (EdgeState, f64)| ReportSample {
        state: traversal.edge.state(what),
        kind: what.kind(),
        time_nanos: traversal.start_nanos,
        value,
    };
    Ok(traversal.samples(edge.extent)?.into_iter().map(sample).collect())
}
