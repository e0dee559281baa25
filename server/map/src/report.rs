//! Reports of robots: a traversal of an edge, a sighting of landmarks, a run of a task.
//!
//! Invariant: a report has one sequence number and is an observation of one or more states; it is learned with all of
//! them, or refused.

use tidemap_model::StateKind;

use crate::{
    report_sample::{ReportSample, traversal_samples},
    sighting::{Sighting, SightingError},
    site::Site,
    task::TaskRun,
    topology::TopologyError,
    traversal::{EdgeFailure, Traversal, TraversalError},
};

/// Maximum number of bytes of an observation in the log besides the name of its state.
const OBSERVATION_BYTES: usize = 48;

/// A report of a robot about a place of the topological map.
#[derive(Clone, Debug, PartialEq)]
pub enum Report {
    /// The robot travelled an edge, or tried to.
    Traversal(Traversal),
    /// The robot looked for the landmarks of a place.
    Sighting(Sighting),
    /// The robot did a task, or tried to.
    TaskRun(TaskRun),
}

/// Why a report is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ReportError {
    /// The map does not have the edge of a traversal.
    #[error(transparent)]
    Edge(#[from] TopologyError),
    /// The traversal is invalid.
    #[error(transparent)]
    Traversal(#[from] TraversalError),
    /// The sighting is invalid.
    #[error(transparent)]
    Sighting(#[from] SightingError),
}

impl Report {
    /// The time at which the reported action begins, nanoseconds UTC.
    #[must_use]
    pub fn time_nanos(&self) -> i64 {
        match self {
            Self::Traversal(traversal) => traversal.start_nanos,
            Self::Sighting(sighting) => sighting.time_nanos,
            Self::TaskRun(run) => run.start_nanos,
        }
    }

    /// The observations that the report contains, on a map with this site.
    ///
    /// # Errors
    /// [`ReportError`]; then there are no observations.
    pub fn samples(&self, site: &Site) -> Result<Vec<ReportSample>, ReportError> {
        match self {
            Self::Traversal(traversal) => {
                let edge = site.topology().edge_named(&traversal.edge)?;
                Ok(traversal_samples(traversal, edge)?)
            }
            Self::Sighting(sighting) => Ok(sighting.samples(site)?),
            Self::TaskRun(run) => {
                let (state, kind, value) = (run.name.state(), StateKind::Probability, run.observed());
                Ok(vec![ReportSample { state, kind, time_nanos: run.start_nanos, value }])
            }
        }
    }

    /// The failed traversal that the map keeps, if there is one.
    #[must_use]
    pub fn failure(&self) -> Option<EdgeFailure> {
        match self {
            Self::Traversal(traversal) => traversal.failure(),
            Self::Sighting(sighting) => sighting.traversal.as_ref()?.failure(),
            Self::TaskRun(_) => None,
        }
    }

    /// Maximum number of bytes of the report's observations in the log, and about half of their memory until they are
    /// durable. A sighting is an observation of each landmark of its place.
    #[must_use]
    pub fn log_bytes(&self, site: &Site) -> usize {
        match self {
            Self::Traversal(traversal) => of_traversal(traversal),
            Self::Sighting(sighting) => {
                let at = site.topology().place(&sighting.place).ok().and_then(|place| site.landmarks().at(place));
                let prefix = sighting.place.landmark_prefix().len();
                let landmarks = at.map_or(&[][..], |known| known.landmarks()).iter();
                let of_landmarks = landmarks.map(|known| OBSERVATION_BYTES + prefix + known.name.as_str().len());
                OBSERVATION_BYTES + of_landmarks.sum::<usize>() + sighting.traversal.as_ref().map_or(0, of_traversal)
            }
            // The size is that of the observation and of the run itself.
            Self::TaskRun(run) => 2 * (OBSERVATION_BYTES + run.name.to_string().len()) + run.reason.len(),
        }
    }
}

/// Maximum number of bytes of the observations of a traversal in the log: of two states, and of the failure.
fn of_traversal(traversal: &Traversal) -> usize {
    3 * (OBSERVATION_BYTES + traversal.edge.to_string().len()) + traversal.reason.len()
}
