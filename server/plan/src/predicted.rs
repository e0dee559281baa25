//! What a grid is expected to be in a region, at one time or at many: every cell's probability of being occupied.
//!
//! The region of interest is the grid's extent if it has one, else the bounds of the tiles that there are, cut to what is
//! asked for. A cell of it that was never observed is unknown: it counts as 0.5, full uncertainty, and does not block a
//! view unless the threshold is below 0.5. What lies outside the region tells nothing and is not looked into.
//!
//! Invariant: probabilities are those of [`tidemap_map::grid::view::GridView::predict_tile`]. A cell that is the same at
//! all times is held once.

use tidemap_map::{
    grid::{index::CellBox, spec::InvalidGrid, tile::TileUnavailable},
    selector::ModelSelector,
};

mod lattice;
mod times;

#[cfg(test)]
pub(crate) mod tests;

pub use lattice::Lattice;
pub use times::{PredictedGrid, PredictedTimes};

/// The most cells of a region, unless said otherwise.
pub const CELLS_MAX: u64 = 1 << 24;
/// The most values of cells that differ between times, times counted each, unless said otherwise.
pub(crate) const VALUES_MAX: u64 = 1 << 26;

/// Which model predicts, and what.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictOptions {
    /// Which model answers.
    pub selector: ModelSelector,
    /// Which cells of the region of interest; `None`: all.
    pub region: Option<CellBox>,
    /// The most cells that are held, one cell of border around them counted. Default [`CELLS_MAX`].
    pub max_cells: u64,
    /// The most values that are held of cells that differ between times. Default [`VALUES_MAX`].
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

/// Why a grid is not predicted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum PredictError {
    /// The map has named states alone.
    #[error("the map has no grid")]
    NoGrid,
    /// Nothing was ever observed in the region, and the grid has no extent.
    #[error("the region has no cell: nothing was observed there, or it lies outside the grid's extent")]
    EmptyRegion,
    /// No time was asked for.
    #[error("no time is given: at least one is needed")]
    NoTime,
    /// The region is too large.
    #[error("the region takes {cells} cells with its border, and may take {max}: ask for a smaller region")]
    TooManyCells { cells: u128, max: u64 },
    /// Too many cells change, at too many times.
    #[error(
        "the cells that change take more than {max} values at {times} times: ask for fewer times or a smaller region"
    )]
    TooManyValues { times: usize, max: u64 },
    /// The grid's own properties are wrong.
    #[error(transparent)]
    Grid(#[from] InvalidGrid),
    /// A part of the grid cannot be read.
    #[error(transparent)]
    Unavailable(#[from] TileUnavailable),
}
