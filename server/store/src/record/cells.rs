//! Sets and lists of the cells of a tile.
//!
//! Invariant: a cell that is read lies within the tile, and lists ascend.

use tidemap_grid::{
    index::TILE_CELLS,
    mask::{Mask, TileMasks},
};

use super::{
    Invalid,
    varint::{push_varint, take_varint},
};

/// Bytes of a set that is not empty.
pub(super) const MASK_LENGTH: usize = TILE_CELLS / 8;

const CELL: Invalid = "a cell is outside its tile";

/// A set of cells; no bytes for an empty set.
pub(super) fn encode_mask(mask: Mask) -> Vec<u8> {
    if mask.is_empty() { Vec::new() } else { mask.to_bytes().to_vec() }
}

pub(super) fn decode_mask(bytes: &[u8]) -> Result<Mask, Invalid> {
    match <&[u8; MASK_LENGTH]>::try_from(bytes) {
        Ok(bytes) => Ok(Mask::from_bytes(bytes)),
        Err(_) if bytes.is_empty() => Ok(Mask::EMPTY),
        Err(_) => Err("a set of cells does not have its length"),
    }
}

pub(super) fn decode_masks(observed: &[u8], occupied: &[u8]) -> Result<TileMasks, Invalid> {
    masks(decode_mask(observed)?, decode_mask(occupied)?)
}

pub(super) fn masks(observed: Mask, occupied: Mask) -> Result<TileMasks, Invalid> {
    TileMasks::new(observed, occupied).ok_or("a cell is occupied but not observed")
}

/// Writes an ascending list of cells.
#[derive(Default)]
pub(super) struct CellsOut {
    pub(super) bytes: Vec<u8>,
    next: u64,
}

impl CellsOut {
    /// Appends a cell, as the number of cells between it and the cell before.
    pub(super) fn push(&mut self, cell: u16) -> Result<(), Invalid> {
        let cell = u64::from(cell);
        let gap = cell.checked_sub(self.next).filter(|_| cell < TILE_CELLS as u64);
        push_varint(&mut self.bytes, gap.ok_or("the cells of a list do not ascend")?);
        self.next = cell + 1;
        Ok(())
    }
}

/// Reads an ascending list of cells.
pub(super) struct CellsIn<'list> {
    pub(super) bytes: &'list [u8],
    next: u64,
}

impl CellsIn<'_> {
    pub(super) fn new(bytes: &[u8]) -> CellsIn<'_> {
        CellsIn { bytes, next: 0 }
    }

    /// The next cell; `None` after the last.
    pub(super) fn take(&mut self) -> Result<Option<u16>, Invalid> {
        if self.bytes.is_empty() {
            return Ok(None);
        }
        let cell = self.next.saturating_add(take_varint(&mut self.bytes)?);
        let place = u16::try_from(cell).ok().filter(|&cell| usize::from(cell) < TILE_CELLS).ok_or(CELL)?;
        self.next = cell + 1;
        Ok(Some(place))
    }
}

/// Checks the number of a single cell.
pub(super) fn place(cell: u32) -> Result<u16, Invalid> {
    u16::try_from(cell).ok().filter(|&cell| usize::from(cell) < TILE_CELLS).ok_or(CELL)
}
