//! Tiles that are worked off, and noted, together: some of those that were seen by the same scans.
//!
//! Invariant: a batch is a few seconds of work, unless a single tile is more, and enough of it that the phasors of its
//! scans, which each batch makes anew, do not count.

use std::sync::Arc;

use super::{
    super::{
        day::GridDay,
        index::TileId,
        progress::{BusyTile, Notes, Share},
    },
    Rules, Working,
    pattern::Pattern,
};

/// Work of a batch: cells times scans, at about 4 ns each.
const WORK: usize = 1_000_000_000;
/// Cells of a batch at least: the phasors of a scan cost as much as about a hundred cells. Tests have many batches.
const CELLS_MIN: usize = if cfg!(test) { 2 } else { 2_000 };
/// Cells of a batch at most.
const CELLS_MAX: usize = if cfg!(test) { 4 } else { 30_000 };

/// Some tiles of a pattern.
pub(super) struct Batch {
    pattern: Arc<Pattern>,
    tiles: Vec<(TileId, BusyTile)>,
    /// What the tiles weigh: their cells with a spectrum, and one for each.
    cells: usize,
    cells_max: usize,
}

impl Batch {
    /// A batch without tiles.
    pub(super) fn new(pattern: Arc<Pattern>) -> Batch {
        let cells_max = (WORK / pattern.scans().max(1)).clamp(CELLS_MIN, CELLS_MAX);
        Batch { pattern, tiles: Vec::new(), cells: 0, cells_max }
    }

    /// Whether it should get no more tiles.
    pub(super) fn is_full(&self) -> bool {
        self.cells >= self.cells_max
    }

    /// Another batch of the pattern, without tiles.
    pub(super) fn next(&self) -> Batch {
        Batch::new(Arc::clone(&self.pattern))
    }

    pub(super) fn push(&mut self, id: TileId, tile: BusyTile) {
        self.cells += 1 + tile.working.model.cells.len();
        self.tiles.push((id, tile));
    }

    /// Works off the day for these tiles.
    pub(super) fn run(
        self,
        rules: &Rules,
        day: &GridDay,
        notes: &Notes<'_>,
        share: &Share<'_>,
    ) -> Vec<(TileId, BusyTile)> {
        let scans = self.pattern.scans();
        let (tiles, accounts): (Vec<(TileId, Working)>, Vec<_>) =
            self.tiles.into_iter().map(|(id, BusyTile { working, account })| ((id, working), account)).unzip();
        let done = self.pattern.run(rules, day, tiles);
        let mut tiles: Vec<(TileId, BusyTile)> = done
            .into_iter()
            .zip(accounts)
            .map(|(((id, working), outcome), mut account)| {
                account.outcome.add(&outcome);
                (id, BusyTile { working, account })
            })
            .collect();
        notes.take(day.day, scans, &mut tiles);
        share.add(tiles.len());
        tiles
    }
}
