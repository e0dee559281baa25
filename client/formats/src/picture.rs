//! A predicted map, as the writers of files take it.
//!
//! Invariant: a picture that passes [`MapPicture::check`] has the number of cells of its size, and every known cell has
//! a value within [0, 1]; all writers check it first.

use tidemap_model::entropy_bits;
use tidemap_picture::{CellPaint, Colour, Layer, Painter};

use super::CELLS_MAX;

/// A box of cells with their predictions.
#[derive(Clone, Debug, PartialEq)]
pub struct MapPicture {
    /// Length of a cell's side.
    pub resolution_m: f64,
    /// Lower corner of the cell (0, 0, 0) of the picture.
    pub origin_m: [f64; 3],
    /// Index of that cell in the grid, which is part of cell names.
    pub min_cell: [i32; 3],
    /// Number of cells along x, y and z; z is 1 for a flat map.
    pub size_cells: [u32; 3],
    /// The cells: x fastest, then y, then z.
    pub cells: Vec<PictureCell>,
    /// The quantity that files show of the cells.
    pub value: PictureValue,
    /// The probability after a free and after an occupied reading of the map's sensor.
    pub levels: (f64, f64),
}

/// The quantity of the values of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum PictureValue {
    /// The probability that a cell is occupied.
    #[default]
    Probability,
    /// The entropy of that probability, in bits.
    Entropy,
    /// 1 if the probability is at least this, else 0.
    AtLeast(f64),
}

impl PictureValue {
    /// The text of the quantity in legends.
    pub fn text(self) -> String {
        match self {
            Self::Probability => "probability of occupied".to_owned(),
            Self::Entropy => "entropy in bits".to_owned(),
            Self::AtLeast(probability) => format!("1 where the probability of occupied is at least {probability}"),
        }
    }
}

/// The prediction of a cell: the probability that it is occupied; in a picture of [`PictureValue::AtLeast`], 0 or 1.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs, reason = "see the type")]
pub enum PictureCell {
    /// Never observed.
    Unknown,
    /// A cell that does not change with time.
    Static { probability: f32 },
    /// A cell that has a model.
    Changing { probability: f32 },
}

/// Why a picture cannot be written.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum PictureError {
    /// No cells.
    #[error("the map has no cells: its size is {0:?}")]
    Empty([u32; 3]),
    /// Too many cells for a file.
    #[error("the map has {found} cells and a file takes at most {CELLS_MAX}: select a smaller part")]
    TooLarge { found: u128 },
    /// The number of cells does not match the size.
    #[error("the map has {found} cells, which does not match its size {size_cells:?}")]
    Count { found: usize, size_cells: [u32; 3] },
    /// An invalid length of the cells' sides.
    #[error("the cells' side is {0} m: it must be a positive number")]
    Resolution(f64),
    /// An invalid origin.
    #[error("the map's origin is {0:?}: it must be three finite numbers")]
    Origin([f64; 3]),
    /// Pictures that are compared and have different sizes.
    #[error("the maps that are compared have different sizes, {0:?} and {1:?} cells: repeat the request")]
    Sizes([u32; 3], [u32; 3]),
    /// A value outside 0 to 1.
    #[error("the value of cell {cell} is {value}: it must be within 0 and 1")]
    Value { cell: usize, value: f32 },
    /// Several layers, in a format with one.
    #[error("the map has {0} layers of cells and this format has one: select a single layer")]
    Layers(u32),
    /// Unknown cells, in a mode without them.
    #[error(
        "cell {cell} is unknown, which a PGM file of mode scale cannot contain: a map server would show it as a \
         probability; use mode raw or trinary"
    )]
    UnknownInScale { cell: usize },
    /// Beyond the tree of an OctoMap.
    #[error(
        "the map begins at {origin_m:?} m, and a .bt file reaches {reach_m} m from 0 along each axis: only a \
         part within that can be written"
    )]
    BeyondTree { origin_m: [f64; 3], reach_m: f64 },
    /// The cells of the map lie between the cells of an OctoMap.
    #[error(
        "the cells of the map lie {off_cells:.2} of a cell beside those of a .bt file, which has the corner of a cell \
         at 0:0:0: only a grid whose origin is a whole number of cells of {resolution_m} m can be written"
    )]
    OffTree { resolution_m: f64, off_cells: f64 },
    /// Thresholds in the wrong order.
    #[error("free up to {free} and occupied from {occupied}: both must be within 0 and 1, the first below the second")]
    Thresholds { free: f64, occupied: f64 },
    /// The encoder failed.
    #[error("the picture cannot be encoded: {0}")]
    Encode(String),
}

