//! Predictions of a region of a grid, at one time or at many: every cell's probability of being occupied.
//!
//! The region of interest is the grid's extent if it has one, else the bounds of the existing tiles, intersected with
//! the requested box. A cell that was never observed is unknown: it counts as 0.5, full uncertainty, and does not block
//! a view unless the threshold is below 0.5. Cells outside the region have no information and end a view.
//!
//! Invariant: probabilities are those of [`tidemap_grid::view::GridView::predict_tile`]. A cell that does not
//! change between the times is stored once.

use tidemap_grid::{index::CellBox, spec::InvalidGrid, tile::TileUnavailable};
use tidemap_model::{EarlyStop, selector::ModelSelector};

mod lattice;
mod times;

#[cfg(test)]
pub(crate) mod tests;

pub use lattice::Lattice;
pub use times::{PredictedGrid, PredictedTimes};

/// Default maximum of the cells of a region.
pub const CELLS_MAX: u64 = 1 << 24;
/// Default maximum of the values of changing cells, cells times times.
pub(crate) const VALUES_MAX: u64 = 1 << 26;

/// The model that predicts, and the cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictOptions {
    /// The model.
    pub selector: ModelSelector,
    /// The cells of the region of interest; `None`: all.
    pub region: Option<CellBox>,
    /// Maximum number of stored cells, including one cell of border around them. Default [`CELLS_MAX`].
    pub max_cells: u64,
    /// Maximum number of stored values of changing cells. Default [`VALUES_MAX`].
    pub max_values: u64,
}

impl Default for PredictOptions {
    fn default() -> PredictOptions {
        PredictOptions {
            selector: ModelSelector::default(),
            region: None,
            max_cells: CELLS_MAX,
            max_values: VALUES_MAX,
        }
    }
}

/// The reason why the prediction of a grid failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum PredictError {
    /// The map has no grid.
    #[error("the map has no grid")]
    NoGrid,
    /// There are no observations in the region, and the grid has no extent.
    #[error("the region has no cell: nothing was observed there, or it lies outside the grid's extent")]
    EmptyRegion,
    /// No time is given.
    #[error("no time is given: at least one is needed")]
    NoTime,
    /// The region is too large.
    #[error("the region has {cells} cells with its border, at most {max} are allowed: request a smaller region")]
    TooManyCells { cells: u128, max: u64 },
    /// Too many cells change at too many times.
    #[error("the changing cells have more than {max} values at {times} times: request fewer times or a smaller region")]
    TooManyValues { times: usize, max: u64 },
    /// The properties of the grid are invalid.
    #[error(transparent)]
    Grid(#[from] InvalidGrid),
    /// A tile of the grid is unavailable.
    #[error(transparent)]
    Unavailable(#[from] TileUnavailable),
    /// The work received the signal to stop.
    #[error(transparent)]
    Stop(#[from] EarlyStop),
}
