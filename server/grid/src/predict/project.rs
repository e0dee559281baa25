//! Projection along z: a column counts as its most probable known cell.
//!
//! Invariant: a column is unknown where none of its cells is known; of equally probable cells the lowest counts.

use tidemap_model::InstantPhasors;

use super::{GridQuestion, TileCells};
use crate::{
    index::{TileId, TileIndex},
    mask::Mask,
    tile::TileUnavailable,
    view::GridView,
};

/// The 64 columns of a stack of tiles.
#[derive(Debug)]
pub(super) struct Columns {
    best: [f32; 64],
    known: u64,
    changed: u64,
    high: u64,
    /// Columns whose best cell has a value of its own, although it has not changed.
    own: u64,
    values: Vec<f32>,
}

impl Default for Columns {
    fn default() -> Columns {
        Columns { best: [0.0; 64], known: 0, changed: 0, high: 0, own: 0, values: Vec::new() }
    }
}

impl Columns {
    /// The projection of a stack of tiles, given from the lowest up.
    pub(super) fn project(
        &mut self,
        grid: &GridView,
        tiles: &[(TileIndex, TileId)],
        question: &GridQuestion,
        phasors: &InstantPhasors,
    ) -> Result<TileCells, TileUnavailable> {
        (self.known, self.changed, self.high, self.own) = (0, 0, 0, 0);
        let mut index = TileIndex::default();
        for &tile in tiles {
            index = TileIndex { z: 0, ..tile.0 };
            let mut values = std::mem::take(&mut self.values);
            values.clear();
            let cells = grid.predict_changed(tile, question, phasors, values)?;
            self.add(&cells, grid.levels());
            self.values = cells.values;
        }
        Ok(self.tile_cells(index, question))
    }

    fn add(&mut self, cells: &TileCells, levels: (f64, f64)) {
        let mut values = cells.values.iter();
        for cell in cells.known.cells() {
            let (is_changed, is_high) = (cells.changed.contains(cell), cells.high.contains(cell));
            let value = if is_changed || cells.all_values {
                values.next().copied().unwrap_or(0.0)
            } else if is_high {
                levels.1 as f32
            } else {
                levels.0 as f32
            };
            let place = usize::from(cell & 63);
            let column = 1 << place;
            if self.known & column != 0 && value <= self.best[place] {
                continue;
            }
            self.best[place] = value;
            self.known |= column;
            let set = |mask: &mut u64, is_set: bool| if is_set { *mask |= column } else { *mask &= !column };
            set(&mut self.changed, is_changed);
            set(&mut self.high, is_high && !is_changed);
            set(&mut self.own, cells.all_values && !is_changed);
        }
    }

    fn tile_cells(&self, index: TileIndex, question: &GridQuestion) -> TileCells {
        let layer = |word: u64| Mask([word, 0, 0, 0, 0, 0, 0, 0]);
        let all_values = self.own != 0;
        let listed = layer(if all_values { self.known } else { self.changed });
        let value = |cell: u16| question.output.of(self.best[usize::from(cell & 63)]);
        TileCells {
            index,
            known: layer(self.known),
            changed: layer(self.changed),
            high: layer(self.high),
            values: listed.cells().map(value).collect(),
            all_values,
        }
    }
}
