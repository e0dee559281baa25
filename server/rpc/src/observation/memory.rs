//! The memory of a batch from when it is handed to the writer until it is durable and applied.
//!
//! Invariant: these are estimates, but never much too small, because they bound the memory that waits for a slow disk.

use tidemap_ingest::protocol::{ObservationBatch, ReportBatch};
use tidemap_map::{report::Report, site::Site};

/// Memory of a decoded observation, in bytes.
const OBSERVATION_BYTES: usize = 24;
/// Additional memory of a position: its coordinates, and an observation of each axis.
const POSITION_BYTES: usize = 112;
/// Approximate memory of a refused observation with its reason, in bytes.
const REFUSED_BYTES: usize = 300;
/// Approximate memory of a name besides its text, in bytes.
const NAME_BYTES: usize = 64;

/// Approximate memory of a batch until it is durable, in bytes.
pub(super) fn bytes_of(batch: &ObservationBatch) -> usize {
    let names =
        batch.new_names.iter().map(|name| NAME_BYTES + name.as_ref().map_or(0, |name| name.name.as_str().len()));
    64 + OBSERVATION_BYTES * batch.values.len()
        + POSITION_BYTES * batch.positions.len()
        + REFUSED_BYTES * batch.refused.len()
        + names.sum::<usize>()
}

/// Approximate memory of reports until they are durable, in bytes: as reports, and as observations with the names of
/// their states.
pub(super) fn bytes_of_reports(batch: &ReportBatch, site: &Site) -> usize {
    let each = batch.reports.iter().map(|(_, report)| size_of::<Report>() + 2 * report.log_bytes(site));
    64 + each.sum::<usize>() + REFUSED_BYTES * batch.refused.len()
}

/// Maximum number of bytes of the reports of one record of the log, which has at most 16 MiB.
pub(super) const REPORT_BYTES_MAX: usize = 4 << 20;