impl PictureCell {
    /// The probability that the cell is occupied; none if the cell is unknown.
    pub fn probability(self) -> Option<f32> {
        match self {
            Self::Unknown => None,
            Self::Static { probability } | Self::Changing { probability } => Some(probability),
        }
    }

    /// The probability of a later cell minus the probability of this one; none if one of the two is unknown.
    pub fn difference(self, later: PictureCell) -> Option<f32> {
        Some(later.probability()? - self.probability()?)
    }
}

/// The first of pictures that are compared.
///
/// # Errors
/// There is no picture, one is invalid or has several layers, or their sizes differ.
pub(crate) fn same_size(panels: &[(String, MapPicture)]) -> Result<&MapPicture, PictureError> {
    let (_, first) = panels.first().ok_or(PictureError::Empty([0; 3]))?;
    for (_, picture) in panels {
        picture.check_flat()?;
        if picture.size_cells != first.size_cells {
            return Err(PictureError::Sizes(first.size_cells, picture.size_cells));
        }
    }
    Ok(first)
}

impl MapPicture {
    /// Checks that the picture can be written.
    pub fn check(&self) -> Result<(), PictureError> {
        let cells: u128 = self.size_cells.iter().map(|&cells| u128::from(cells)).product();
        if cells == 0 {
            return Err(PictureError::Empty(self.size_cells));
        }
        if cells > u128::from(CELLS_MAX) {
            return Err(PictureError::TooLarge { found: cells });
        }
        if self.cells.len() as u128 != cells {
            return Err(PictureError::Count { found: self.cells.len(), size_cells: self.size_cells });
        }
        if !(self.resolution_m.is_finite() && self.resolution_m > 0.0) {
            return Err(PictureError::Resolution(self.resolution_m));
        }
        if !self.origin_m.iter().all(|coordinate| coordinate.is_finite()) {
            return Err(PictureError::Origin(self.origin_m));
        }
        let wrong = |(cell, value): (usize, f32)| {
            if (0.0..=1.0).contains(&value) { None } else { Some(PictureError::Value { cell, value }) }
        };
        let values = self.cells.iter().enumerate().filter_map(|(cell, kind)| Some((cell, kind.probability()?)));
        values.into_iter().find_map(wrong).map_or(Ok(()), Err)
    }

    /// Checks that the picture can be written to a format with one layer.
    pub fn check_flat(&self) -> Result<(), PictureError> {
        self.check()?;
        match self.size_cells[2] {
            1 => Ok(()),
            layers => Err(PictureError::Layers(layers)),
        }
    }

    /// The value of a cell in files: its probability, or its entropy in bits; none if the cell is unknown.
    #[allow(clippy::cast_possible_truncation, reason = "a value of a cell is a single")]
    pub fn value_of(&self, cell: PictureCell) -> Option<f32> {
        let probability = cell.probability()?;
        Some(if self.value == PictureValue::Entropy {
            entropy_bits(f64::from(probability)) as f32
        } else {
            probability
        })
    }

    /// The painter of the cells.
    pub(crate) fn painter(&self) -> Painter {
        match self.value {
            PictureValue::Probability => Painter::new(Layer::Probability, self.levels),
            PictureValue::Entropy => Painter::new(Layer::Entropy, self.levels),
            PictureValue::AtLeast(_) => Painter::new(Layer::Probability, (0.0, 1.0)),
        }
    }

    /// The colour of a cell.
    pub(crate) fn colour(&self, cell: PictureCell) -> Colour {
        let known = cell.probability().zip(self.value_of(cell));
        self.painter().colour(
            known.map(|(probability, value)| CellPaint { probability: probability.into(), value: value.into() }),
        )
    }

