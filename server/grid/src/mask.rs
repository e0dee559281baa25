//! A set of cells of one tile, as 512 bits.
//!
//! Invariant: bit `cell & 63` of word `cell >> 6` is cell x + 8·y + 64·z, so that word z is the layer z.
//!
//! Other crates call these functions for each cell or scan, and a release is built without optimisation across crates:
//! therefore they are `#[inline]`.

use std::ops::{BitAnd, BitOr, BitOrAssign, BitXor, Not};

use crate::index::TILE_CELLS;

/// The cells of a layer with x = 0, and those with x = 7.
const FIRST_COLUMN: u64 = 0x0101_0101_0101_0101;
const LAST_COLUMN: u64 = FIRST_COLUMN << 7;

/// A set of cells of one tile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Mask(pub [u64; 8]);

impl Mask {
    /// No cell.
    pub const EMPTY: Mask = Mask([0; 8]);
    /// Every cell.
    pub const FULL: Mask = Mask([u64::MAX; 8]);

    /// The set of one cell; a cell number beyond the tile is ignored.
    #[inline]
    pub fn of(cell: u16) -> Mask {
        let mut mask = Mask::EMPTY;
        mask.insert(cell);
        mask
    }

    /// Whether the cell is in the set; false for a cell number beyond the tile.
    #[inline]
    pub fn contains(&self, cell: u16) -> bool {
        self.0.get(usize::from(cell >> 6)).is_some_and(|word| word >> (cell & 63) & 1 == 1)
    }

    /// Adds a cell; a cell number beyond the tile is ignored.
    #[inline]
    pub fn insert(&mut self, cell: u16) {
        if let Some(word) = self.0.get_mut(usize::from(cell >> 6)) {
            *word |= 1 << (cell & 63);
        }
    }

    /// Adds a cell that is not in the set and removes a cell that is; a cell number beyond the tile is ignored.
    #[inline]
    pub fn flip(&mut self, cell: u16) {
        if let Some(word) = self.0.get_mut(usize::from(cell >> 6)) {
            *word ^= 1 << (cell & 63);
        }
    }

    /// Number of cells.
    #[inline]
    pub fn count(&self) -> u32 {
        self.0.iter().map(|word| word.count_ones()).sum()
    }

    /// Whether the set is empty.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.0.iter().fold(0, |all, word| all | word) == 0
    }

    /// The set with the cells of an iterator flipped.
    pub fn flipped(mut self, cells: impl Iterator<Item = u16>) -> Mask {
        for cell in cells {
            self.flip(cell);
        }
        self
    }

    /// The lowest cell.
    #[inline]
    pub fn first(&self) -> Option<u16> {
        let (word, z) = self.0.iter().zip(0u16..).find(|(word, _)| **word != 0)?;
        Some(z * 64 + u16::try_from(word.trailing_zeros()).unwrap_or(0))
    }

    /// The cells of this set that are not in the other.
    #[inline]
    pub fn without(self, other: Mask) -> Mask {
        self & !other
    }

    /// The cells, ascending.
    #[inline]
    pub fn cells(self) -> impl Iterator<Item = u16> {
        let mut words = self.0.into_iter().zip((0u16..).step_by(64));
        let (mut rest, mut base) = (0, 0);
        std::iter::from_fn(move || {
            while rest == 0 {
                (rest, base) = words.next()?;
            }
            let cell = base + (rest.trailing_zeros() & 63) as u16;
            rest &= rest - 1;
            Some(cell)
        })
    }

    /// The cells of the tile whose neighbour, up or down along axis 0, 1 or 2, is in the set; `beyond` is the set in
    /// the neighbouring tile on that side.
    pub(crate) fn beside(self, axis: usize, is_up: bool, beyond: Mask) -> Mask {
        let layers = |layer: fn(u64, u64) -> u64| Mask(std::array::from_fn(|z| layer(self.0[z], beyond.0[z])));
        match (axis, is_up) {
            (0, true) => layers(|own, beyond| (own & !FIRST_COLUMN) >> 1 | (beyond & FIRST_COLUMN) << 7),
            (0, false) => layers(|own, beyond| (own & !LAST_COLUMN) << 1 | (beyond & LAST_COLUMN) >> 7),
            (1, true) => layers(|own, beyond| own >> 8 | beyond << 56),
            (1, false) => layers(|own, beyond| own << 8 | beyond >> 56),
            (_, true) => Mask(std::array::from_fn(|z| self.0.get(z + 1).copied().unwrap_or(beyond.0[0]))),
            (_, false) => Mask(std::array::from_fn(|z| if z == 0 { beyond.0[7] } else { self.0[z - 1] })),
        }
    }

    /// The set from 64 bytes, with the first cell in the lowest bit of the first byte.
    pub fn from_bytes(bytes: &[u8; TILE_CELLS / 8]) -> Mask {
        let mut mask = Mask::EMPTY;
        for (word, eight) in mask.0.iter_mut().zip(bytes.as_chunks::<8>().0) {
            *word = u64::from_le_bytes(*eight);
        }
        mask
    }

    /// The set as 64 bytes.
    pub fn to_bytes(self) -> [u8; TILE_CELLS / 8] {
        let mut bytes = [0; TILE_CELLS / 8];
        for (eight, word) in bytes.as_chunks_mut::<8>().0.iter_mut().zip(self.0) {
            *eight = word.to_le_bytes();
        }
        bytes
    }
}

