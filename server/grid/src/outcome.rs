//! The result of an update of a grid in numbers: observations learned, errors of each order, and the orders of the
//! cells.

use tidemap_model::ORDER_MAX;

/// The result of an update for the cells of a grid.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GridOutcome {
    /// Tiles that had scans.
    pub tiles: u64,
    /// Scans learned.
    pub scans: u64,
    /// Cells with a spectrum, in all tiles that had scans.
    pub changed_cells: u64,
    /// The sum of the outcomes of these tiles.
    pub cells: TileOutcome,
    /// Number of cells of these tiles that had each order before the update; cells without a spectrum are not counted.
    pub cells_by_order_before: CellsByOrder,
    /// Number of cells that have each order after the update.
    pub cells_by_order: CellsByOrder,
}

/// Number of cells per order 0..=15.
pub type CellsByOrder = [u64; ORDER_MAX + 1];

/// The result of an update for the cells of one tile.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TileOutcome {
    /// Observations of single cells learned.
    pub observations: u64,
    /// Observations of cells with a spectrum that were predicted first and scored.
    pub scored: u64,
    /// Sum of squared errors of the scored observations, per order 0..=15.
    pub squared_errors: [f64; ORDER_MAX + 1],
    /// Sum of squared errors, each of a prediction with the order in force for the cell on the day.
    pub squared_error_in_force: f64,
    /// Sum of squared errors, each of a prediction with the order that was chosen for the cell on that day.
    pub squared_error_chosen: f64,
}

impl TileOutcome {
    pub(crate) fn add(&mut self, other: &TileOutcome) {
        self.observations += other.observations;
        self.scored += other.scored;
        self.squared_error_in_force += other.squared_error_in_force;
        self.squared_error_chosen += other.squared_error_chosen;
        for (sum, error) in self.squared_errors.iter_mut().zip(&other.squared_errors) {
            *sum += error;
        }
    }
}
