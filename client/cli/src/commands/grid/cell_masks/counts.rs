//! Counts of the cells of maps that are not used, or are used with a changed value, for the user who sends them.
//!
//! Invariant: every cell of a 2D map is used as it is, or counted once.

use tidemap_formats::nav2::{GridCell, GridMode};

use super::Between;

/// Numbers of cells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct CellCounts {
    /// Cells of 2D maps.
    pub(super) all: u64,
    /// The unknown ones of these cells; in mode trinary these lie between the thresholds.
    pub(super) unknown: u64,
    /// Cells with a probability between free and occupied that are left out.
    pub(super) left: u64,
    /// Cells with a probability between free and occupied that count as free.
    pub(super) as_free: u64,
    /// Cells with a probability between free and occupied that count as occupied.
    pub(super) as_occupied: u64,
    /// The probability from which on cells count as occupied.
    pub(super) from: Option<f64>,
    /// Cells of the grid's size that lie outside of the grid.
    pub(super) outside: u64,
    /// Pixels of value 205 that count as free.
    pub(super) free_205: u64,
    /// The threshold of free cells.
    pub(super) free_thresh: Option<f64>,
}

impl CellCounts {
    /// Converts a cell of a 2D map to a reading, and counts it: whether the cell is occupied; `None` if it gives no
    /// reading.
    pub(super) fn reading(&mut self, cell: GridCell, mode: GridMode, between: Between) -> Option<bool> {
        self.all += 1;
        match (cell, between) {
            (GridCell::Free, _) => Some(false),
            (GridCell::Occupied, _) => Some(true),
            (GridCell::Unknown, _) => {
                self.unknown += 1;
                None
            }
            (GridCell::Between { .. }, _) if mode == GridMode::Trinary => {
                self.unknown += 1;
                None
            }
            (GridCell::Between { .. }, Between::Leave) => {
                self.left += 1;
                None
            }
            (GridCell::Between { percent }, Between::OccupiedFrom(from)) => {
                self.from = Some(from);
                let is_occupied = f64::from(percent) / 100.0 >= from;
                *(if is_occupied { &mut self.as_occupied } else { &mut self.as_free }) += 1;
                Some(is_occupied)
            }
        }
    }

    /// Counts pixels of value 205 that count as free by a threshold.
    pub(crate) fn add_free_205(&mut self, pixels: u64, free_thresh: f64) {
        if pixels > 0 {
            self.free_205 += pixels;
            self.free_thresh = Some(free_thresh);
        }
    }

    /// Adds the counts of another map.
    pub(crate) fn add(&mut self, other: &CellCounts) {
        self.all += other.all;
        self.unknown += other.unknown;
        self.left += other.left;
        self.as_free += other.as_free;
        self.as_occupied += other.as_occupied;
        self.from = other.from.or(self.from);
        self.outside += other.outside;
        self.free_205 += other.free_205;
        self.free_thresh = other.free_thresh.or(self.free_thresh);
    }

    /// The messages about the counts.
    pub(crate) fn notices(&self) -> Vec<String> {
        let CellCounts { all, unknown, left, as_free, as_occupied, from, outside, free_205, free_thresh } = *self;
        let mut notices = Vec::new();
        if unknown > 0 {
            notices.push(format!("{unknown} of {all} pixels are unknown and count as not observed"));
        }
        if let Some(free_thresh) = free_thresh {
            notices.push(format!(
                "{free_205} of {all} pixels have the value 205, which map savers write for unknown, and count as free with \
                 free_thresh {free_thresh}, as in Nav2's map server. --unknown-205 reads them as unknown"
            ));
        }
        if left > 0 {
            notices
                .push(format!("{left} of {all} pixels are between free and occupied and were not used, by --between"));
        }
        if let Some(from) = from {
            notices.push(format!(
                "{} of {all} pixels are between free and occupied, and a reading is one or the other: {as_occupied} count as \
                 occupied, from {from} on, and {as_free} as free. --between P sets another limit, --between leave leaves \
                 them out",
                as_free + as_occupied,
            ));
        }
        if outside > 0 {
            notices.push(format!("{outside} cells lie outside of the grid and were not used"));
        }
        notices
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cell_is_used_as_it_is_or_named_in_a_notice() {
        let mut counts = CellCounts::default();
        let between = GridCell::Between { percent: 70 };
        assert_eq!(counts.reading(GridCell::Free, GridMode::Raw, Between::Leave), Some(false));
        assert_eq!(counts.reading(GridCell::Occupied, GridMode::Raw, Between::Leave), Some(true));
        assert!(counts.notices().is_empty());
        assert_eq!(counts.reading(GridCell::Unknown, GridMode::Raw, Between::Leave), None);
        assert_eq!(counts.reading(between, GridMode::Trinary, Between::default()), None);
        assert_eq!(counts.reading(between, GridMode::Scale, Between::Leave), None);
        assert_eq!(counts.reading(between, GridMode::Scale, Between::OccupiedFrom(0.7)), Some(true));
        let mut all = counts;
        all.add(&counts);
        let notices = all.notices().join("\n");
        for words in ["4 of 12 pixels are unknown", "2 of 12", "2 count as occupied, from 0.7 on, and 0 as free"] {
            assert!(notices.contains(words), "{words}: {notices}");
        }
    }
}
