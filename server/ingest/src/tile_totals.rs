//! Totals of the tiles that a generation has published.
//!
//! Invariant: the totals change only with an update.

use tidemap_grid::{index::TileId, tile::TileModel};
use tidemap_map::view::MapView;

/// Bytes of a published cell: its mean as a double.
const MEAN_BYTES: u64 = 8;
/// Bytes of a component in force: its periodicity, and its amplitude and phase as doubles.
const COMPONENT_BYTES: u64 = 20;
/// Bytes of a published tile: two masks, of the known cells and of the always occupied ones.
const MASK_BYTES: u64 = 128;

/// The totals of the tiles of a map that a generation has learned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct TileTotals {
    /// Number of cells that were read as both free and occupied.
    pub changed_cells: u64,
    /// Number of bytes that predictions need.
    pub model_bytes: u64,
}

impl TileTotals {
    /// Counts the tiles of a view. An unreadable tile counts as a tile without changes.
    pub(crate) fn of(view: &MapView) -> TileTotals {
        let mut totals = TileTotals::default();
        let Some(grid) = view.grid() else { return totals };
        for index in 0..u32::try_from(grid.tiles()).unwrap_or(u32::MAX) {
            totals.model_bytes += MASK_BYTES;
            if let Ok(model) = grid.model(TileId(index)) {
                totals.add(&model);
            }
        }
        totals
    }

    fn add(&mut self, model: &TileModel) {
        self.changed_cells += model.cells.len() as u64;
        for cell in &model.cells {
            let in_force = usize::from(cell.order).min(cell.spectral.components().len());
            self.model_bytes += MEAN_BYTES + COMPONENT_BYTES * in_force as u64;
        }
    }
}
