//! Batches of tiles: some of the tiles that were seen by the same scans, processed together.
//!
//! Invariant: a batch is a few seconds of work, unless a single tile is more, and large enough that computing the
//! phasors of its scans again does not matter.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use super::{super::day::GridDay, pattern::Pattern, rules::Rules, tile_day::BusyTile};
use crate::pace::Pace;

/// Work of a batch, in cells times scans, at about 4 ns each.
const BATCH_WORK: usize = 1_000_000_000;

/// Some tiles of a pattern.
pub(super) struct Batch {
    pattern: Arc<Pattern>,
    tiles: Vec<BusyTile>,
    /// The number of cells of the tiles with a spectrum, plus one for each tile.
    cells: usize,
    cells_max: usize,
}

impl Batch {
    /// A batch without tiles.
    pub(super) fn new(pattern: Arc<Pattern>, rules: &Rules) -> Batch {
        let limits = rules.limits;
        let cells_max = (BATCH_WORK / pattern.scans().max(1)).clamp(limits.batch_cells_min, limits.batch_cells_max);
        Batch { pattern, tiles: Vec::new(), cells: 0, cells_max }
    }

    /// Whether the batch should get no more tiles.
    pub(super) fn is_full(&self) -> bool {
        self.cells >= self.cells_max
    }

    /// Another batch of the pattern, without tiles.
    pub(super) fn next(&self) -> Batch {
        Batch { pattern: Arc::clone(&self.pattern), tiles: Vec::new(), cells: 0, cells_max: self.cells_max }
    }

    pub(super) fn push(&mut self, tile: BusyTile) {
        self.cells += 1 + tile.data.model.cells.len();
        self.tiles.push(tile);
    }

    /// Processes the day for these tiles.
    pub(super) fn run(self, rules: &Rules, day: &GridDay, meter: &ProgressMeter<'_>) -> Vec<BusyTile> {
        let tiles = self.pattern.run(rules, day, self.tiles, meter.pace);
        meter.add(tiles.len());
        tiles
    }
}

/// Reports the progress of an update in tiles. Each tile counts in equal parts on each of its days.
pub(super) struct ProgressMeter<'a> {
    pace: &'a dyn Pace,
    tiles: u64,
    /// Sum of the numbers of days of all tiles.
    days: u64,
    days_done: AtomicU64,
}

impl<'a> ProgressMeter<'a> {
    pub(super) fn new(pace: &'a dyn Pace, tiles: u64, days: &[GridDay]) -> ProgressMeter<'a> {
        let days = days.iter().map(|day| day.tiles().len() as u64).sum();
        ProgressMeter { pace, tiles, days, days_done: AtomicU64::new(0) }
    }

    /// Reports that this many tiles are done for one more of their days.
    pub(super) fn add(&self, days: usize) {
        let before = self.days_done.fetch_add(days as u64, Ordering::Relaxed);
        let part = |done: u64| u128::from(done) * u128::from(self.tiles) / u128::from(self.days.max(1));
        // The parts add up in any order.
        let more = part(before + days as u64) - part(before);
        self.pace.add_done(u64::try_from(more).unwrap_or(0));
    }
}
