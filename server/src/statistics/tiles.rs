//! Counters of the grid of a map, and how far it is compressed.
//!
//! Invariant: what is counted of models is what a generation has published; it changes only with an update.

use tidemap_map::{grid::tile::TileModel, view::MapView};
use tidemap_store::Sizes;

use super::Row;
use crate::{catalog::Catalog, ingest::handle::MapHandle};

/// Bytes of a published cell: its mean as a double.
const MEAN_BYTES: u64 = 8;
/// Bytes of a component in force: its periodicity, and amplitude and phase as doubles.
const COMPONENT_BYTES: u64 = 20;
/// Bytes of a published tile: which cells are known, and which of them were always occupied.
const MASK_BYTES: u64 = 128;

/// What a generation has learned of the tiles of a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileTotals {
    /// Cells that were read as both free and occupied.
    pub changed_cells: u64,
    /// Bytes of all that predictions need.
    pub model_bytes: u64,
}

impl TileTotals {
    /// Counts the tiles of a view. One that cannot be read counts as one without changes.
    #[must_use]
    pub fn of(view: &MapView) -> TileTotals {
        let mut totals = TileTotals::default();
        let Some(grid) = view.grid() else { return totals };
        for index in 0..u32::try_from(grid.tiles()).unwrap_or(u32::MAX) {
            totals.model_bytes += MASK_BYTES;
            if let Ok(model) = grid.model(tidemap_map::grid::index::TileId(index)) {
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

/// Bits observed for each bit kept (T-RO 2017, eq. 16); 0 where nothing is kept.
fn ratio(observed_bits: u64, kept_bytes: u64) -> f64 {
    if kept_bytes == 0 { 0.0 } else { observed_bits as f64 / (8.0 * kept_bytes as f64) }
}

/// The rows of one map; all 0 where it has no grid.
pub fn rows(catalog: &Catalog, handle: &MapHandle, sizes: &Sizes) -> Vec<Row> {
    let view = handle.view();
    let totals = handle.tile_totals();
    let grid = view.grid();
    let live_bytes: u64 = grid.map_or(0, |grid| {
        let ids = (0..u32::try_from(grid.tiles()).unwrap_or(u32::MAX)).map(tidemap_map::grid::index::TileId);
        ids.filter_map(|id| grid.live(id)).map(|tile| tile.bytes() as u64).sum()
    });
    let cell_observations = grid.map_or(0, |grid| grid.cell_observations());
    let history = catalog.context().store.history(handle.id).ok().and_then(|history| history.sizes().ok());
    let grid_history = history.unwrap_or_default().grid_bytes;
    vec![
        ("history_bytes", sizes.history_bytes as f64, "bytes"),
        ("tiles", grid.map_or(0, |grid| grid.tiles()) as f64, ""),
        ("scans", grid.map_or(0, |grid| grid.scans()) as f64, ""),
        ("pending_scans", grid.map_or(0, |grid| grid.pending_scans()) as f64, ""),
        ("cell_observations", cell_observations as f64, ""),
        ("changed_cells", totals.changed_cells as f64, ""),
        ("tile_memory_bytes", (live_bytes + handle.tile_bytes()) as f64, "bytes"),
        ("published_model_bytes", totals.model_bytes as f64, "bytes"),
        ("compression_ratio", ratio(cell_observations, totals.model_bytes), ""),
        ("history_compression_ratio", ratio(cell_observations, totals.model_bytes + grid_history), ""),
    ]
}
