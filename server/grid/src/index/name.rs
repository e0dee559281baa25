//! Names of cells, as people write them: `cell/X/Y/Z`, the index along each axis.
//!
//! Invariant: there is one name for each cell, and reading a name gives the cell that it was written from.

use super::{CellIndex, TILE_EDGE, TILE_LIMIT};

/// Minimum index of a cell along an axis.
const CELL_MIN: i32 = -TILE_LIMIT * TILE_EDGE;
/// Maximum index of a cell along an axis.
const CELL_MAX: i32 = TILE_LIMIT * TILE_EDGE - 1;
/// Maximum number of characters of an invalid name that are shown.
const SHOWN_CHARS_MAX: usize = 40;

/// A name that starts like a cell's name and is invalid. The payload is the name, shortened and escaped for display.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not the name of a cell: write cell/X/Y/Z, its index along each axis, from {CELL_MIN} to {CELL_MAX}")]
pub struct InvalidCellName(String);

impl CellIndex {
    /// The cell of a name `cell/X/Y/Z`; `None` for a name that does not begin with `cell/`.
    ///
    /// # Errors
    /// [`InvalidCellName`] where the rest of the name is not three indices as [`CellIndex::name`] writes them.
    pub fn from_name(name: &str) -> Option<Result<CellIndex, InvalidCellName>> {
        let parts = name.strip_prefix("cell/")?;
        let mut indices = parts.splitn(4, '/').map(|part| {
            let index = part.parse::<i32>().ok()?;
            // A cell has one name only: +1, 01 and -0 are refused.
            let is_plain = part.len() == index.to_string().len() && !part.starts_with('+');
            Some(index).filter(|index| is_plain && (CELL_MIN..=CELL_MAX).contains(index))
        });
        let mut next = || indices.next().flatten();
        let cell = next().zip(next()).zip(next()).map(|((x, y), z)| CellIndex { x, y, z });
        let invalid = || InvalidCellName(name.chars().take(SHOWN_CHARS_MAX).collect());
        Some(cell.filter(|_| indices.next().is_none()).ok_or_else(invalid))
    }

    /// The cell's name, `cell/X/Y/Z`.
    pub fn name(self) -> String {
        format!("cell/{}/{}/{}", self.x, self.y, self.z)
    }
}

#[cfg(test)]
mod tests;