macro_rules! bitwise {
    ($operator:ident, $method:ident) => {
        impl $operator for Mask {
            type Output = Mask;
            #[inline]
            fn $method(mut self, other: Mask) -> Mask {
                for (word, other) in self.0.iter_mut().zip(other.0) {
                    *word = word.$method(other);
                }
                self
            }
        }
    };
}

bitwise!(BitAnd, bitand);
bitwise!(BitOr, bitor);
bitwise!(BitXor, bitxor);

impl BitOrAssign for Mask {
    #[inline]
    fn bitor_assign(&mut self, other: Mask) {
        *self = *self | other;
    }
}

impl Not for Mask {
    type Output = Mask;
    #[inline]
    fn not(self) -> Mask {
        Mask(self.0.map(|word| !word))
    }
}

/// The masks of one tile in a scan. An occupied cell is observed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct TileMasks {
    observed: Mask,
    occupied: Mask,
}

impl TileMasks {
    /// The masks; `None` where a cell is occupied but not observed.
    #[inline]
    pub fn new(observed: Mask, occupied: Mask) -> Option<TileMasks> {
        occupied.without(observed).is_empty().then_some(TileMasks { observed, occupied })
    }

    /// The masks; cells that are not observed are removed from the occupied cells.
    #[inline]
    pub fn clipped(observed: Mask, occupied: Mask) -> TileMasks {
        TileMasks { observed, occupied: occupied & observed }
    }

    /// Cells that were observed.
    #[inline]
    pub fn observed(&self) -> Mask {
        self.observed
    }

    /// Cells that were observed as occupied.
    #[inline]
    pub fn occupied(&self) -> Mask {
        self.occupied
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_lie_beside_their_neighbours_within_a_tile_and_across() {
        use crate::index::TileIndex;
        for (axis, is_up) in (0..3).flat_map(|axis| [(axis, false), (axis, true)]) {
            for cell in (0..512).step_by(7).chain([0, 511]) {
                // The neighbour of `place` on this side is `cell`, here or in the next tile.
                let (here, next) = (TileIndex::default(), TileIndex::default().neighbour(axis, is_up));
                for (tile, own, beyond) in [(here, Mask::of(cell), Mask::EMPTY), (next, Mask::EMPTY, Mask::of(cell))] {
                    let mut at = <[i32; 3]>::from(tile.cell(cell));
                    at[axis] -= if is_up { 1 } else { -1 };
                    let (tile, place) = crate::index::CellIndex::from(at).tile();
                    let expected = if tile == here { Mask::of(place) } else { Mask::EMPTY };
                    assert_eq!(own.beside(axis, is_up, beyond), expected, "{axis} {is_up} {cell}");
                }
            }
        }
    }

    #[test]
    fn a_mask_lists_what_was_put_in() {
        let mut mask = Mask::EMPTY;
        for cell in [0, 63, 64, 200, 511] {
            mask.insert(cell);
        }
        mask.insert(512);
        mask.flip(200);
        assert_eq!(mask.cells().collect::<Vec<_>>(), [0, 63, 64, 511]);
        assert_eq!((mask.count(), mask.contains(64), mask.contains(65)), (4, true, false));
        assert_eq!(Mask::from_bytes(&mask.to_bytes()), mask);
        assert_eq!(mask.to_bytes()[8], 1);
        assert_eq!((!mask).count(), 508);
        assert_eq!(Mask::FULL.cells().count(), 512);
        assert_eq!(Mask::FULL.without(mask) | mask, Mask::FULL);
    }

    #[test]
    fn occupied_cells_are_observed() {
        let mut one = Mask::EMPTY;
        one.insert(5);
        assert!(TileMasks::new(Mask::EMPTY, one).is_none());
        assert!(TileMasks::new(one, one).is_some());
        assert!(TileMasks::clipped(Mask::EMPTY, Mask::FULL).occupied().is_empty());
    }
}
