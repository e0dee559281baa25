//! Observations of the past: replies.
//!
//! Invariant: a reply has as many values as times.

use tidemap_map::history::Reading;

use crate::v1;

/// Readings for the wire, in their order.
#[must_use]
pub fn past_to_wire(readings: &[Reading]) -> v1::ReconstructResponse {
    let (times_nanos, values) = readings.iter().copied().unzip();
    v1::ReconstructResponse { times_nanos, values }
}
