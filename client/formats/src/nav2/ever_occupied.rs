//! The cells of a grid that were occupied at some time, and what a map or a mask shows of them: a thing that is there
//! for a part of the time is free in a map of the hours without it.
//!
//! Invariant: a cell is counted if it was occupied in at least one bin that an update has learned.

use super::{GridCell, Thresholds};
use crate::{MapPicture, PictureCell};

/// Above this probability, a cell that was always the same was always occupied. A cell that no update has
/// learned has this probability, and is not counted.
const ALWAYS_OCCUPIED: f32 = 0.5;

/// Numbers of cells that were occupied at some time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EverOccupied {
    /// All of them.
    pub cells: u64,
    /// The free ones of them; in a keepout mask the allowed ones.
    pub free: u64,
    /// The unknown ones of them: between the thresholds.
    pub unknown: u64,
}

/// The cells that were occupied at some time, in a map of mode trinary.
pub fn in_map(picture: &MapPicture, thresholds: Thresholds) -> EverOccupied {
    let shown = |cell: &PictureCell| thresholds.cell(picture.value_of(*cell).map(f64::from));
    count(picture, picture.cells.iter().map(shown))
}

/// The cells that were occupied at some time, in a keepout mask of their map.
pub fn in_keepout(picture: &MapPicture, mask: &MapPicture) -> EverOccupied {
    let is_forbidden = |cell: &PictureCell| cell.probability().is_some_and(|value| value > 0.0);
    let shown = |cell: &PictureCell| if is_forbidden(cell) { GridCell::Occupied } else { GridCell::Free };
    count(picture, mask.cells.iter().map(shown))
}

fn count(picture: &MapPicture, shown: impl Iterator<Item = GridCell>) -> EverOccupied {
    let mut occupied = EverOccupied::default();
    for (_, shown) in picture.cells.iter().zip(shown).filter(|(cell, _)| was_occupied(**cell)) {
        occupied.cells += 1;
        match shown {
            GridCell::Free => occupied.free += 1,
            GridCell::Unknown | GridCell::Between { .. } => occupied.unknown += 1,
            GridCell::Occupied => {}
        }
    }
    occupied
}

/// Whether a cell was occupied at some time.
fn was_occupied(cell: PictureCell) -> bool {
    match cell {
        PictureCell::Unknown => false,
        PictureCell::Static { probability } => probability > ALWAYS_OCCUPIED,
        PictureCell::Changing { .. } => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PictureError, PictureValue, nav2::keepout, picture::samples};

    fn row(cells: Vec<PictureCell>) -> MapPicture {
        let width = cells.len() as u32;
        MapPicture { size_cells: [width, 1, 1], cells, ..samples::flat() }
    }

    fn cells() -> Vec<PictureCell> {
        let fixed = |probability| PictureCell::Static { probability };
        let changing = |probability| PictureCell::Changing { probability };
        vec![
            PictureCell::Unknown,
            fixed(0.0),
            fixed(0.5),
            fixed(1.0),
            changing(0.1),
            changing(0.254),
            changing(0.4),
            changing(0.64),
            changing(0.8),
        ]
    }

    #[test]
    fn cells_that_were_occupied_are_counted_as_the_file_shows_them() {
        let occupied = in_map(&row(cells()), Thresholds::default());
        assert_eq!(occupied, EverOccupied { cells: 6, free: 2, unknown: 2 });
        let halved = cells().into_iter().map(|cell| match cell {
            PictureCell::Changing { probability } => {
                PictureCell::Changing { probability: f32::from(u8::from(probability >= 0.5)) }
            }
            cell => cell,
        });
        let picture = MapPicture { value: PictureValue::AtLeast(0.5), ..row(halved.collect()) };
        assert_eq!(in_map(&picture, Thresholds::default()), EverOccupied { cells: 6, free: 3, unknown: 0 });
    }

    #[test]
    fn what_a_keepout_mask_allows_is_free() -> Result<(), PictureError> {
        let picture = row(cells());
        let mask = keepout(&picture, &[], 0.4)?;
        assert_eq!(in_keepout(&picture, &mask), EverOccupied { cells: 6, free: 2, unknown: 0 });
        Ok(())
    }
}
