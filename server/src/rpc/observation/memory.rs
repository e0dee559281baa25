//! The memory that a batch takes from when it is handed to the writer until it is durable and applied.
//!
//! Invariant: these are estimates, but never much too small, because they bound the memory that waits for a slow disk.

use tidemap_map::{task::WorkReport, traversal::EdgeFailure};

use crate::ingest::protocol::{ObservationBatch, TraversalBatch};

/// Memory of a decoded observation, in bytes.
const OBSERVATION_BYTES: usize = 24;
/// Additional memory of a position: its coordinates, and an observation of each axis.
const POSITION_BYTES: usize = 112;
/// Memory of a refused observation with its reason, in bytes, about.
const REFUSED_BYTES: usize = 300;
/// Memory of a name besides its text, in bytes, about.
const NAME_BYTES: usize = 64;

/// Memory of a batch until it is durable, about.
pub(super) fn bytes_of(batch: &ObservationBatch) -> usize {
    let names =
        batch.new_names.iter().map(|name| NAME_BYTES + name.as_ref().map_or(0, |name| name.name.as_str().len()));
    64 + OBSERVATION_BYTES * batch.values.len()
        + POSITION_BYTES * batch.positions.len()
        + REFUSED_BYTES * batch.refused.len()
        + names.sum::<usize>()
}

/// Memory of traversals until they are durable, about: as they are, as observations with the names of their states, and
/// as failures.
pub(super) fn bytes_of_traversals(batch: &TraversalBatch) -> usize {
    let texts = |report: &WorkReport| match report {
        WorkReport::Edge(traversal) => 3 * traversal.edge.to_string().len() + 2 * traversal.reason.len(),
        WorkReport::Task(run) => 3 * run.name.to_string().len() + 2 * run.reason.len(),
    };
    let each = |(_, report): &(u64, WorkReport)| {
        size_of::<WorkReport>() + 2 * (OBSERVATION_BYTES + NAME_BYTES) + texts(report) + size_of::<EdgeFailure>()
    };
    64 + batch.traversals.iter().map(each).sum::<usize>() + REFUSED_BYTES * batch.refused.len()
}
