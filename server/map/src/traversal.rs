//! Traversals of the edges of a topological map: the reports of robots, the states that learn from them, and the newest
//! failures.
//!
//! Invariant: a state never changes its unit. A speed is in metres per second and a pace is relative to the nominal
//! time, by the edge's extent when the report was applied; so an edge that is given another length keeps its learned
//! data.

use std::{collections::VecDeque, sync::Arc};

use tidemap_model::StateKind;

use crate::{
    name::{EdgeName, EdgeState, StateName, unprintable},
    topology::{Edge, Extent, Topology, TopologyError},
};

/// Maximum duration of an accepted traversal, nanoseconds: a day. States are learned by the time of day, which has no
/// meaning for longer traversals; and a wrong unit or a clock jump would be learned as an edge at a standstill.
pub(crate) const TRAVERSAL_MAX_NANOS: i64 = 86_400_000_000_000;
/// Maximum number of characters of the reason of a failure.
pub(crate) const REASON_CHARS_MAX: usize = 200;
/// Maximum number of failed traversals that a map keeps.
pub(crate) const FAILURES_MAX: usize = 1_000;

/// A robot travelled an edge, or tried to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Traversal {
    /// The edge.
    pub edge: EdgeName,
    /// When the robot started, nanoseconds UTC.
    pub start_nanos: i64,
    /// When the robot arrived or gave up, nanoseconds UTC.
    pub end_nanos: i64,
    /// Whether the robot arrived.
    pub success: bool,
    /// Reason of a failure, for people; may be empty.
    pub reason: String,
}

/// Why a traversal is invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TraversalError {
    /// The traversal is too old.
    #[error("start {0} ns is before 1970")]
    Before1970(i64),
    /// The traversal ends before it starts.
    #[error("end {end_nanos} ns is before start {start_nanos} ns: a traversal ends after it starts")]
    Backwards {
        /// When the traversal started, nanoseconds UTC.
        start_nanos: i64,
        /// When the traversal ended, nanoseconds UTC.
        end_nanos: i64,
    },
    /// The traversal succeeded in zero time.
    #[error("start and end are both {0} ns: a traversal that succeeds takes time")]
    NoTime(i64),
    /// The traversal lasts too long.
    #[error("it lasts {secs} s, more than a day: a traversal is of one edge, times are in nanoseconds")]
    TooLong {
        /// Duration in seconds.
        secs: f64,
    },
    /// The traversal is too fast.
    #[error("it takes {secs} s, so that its {} would be {value}, which is not {}", .what.prefix(), StateKind::Continuous.expected())]
    TooFast {
        /// Duration in seconds.
        secs: f64,
        /// The quantity that is too fast: speed or pace.
        what: EdgeState,
        /// Metres per second, or nominal time over duration.
        value: f64,
    },
}

impl Traversal {
    /// Checks the times of the traversal.
    ///
    /// # Errors
    /// [`TraversalError`], except [`TraversalError::TooFast`].
    pub fn check(&self) -> Result<(), TraversalError> {
        let Self { start_nanos, end_nanos, success, .. } = *self;
        if start_nanos < 0 {
            return Err(TraversalError::Before1970(start_nanos));
        }
        if end_nanos < start_nanos {
            return Err(TraversalError::Backwards { start_nanos, end_nanos });
        }
        if success && end_nanos == start_nanos {
            return Err(TraversalError::NoTime(start_nanos));
        }
        if end_nanos - start_nanos > TRAVERSAL_MAX_NANOS {
            return Err(TraversalError::TooLong { secs: self.duration_secs() });
        }
        Ok(())
    }

    /// Duration in seconds.
    pub fn duration_secs(&self) -> f64 {
        self.end_nanos.saturating_sub(self.start_nanos) as f64 / 1e9
    }

    /// The samples for the states of the edge, which has this extent: a value for each of one or two states, all at the
    /// start of the traversal.
    ///
    /// # Errors
    /// [`TraversalError`]; then there are no samples.
    pub fn samples(&self, extent: Extent) -> Result<Vec<(EdgeState, f64)>, TraversalError> {
        self.check()?;
        let mut samples = vec![(EdgeState::Success, f64::from(u8::from(self.success)))];
        if self.success {
            let (what, size) = travel(extent);
            let secs = self.duration_secs();
            let value = size / secs;
            if !what.kind().allows(value) {
                return Err(TraversalError::TooFast { secs, what, value });
            }
            samples.push((what, value));
        }
        Ok(samples)
    }

