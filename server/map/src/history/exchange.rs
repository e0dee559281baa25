//! Compares the readings of modelled cells with the predictions of their models: s ⊕ s' where a cell was observed.
//!
//! Invariant: two exchanges with the same models change nothing, because a model always makes the same predictions. A
//! tile without models stays unchanged.

use tidemap_grid::{
    day::{Bit, DayTile, Flip},
    mask::{Mask, TileMasks},
};

use super::{
    OutlierModel,
    bits::Bits,
    phasors::{DayPhasors, Sum},
    seen::{CellBits, Seen, flips_of, order},
};

/// Reused memory for the rows of one cell.
#[derive(Debug, Default)]
pub(super) struct Rows {
    pub(super) cell: CellBits,
    pub(super) sum: Sum,
    /// The model's predictions at all scans. `predicted` has the predictions at the scans that saw the tile.
    pub(super) predicted_ever: Bits,
    pub(super) predicted: Bits,
    pub(super) differing: Bits,
}

impl Rows {
    /// Finds where the cell differs from the predictions of the model by the sum so far.
    pub(super) fn compare(&mut self, seen: &Seen) {
        self.sum.occupied(&mut self.predicted_ever);
        seen.gather(&mut self.predicted_ever, &mut self.predicted);
        self.differing.set_differing(&self.cell.occupied, &self.predicted, &self.cell.observed);
    }
}

/// Turns the readings of modelled cells into outliers, and outliers into readings.
pub(super) fn exchange(
    tile: &DayTile,
    seen: &Seen,
    models: &[OutlierModel],
    phasors: &DayPhasors,
    rows: &mut Rows,
) -> DayTile {
    let mut cells = Mask::EMPTY;
    models.iter().for_each(|model| cells.insert(model.cell));
    if cells.is_empty() || seen.count() == 0 {
        return tile.clone();
    }
    let mut exchanged = tile.clone();
    exchanged.flips.retain(|flip| flip.bit() == Bit::Observed || !cells.contains(flip.cell()));
    let (mut first, mut last) = (tile.first.occupied().without(cells), tile.last.occupied().without(cells));
    let flips = flips_of(tile, seen, cells);
    for (cell, flips) in cells.cells().zip(&flips) {
        let Some(model) = models.iter().find(|model| model.cell == cell) else { continue };
        rows.cell.fill(tile, cell, flips, seen);
        rows.sum.start(model.mean, phasors);
        model.components.iter().for_each(|component| rows.sum.add(component, phasors));
        rows.compare(seen);
        if rows.differing.get(0) {
            first.insert(cell);
        }
        if rows.differing.last() {
            last.insert(cell);
        }
        exchanged.flips.extend(rows.differing.toggles().map(|at| Flip::new(seen.scan(at), cell, Bit::Occupied)));
    }
    exchanged.flips.sort_unstable_by_key(order);
    exchanged.first = TileMasks::clipped(tile.first.observed(), first);
    exchanged.last = TileMasks::clipped(tile.last.observed(), last);
    exchanged
}