    /// The known cells with their centres in metres.
    pub fn known(&self) -> impl Iterator<Item = ([f64; 3], PictureCell)> {
        let centre = |at: [usize; 3], axis: usize| self.origin_m[axis] + (at[axis] as f64 + 0.5) * self.resolution_m;
        self.known_at().map(move |(at, cell)| (std::array::from_fn(|axis| centre(at, axis)), cell))
    }

    /// The known cells with their indices in the grid.
    pub fn known_indices(&self) -> impl Iterator<Item = ([i64; 3], PictureCell)> {
        let index = |at: [usize; 3], axis: usize| i64::from(self.min_cell[axis]) + at[axis] as i64;
        self.known_at().map(move |(at, cell)| (std::array::from_fn(|axis| index(at, axis)), cell))
    }

    /// The known cells with their positions in the picture.
    fn known_at(&self) -> impl Iterator<Item = ([usize; 3], PictureCell)> {
        let [width, height, _] = self.size_cells.map(|cells| (cells as usize).max(1));
        self.cells
            .iter()
            .enumerate()
            .filter(|(_, cell)| **cell != PictureCell::Unknown)
            .map(move |(index, &cell)| ([index % width, index / width % height, index / width / height], cell))
    }

    /// The rows of a flat picture, the row with the largest y first, as in images.
    pub fn rows_from_top(&self) -> impl Iterator<Item = &[PictureCell]> {
        self.cells.chunks((self.size_cells[0] as usize).max(1)).rev()
    }
}

#[cfg(test)]
pub(crate) mod samples {
    //! Pictures for tests.
    //!
    //! Invariant: [`flat`] has every kind of cell, and no two equal rows.

    use super::*;

    /// Three cells wide, two high.
    pub(crate) fn flat() -> MapPicture {
        use PictureCell::{Changing, Static, Unknown};
        MapPicture {
            resolution_m: 0.05,
            origin_m: [-1.5, 2.0, 0.0],
            min_cell: [-30, 40, 0],
            size_cells: [3, 2, 1],
            cells: vec![
                Static { probability: 0.0 },
                Static { probability: 1.0 },
                Unknown,
                Changing { probability: 0.0 },
                Changing { probability: 0.5 },
                Changing { probability: 1.0 },
            ],
            value: PictureValue::Probability,
            levels: (0.0, 1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_checked_before_it_is_written() {
        assert_eq!(samples::flat().check_flat(), Ok(()));
        let broken = |change: fn(&mut MapPicture)| {
            let mut picture = samples::flat();
            change(&mut picture);
            picture.check_flat()
        };
        assert_eq!(broken(|picture| picture.size_cells[1] = 0), Err(PictureError::Empty([3, 0, 1])));
        assert!(matches!(broken(|picture| picture.size_cells = [u32::MAX; 3]), Err(PictureError::TooLarge { .. })));
        assert!(matches!(broken(|picture| picture.cells.truncate(5)), Err(PictureError::Count { found: 5, .. })));
        assert_eq!(broken(|picture| picture.resolution_m = 0.0), Err(PictureError::Resolution(0.0)));
        assert!(matches!(broken(|picture| picture.origin_m[1] = f64::NAN), Err(PictureError::Origin(_))));
        assert_eq!(broken(|picture| picture.size_cells = [3, 1, 2]), Err(PictureError::Layers(2)));
        for value in [-0.1, 1.1, f32::NAN] {
            let mut picture = samples::flat();
            picture.cells[4] = PictureCell::Changing { probability: value };
            assert!(matches!(picture.check(), Err(PictureError::Value { cell: 4, .. })));
        }
    }

    #[test]
    fn cells_know_their_centres() {
        let mut picture = samples::flat();
        picture.size_cells = [1, 3, 2];
        picture.resolution_m = 2.0;
        let centres: Vec<[f64; 3]> = picture.known().map(|(centre, _)| centre).collect();
        let expected = [[-0.5, 3.0, 1.0], [-0.5, 5.0, 1.0], [-0.5, 3.0, 3.0], [-0.5, 5.0, 3.0], [-0.5, 7.0, 3.0]];
        assert_eq!(centres, expected);
    }
}
