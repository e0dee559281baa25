//! Grids of the ROS map servers: a YAML file that describes a grey image, and the image as PGM.
//!
//! What a cell is, is read as the map servers of ROS read it, in all three modes. Let `shade` be the pixel from 0 black
//! to 1 white, and `occ` be `1 - shade`, or `shade` where `negate` is set:
//!
//! - `trinary`: occupied above `occupied_thresh`, free below `free_thresh`, unknown between;
//! - `scale`: the same, but between the two lies a probability. Unknown is said by transparent pixels, which a PGM file
//!   does not have;
//! - `raw`: `shade * 255` is the probability in percent from 0 to 100, and anything above is unknown.
//!
//! Written are `trinary`, the mode every tool understands, and, for probabilities, `raw`: it is the only mode in which
//! a PGM file can say both probabilities and unknown. `scale` is written for grids without unknown cells.
//!
//! In trinary files a cell is free up to 25 % and occupied from 65 %, and the pixels are 254, 0, and 205 for unknown,
//! as map savers do; but `free_thresh` is written as 0.196 and not as 0.25, since `occ` of the pixel 205 is 0.1961,
//! which would be read back as free.
//!
//! Invariant: rows of a [`Grid`] go upwards, those of the image downwards; a grid that is read has as many cells as the
//! image has pixels.

mod pgm;
mod settings;
#[cfg(test)]
mod tests;
mod write;

use super::error::{FilePlace, FormatError};

pub use settings::{GridMode, GridSettings, read_settings};
pub use write::{Thresholds, write};

/// A grid of cells in the plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Length of a cell's side.
    pub resolution_m: f64,
    /// Lower left corner of the grid.
    pub origin_m: [f64; 2],
    /// Number of cells along x and y.
    pub size_cells: [u32; 2],
    /// The cells: x fastest, then y, both upwards.
    pub cells: Vec<GridCell>,
}

/// What a map server shows of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GridCell {
    /// Unknown, -1.
    Unknown,
    /// Free, 0.
    Free,
    /// Occupied with a probability, 1 to 99.
    Between {
        /// The probability.
        percent: u8,
    },
    /// Occupied, 100.
    Occupied,
}

impl GridCell {
    /// Whether it is occupied; none where the grid does not decide.
    pub fn occupied(self) -> Option<bool> {
        match self {
            Self::Unknown | Self::Between { .. } => None,
            Self::Free => Some(false),
            Self::Occupied => Some(true),
        }
    }

    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within 1 and 99 by the guards")]
    fn from_percent(percent: f64) -> Self {
        match percent {
            _ if percent <= 0.0 => Self::Free,
            _ if percent >= 100.0 => Self::Occupied,
            _ => Self::Between { percent: percent as u8 },
        }
    }
}

/// Reads the image of a grid whose YAML file has been read.
pub fn read(settings: &GridSettings, image: &[u8]) -> Result<Grid, FormatError> {
    let image = pgm::read(image)?;
    let meanings: Vec<GridCell> = (0..=image.most).map(|value| meaning(settings, value, image.most)).collect();
    let width = image.width as usize;
    let rows = image.values.chunks_exact(width).rev();
    // No value is above the image's most.
    let cells = rows.flatten().map(|&value| meanings[usize::from(value)]).collect();
    Ok(Grid {
        resolution_m: settings.resolution_m,
        origin_m: settings.origin_m,
        size_cells: [image.width, image.height],
        cells,
    })
}

/// What a pixel says.
fn meaning(settings: &GridSettings, value: u16, most: u16) -> GridCell {
    let shade = f64::from(value) / f64::from(most);
    let occupied = if settings.negate { shade } else { 1.0 - shade };
    let (least, enough) = (settings.free_thresh, settings.occupied_thresh);
    match settings.mode {
        GridMode::Raw => match (shade * 255.0).round() {
            percent if percent <= 100.0 => GridCell::from_percent(percent),
            _ => GridCell::Unknown,
        },
        _ if enough < occupied => GridCell::Occupied,
        _ if occupied < least => GridCell::Free,
        GridMode::Trinary => GridCell::Unknown,
        GridMode::Scale => GridCell::from_percent(((occupied - least) / (enough - least) * 100.0).round_ties_even()),
    }
}
