//! Occupancy grids, `nav_msgs/OccupancyGrid`, and their changes, `map_msgs/OccupancyGridUpdate`.
//!
//! Invariant: a grid has as many cells as its width times its height.

use nalgebra::Isometry3;

use super::{Fields, KnownError};
use crate::message::{Numbers, Value};

/// Maximum number of cells of a grid.
const CELLS_MAX: usize = 16 << 20;

/// An occupancy grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid<'a> {
    /// Edge of a cell, metres.
    pub resolution_m: f64,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Pose of the lower left corner of the first cell in the frame of the grid.
    pub origin: Isometry3<f64>,
    cells: Numbers<'a>,
}

impl<'a> Grid<'a> {
    /// Reads a message.
    ///
    /// # Errors
    /// A field is missing, the resolution is not above 0, or the number of cells is not width times height.
    pub fn read(message: &Value<'a>) -> Result<Self, KnownError> {
        let fields = Fields { type_name: "nav_msgs/OccupancyGrid", message };
        let (width, height) = (fields.size(&["info", "width"])?, fields.size(&["info", "height"])?);
        let cells = fields.numbers(&["data"])?;
        // The resolution is stored with 4 bytes: 0.05 is not 0.05000000074505806.
        let resolution_m = shortest(fields.number(&["info", "resolution"])?);
        if !resolution_m.is_finite() || resolution_m <= 0.0 {
            let text = format!("a grid with cells of {resolution_m} m: the resolution must be above 0");
            return Err(KnownError::Values(text));
        }
        checked(width, height, cells)?;
        let origin = fields.pose(&["info", "origin"], "position", "orientation")?;
        Ok(Self { resolution_m, width, height, origin, cells })
    }

    /// Occupancy of the cells in percent, row by row from the bottom; -1: unknown.
    pub fn percents(&self) -> impl Iterator<Item = i8> + 'a {
        percents(self.cells)
    }
}

/// Changes of a part of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct GridUpdate<'a> {
    /// Column of the first cell within the grid.
    pub x: usize,
    /// Row of the first cell within the grid.
    pub y: usize,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    cells: Numbers<'a>,
}

impl<'a> GridUpdate<'a> {
    /// Reads a message.
    ///
    /// # Errors
    /// A field is missing, or the number of cells is not width times height.
    pub fn read(message: &Value<'a>) -> Result<Self, KnownError> {
        let fields = Fields { type_name: "map_msgs/OccupancyGridUpdate", message };
        let (width, height) = (fields.size(&["width"])?, fields.size(&["height"])?);
        let cells = fields.numbers(&["data"])?;
        checked(width, height, cells)?;
        Ok(Self { x: fields.size(&["x"])?, y: fields.size(&["y"])?, width, height, cells })
    }

    /// Occupancy of the cells in percent, row by row from the bottom; -1: unknown.
    pub fn percents(&self) -> impl Iterator<Item = i8> + 'a {
        percents(self.cells)
    }
}

fn percents(cells: Numbers<'_>) -> impl Iterator<Item = i8> + '_ {
    cells.bytes.iter().map(|byte| byte.cast_signed())
}

fn checked(width: usize, height: usize, cells: Numbers<'_>) -> Result<(), KnownError> {
    let count = width.checked_mul(height);
    if cells.primitive.bytes() != Some(1) || count != Some(cells.len()) {
        let text = format!("a grid of {width} x {height} cells with {} values", cells.len());
        return Err(KnownError::Values(text));
    }
    if cells.len() > CELLS_MAX {
        let text = format!("a grid of {width} x {height} cells; at most {CELLS_MAX} are read");
        return Err(KnownError::Values(text));
    }
    Ok(())
}

/// The shortest decimal number that is stored as the same 4 bytes.
fn shortest(value: f64) -> f64 {
    let stored = value as f32;
    format!("{stored}").parse().unwrap_or(value)
}
