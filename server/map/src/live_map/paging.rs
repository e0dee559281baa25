//! Moves tiles out of memory, for a map that has a grid.
//!
//! Invariant: no tile is removed from memory while an update has the sums.

use std::sync::Arc;
use tidemap_grid::{
    live::LiveGrid,
    paging::{SavedTiles, TileMemory},
    tile::TileSource,
};

use super::LiveMap;

impl LiveMap {
    /// Memory of models and sums of tiles, without the models and sums that a running update has.
    pub fn tile_memory(&self) -> TileMemory {
        self.grid.as_ref().map(LiveGrid::memory).unwrap_or_default()
    }

    /// From now on, reads tiles outside of memory from this save, which is the newest. Then moves saved tiles out of
    /// memory until the rest take `budget_bytes` or less. Returns the number of tiles moved; 0 while an update runs.
    /// Views published from now on do not hold them.
    pub fn page_out(&mut self, source: &Arc<dyn TileSource>, saved: &SavedTiles, budget_bytes: u64) -> usize {
        if self.is_updating() {
            return 0;
        }
        self.grid.as_mut().map_or(0, |grid| grid.page_out(source, saved, budget_bytes))
    }
}
