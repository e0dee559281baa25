//! The times at which the cells of an observation group were observed: the gaps between them, and the hours they are
//! in.
//!
//! Cells that were always observed together share these times, as they share their sums. With the changes of a cell
//! they determine which periods the cell can have, how much its readings depend on each other, and at which hours it is
//! known. Invariant: they are equal to the times of a named state with the same readings.

use tidemap_model::{GapSample, HoursSeen};

/// The times at which a group was observed, about 300 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ObservedTimes {
    /// The times between successive observations, each newer than the one before.
    pub gaps: GapSample,
    /// Number of single local hours with an observation; with a half-life, each counts with the weight of its day.
    pub hours: f64,
    /// `hours` by hour of the day, of weekdays and of weekends. Single precision counts them exactly.
    pub by_hour: [[f32; 24]; 2],
}

impl ObservedTimes {
    /// The number of hours by hour of the day, spread evenly, where only the total number is known.
    pub fn spread(hours: f64) -> [[f32; 24]; 2] {
        [[(hours / 48.0) as f32; 24]; 2]
    }

    /// Multiplies the weight of the hours so far by a factor.
    pub(crate) fn scale(&mut self, factor: f64) {
        self.hours *= factor;
        self.by_hour.as_flattened_mut().iter_mut().for_each(|hours| *hours = (f64::from(*hours) * factor) as f32);
    }

    /// The content as the key of a table: two keys are equal exactly if the times are equal, bit by bit.
    pub(crate) fn key(&self) -> (GapSample, u64, [[u32; 24]; 2]) {
        (self.gaps, self.hours.to_bits(), self.by_hour.map(|hours| hours.map(f32::to_bits)))
    }

    /// How well each hour of the day is known.
    pub(crate) fn hours_seen(&self) -> HoursSeen {
        HoursSeen::of_bins(&self.by_hour.map(|hours| hours.map(f64::from)))
    }

    /// The median gap, and the median gap between regular observations, in nanoseconds; 0 where they are not known.
    pub(crate) fn gap_nanos(&self) -> (u64, u64) {
        (self.gaps.median_nanos(), self.gaps.regular_nanos().unwrap_or(0))
    }
}
