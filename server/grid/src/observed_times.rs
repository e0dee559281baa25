//! When the cells of an observation group were observed: the times between, and in how many hours.
//!
//! Cells that were always observed together share it, as they share their sums. With the changes of a cell it tells
//! which periods the cell can have, and how much its readings depend on each other. Invariant: it is that of a named
//! state with the same readings.

use tidemap_model::GapSample;

/// The times at which a group was observed, about 100 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ObservedTimes {
    /// The times between successive observations, each newer than the one before.
    pub gaps: GapSample,
    /// Number of single local hours with an observation; with a half-life, each with the weight of its day.
    pub hours: f64,
}

impl ObservedTimes {
    /// The median gap, and that between regular observations, in nanoseconds; 0 where they are not known.
    pub(crate) fn gap_nanos(&self) -> (u64, u64) {
        (self.gaps.median_nanos(), self.gaps.regular_nanos().unwrap_or(0))
    }
}
