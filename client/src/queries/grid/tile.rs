//! A tile of a predicted grid, cell by cell.
//!
//! Invariant: every value is from 0 to 1.

use tidemap_grid::predict::CellPrediction;
use tidemap_proto::{convert::cells::tile_from_wire, v1};

use crate::error::Error;

/// The predictions of 8x8x8 cells.
#[derive(Clone, Debug, PartialEq)]
pub struct PredictedTile {
    /// Index: x, y, z in tiles from the origin of the grid.
    pub place: [i32; 3],
    /// The cells: x fastest, then y, then z. A projected tile has only the lowest layer.
    pub cells: Box<[CellPrediction; 512]>,
}

impl PredictedTile {
    pub(super) fn from_wire(tile: v1::PredictedTile, is_projected: bool) -> Result<Self, Error> {
        let (tile, levels) = tile_from_wire(tile, is_projected).map_err(|wrong| Error::Protocol(wrong.0))?;
        let mut cells = Box::new([CellPrediction::Unknown; 512]);
        for (place, cell) in tile.known_cells(levels) {
            cells[usize::from(place)] = cell;
        }
        Ok(Self { place: [tile.index.x, tile.index.y, tile.index.z], cells })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_in_their_places_and_the_others_unknown() -> Result<(), Error> {
        let known = [vec![0b101], vec![0; 62], vec![0x80]].concat();
        let wire = v1::PredictedTile { x: 1, y: -2, z: 3, known, static_low: 0.25, ..v1::PredictedTile::default() };
        let tile = PredictedTile::from_wire(wire, false)?;
        assert_eq!(tile.place, [1, -2, 3]);
        let places: Vec<usize> = (0..512).filter(|&place| tile.cells[place] != CellPrediction::Unknown).collect();
        assert_eq!(places, [0, 2, 511]);
        assert_eq!(tile.cells[2], CellPrediction::Static(0.25));
        Ok(())
    }

    #[test]
    fn a_tile_that_does_not_add_up_is_an_error() {
        let wire = v1::PredictedTile { values: vec![0.5], ..v1::PredictedTile::default() };
        assert!(matches!(PredictedTile::from_wire(wire, false), Err(Error::Protocol(_))));
    }
}
