//! Grids of the ROS map servers: a YAML file with the settings, and an image, PGM or PNG.
//!
//! Pixels are read as the map servers of ROS read them, in all three modes. Let `shade` be the pixel from 0 black to 1
//! white, and `occ` be `1 - shade`, or `shade` if `negate` is set:
//!
//! - `trinary`: occupied above `occupied_thresh`, free below `free_thresh`, unknown between them;
//! - `scale`: as `trinary`, but with a probability between the thresholds. Unknown cells are transparent pixels, which
//!   PGM files do not have, and PNG files may have;
//! - `raw`: `shade * 255` is the probability in percent from 0 to 100, and higher values are unknown.
//!
//! The writer uses `trinary`, the mode that every tool understands, and for probabilities `raw`, the only mode in which
//! a PGM file can have both probabilities and unknown cells. It writes `scale` for grids without unknown cells.
//!
//! Map savers write 205 for unknown, also with a `free_thresh` of 0.25. The map servers then read such a pixel as free,
//! and so does this reader, which counts them, unless [`GridSettings::is_205_unknown`] is set.
//!
//! In trinary files a cell is free up to 25 % and occupied from 65 %, and the pixels are 254, 0, and 205 for unknown,
//! as map savers write them; but `free_thresh` is 0.196 instead of 0.25, because `occ` of the pixel 205 is 0.1961,
//! which would be read back as free.
//!
//! Invariant: rows of a [`Grid`] go upwards, rows of the image downwards; a grid has one cell for each pixel.

mod compare;
mod ever_occupied;
mod image;
mod mask;
mod pgm;
mod settings;
#[cfg(test)]
mod tests;
mod write;

use super::error::{FilePlace, FormatError};

pub use compare::{Agreement, NotComparable, SideCounts, compare};
pub use ever_occupied::{EverOccupied, in_keepout, in_map};
pub use mask::{keepout, speed};
pub use settings::{GridMode, GridSettings, read_settings};
pub use write::{Thresholds, write};

/// A flat grid of cells.
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
    /// The number of cells that are free although their pixel is 205, which map savers write for unknown.
    pub free_205: u64,
}

/// The value of a cell in a map server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GridCell {
    /// Unknown, -1.
    Unknown,
    /// Free, 0.
    Free,
    /// Occupied with a probability, 1 to 99.
    #[allow(missing_docs, reason = "see the variant")]
    Between { percent: u8 },
    /// Occupied, 100.
    Occupied,
}

impl GridCell {
    /// Whether the cell is occupied; none if it is unknown or between the thresholds.
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

/// Reads the image of a grid with the settings of its YAML file.
pub fn read(settings: &GridSettings, image: &[u8]) -> Result<Grid, FormatError> {
    let image = image::read(image, settings.mode)?;
    let cells_by_value: Vec<GridCell> = (0..=image.max).map(|value| cell(settings, value, image.max)).collect();
    let width = image.width as usize;
    let rows = image.values.chunks_exact(width).rev();
    // No value is above the image's maximum.
    let mut cells: Vec<GridCell> = rows.flatten().map(|&value| cells_by_value[usize::from(value)]).collect();
    if settings.mode == GridMode::Scale && !image.transparent.is_empty() {
        let transparent = image.transparent.chunks_exact(width).rev().flatten();
        cells.iter_mut().zip(transparent).filter(|(_, is)| **is).for_each(|(cell, _)| *cell = GridCell::Unknown);
    }
    let is_free_205 = settings.mode == GridMode::Trinary
        && image.max == 255
        && cells_by_value.get(usize::from(SAVED_UNKNOWN)) == Some(&GridCell::Free);
    let free_205 =
        if is_free_205 { image.values.iter().filter(|&&value| value == SAVED_UNKNOWN).count() as u64 } else { 0 };
    Ok(Grid {
        resolution_m: settings.resolution_m,
        origin_m: settings.origin_m,
        size_cells: [image.width, image.height],
        cells,
        free_205,
    })
}

/// The pixel that map savers write for an unknown cell.
const SAVED_UNKNOWN: u16 = 205;

/// The cell of a pixel.
fn cell(settings: &GridSettings, value: u16, max: u16) -> GridCell {
    let shade = f64::from(value) / f64::from(max);
    let occupied = if settings.negate { shade } else { 1.0 - shade };
    let (free, enough) = (settings.free_thresh, settings.occupied_thresh);
    match settings.mode {
        GridMode::Raw => match (shade * 255.0).round() {
            percent if percent <= 100.0 => GridCell::from_percent(percent),
            _ => GridCell::Unknown,
        },
        GridMode::Trinary if settings.is_205_unknown && value == SAVED_UNKNOWN && max == 255 => GridCell::Unknown,
        _ if enough < occupied => GridCell::Occupied,
        _ if occupied < free => GridCell::Free,
        GridMode::Trinary => GridCell::Unknown,
        GridMode::Scale => GridCell::from_percent(((occupied - free) / (enough - free) * 100.0).round_ties_even()),
    }
}
