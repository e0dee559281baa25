//! A tile of a predicted grid.
//!
//! Invariant: a tile from [`PredictedTile::from_wire`] has used each value exactly once, and every value is in [0, 1].

use tidemap_proto::v1;

use crate::error::Error;

/// The prediction of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum CellPrediction {
    /// The cell was never observed.
    #[default]
    Unknown,
    /// The value of a cell that was always read the same.
    Static(f32),
    /// The value of a cell that has changed.
    Changing(f32),
}

impl CellPrediction {
    /// The value; `None` for an unknown cell.
    #[must_use]
    pub fn value(self) -> Option<f32> {
        match self {
            Self::Unknown => None,
            Self::Static(value) | Self::Changing(value) => Some(value),
        }
    }
}

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
        let bytes = if is_projected { 8 } else { 64 };
        let bits = |mask: &[u8]| -> Result<[bool; 512], Error> {
            // Empty masks may be left out.
            if !mask.is_empty() && mask.len() != bytes {
                return Err(Error::Protocol("a mask of a tile has another length"));
            }
            let bit = |place: usize| mask.get(place / 8).is_some_and(|byte| byte >> (place % 8) & 1 == 1);
            Ok(std::array::from_fn(bit))
        };
        let (known, changed, high) = (bits(&tile.known)?, bits(&tile.changed)?, bits(&tile.high)?);
        let mut values = tile.values.into_iter();
        let mut next = || values.next().ok_or(Error::Protocol("values of a tile are missing"));
        let mut cells = Box::new([CellPrediction::Unknown; 512]);
        for (place, cell) in cells.iter_mut().enumerate().filter(|(place, _)| known[*place]) {
            *cell = match (changed[place], tile.all_values) {
                (true, _) => CellPrediction::Changing(next()?),
                (false, true) => CellPrediction::Static(next()?),
                (false, false) => CellPrediction::Static(if high[place] { tile.static_high } else { tile.static_low }),
            };
        }
        if values.next().is_some() {
            return Err(Error::Protocol("a tile has more values than cells"));
        }
        if cells.iter().filter_map(|cell| cell.value()).any(|value| !(0.0..=1.0).contains(&value)) {
            return Err(Error::Protocol("a value of a tile is not between 0 and 1"));
        }
        Ok(Self { place: [tile.x, tile.y, tile.z], cells })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wire() -> v1::PredictedTile {
        let mask = |bits: u8| [vec![bits], vec![0; 63]].concat();
        v1::PredictedTile {
            x: 1,
            y: -2,
            z: 3,
            known: mask(0b1111),
            changed: mask(0b0101),
            high: mask(0b0010),
            static_high: 0.75,
            static_low: 0.25,
            values: vec![0.1, 0.9],
            all_values: false,
        }
    }

    #[test]
    fn cells_are_unknown_static_or_changing() -> Result<(), Error> {
        use CellPrediction::{Changing, Static, Unknown};
        let tile = PredictedTile::from_wire(wire(), false)?;
        assert_eq!(tile.place, [1, -2, 3]);
        assert_eq!(tile.cells[..5], [Changing(0.1), Static(0.75), Changing(0.9), Static(0.25), Unknown]);
        assert!(tile.cells[5..].iter().all(|cell| *cell == Unknown));
        let all = v1::PredictedTile { all_values: true, values: vec![0.1, 0.2, 0.3, 0.4], high: Vec::new(), ..wire() };
        let tile = PredictedTile::from_wire(all, false)?;
        assert_eq!(tile.cells[..5], [Changing(0.1), Static(0.2), Changing(0.3), Static(0.4), Unknown]);
        Ok(())
    }

    #[test]
    fn a_tile_that_does_not_add_up_is_an_error() {
        let wrong = |change: fn(&mut v1::PredictedTile), is_projected| {
            let mut tile = wire();
            change(&mut tile);
            PredictedTile::from_wire(tile, is_projected).is_err()
        };
        assert!(!wrong(|_| {}, false));
        assert!(wrong(|_| {}, true), "a projected tile has 8 bytes");
        assert!(wrong(|tile| tile.values.truncate(1), false));
        assert!(wrong(|tile| tile.values.push(0.5), false));
        assert!(wrong(|tile| tile.known.truncate(63), false));
        assert!(wrong(|tile| tile.values[0] = 1.5, false));
        assert!(wrong(|tile| tile.static_low = f32::NAN, false));
    }
}