    /// The failure to keep, if the traversal failed.
    pub fn failure(&self) -> Option<EdgeFailure> {
        let Self { edge, start_nanos, end_nanos, success, reason } = self;
        let reason = if *success { None } else { Some(kept_reason(reason)) }?;
        Some(EdgeFailure { edge: edge.clone(), start_nanos: *start_nanos, end_nanos: *end_nanos, reason })
    }
}

/// The travel state of an edge with this extent, and the number that a traversal's duration divides: metres for a
/// speed, or nominal seconds for a pace.
fn travel(extent: Extent) -> (EdgeState, f64) {
    match (extent.length_m, extent.nominal_secs) {
        (Some(length_m), _) => (EdgeState::Speed, length_m),
        // An edge has at least one of the two.
        (None, nominal_secs) => (EdgeState::Pace, nominal_secs.unwrap_or(0.0)),
    }
}

/// Name of the success state of an edge.
///
/// # Errors
/// [`TopologyError::UnknownNodeId`] where the edge is of another map.
pub(crate) fn success_state(topology: &Topology, edge: &Edge) -> Result<StateName, TopologyError> {
    topology.edge_in_words(edge).map(|name| name.state(EdgeState::Success))
}

/// Name and quantity of the travel state of an edge: speed for an edge with a length, pace for one with a nominal time
/// only.
///
/// # Errors
/// [`TopologyError::UnknownNodeId`] where the edge is of another map.
pub(crate) fn travel_state(topology: &Topology, edge: &Edge) -> Result<(EdgeState, StateName), TopologyError> {
    let (what, _) = travel(edge.extent);
    topology.edge_in_words(edge).map(|name| (what, name.state(what)))
}

/// Normalises a reason: unprintable characters become blanks; outer blanks and everything beyond 200 characters are
/// removed. Idempotent.
pub fn kept_reason(reason: &str) -> String {
    let is_blank = |character: char| character.is_whitespace() || unprintable(character);
    let printable = |character| if is_blank(character) { ' ' } else { character };
    let kept: String = reason.trim_start_matches(is_blank).chars().take(REASON_CHARS_MAX).map(printable).collect();
    kept.trim_end().to_owned()
}

/// A traversal that failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EdgeFailure {
    /// The edge.
    pub edge: EdgeName,
    /// When the robot started, nanoseconds UTC.
    pub start_nanos: i64,
    /// When the robot gave up, nanoseconds UTC.
    pub end_nanos: i64,
    /// The reason, normalised by [`kept_reason`].
    pub reason: String,
}

/// The failed traversals of a map that started last: at most [`FAILURES_MAX`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Failures {
    /// The failures, ascending by start; failures with equal starts are in order of arrival.
    oldest_first: Arc<VecDeque<Arc<EdgeFailure>>>,
}

impl Failures {
    /// Adds a failure, and drops the oldest failure where there are too many. If the maximum number is kept, a failure
    /// that is older than all of them is not kept.
    pub fn add(&mut self, failure: EdgeFailure) {
        let kept = Arc::make_mut(&mut self.oldest_first);
        let place = kept.partition_point(|known| known.start_nanos <= failure.start_nanos);
        kept.insert(place, Arc::new(failure));
        if kept.len() > FAILURES_MAX {
            kept.pop_front();
        }
    }

    /// All failures, the newest first.
    pub fn newest_first(&self) -> impl ExactSizeIterator<Item = &EdgeFailure> {
        self.oldest_first.iter().rev().map(|failure| &**failure)
    }

    /// All failures, to be stored. If they are added again in this order, the result is equal.
    pub fn oldest_first(&self) -> impl ExactSizeIterator<Item = &EdgeFailure> {
        self.oldest_first.iter().map(|failure| &**failure)
    }

    /// Gives a node another name.
    pub fn rename_node(&mut self, from: &StateName, to: &StateName) {
        let is_named = |failure: &EdgeFailure| [&failure.edge.from, &failure.edge.to].contains(&from);
        if !self.oldest_first().any(is_named) {
            return;
        }
        for failure in Arc::make_mut(&mut self.oldest_first).iter_mut().filter(|failure| is_named(failure)) {
            let edge = &mut Arc::make_mut(failure).edge;
            for end in [&mut edge.from, &mut edge.to].into_iter().filter(|end| **end == *from) {
                *end = to.clone();
            }
        }
    }
}

#[cfg(test)]
mod tests;
