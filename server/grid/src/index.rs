//! The positions of cells and tiles: integer indices in the map's frame.
//!
//! Invariant: a tile index lies within ±[`TILE_LIMIT`], so that cell indices and metres never overflow.

mod name;

pub use name::InvalidCellName;

/// Cells along one edge of a tile.
pub const TILE_EDGE: i32 = 8;
/// Cells of a tile.
pub const TILE_CELLS: usize = 512;
/// Tile indices lie in `-TILE_LIMIT..TILE_LIMIT` along each axis.
pub const TILE_LIMIT: i32 = 1 << 20;

/// Index of a tile within its map: dense from 0, in order of first appearance, never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TileId(pub u32);

/// The position of a tile, in tiles from the grid's origin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TileIndex {
    /// Index along x.
    pub x: i32,
    /// Index along y.
    pub y: i32,
    /// Index along z; 0 in a grid of two dimensions.
    pub z: i32,
}

impl TileIndex {
    /// Whether the index lies within the limits.
    pub fn is_valid(self) -> bool {
        [self.x, self.y, self.z].iter().all(|index| (-TILE_LIMIT..TILE_LIMIT).contains(index))
    }

    /// The tile beside this one, up or down along axis 0, 1 or 2.
    pub(crate) fn neighbour(mut self, axis: usize, is_up: bool) -> TileIndex {
        let along = match axis {
            0 => &mut self.x,
            1 => &mut self.y,
            _ => &mut self.z,
        };
        *along = along.saturating_add(if is_up { 1 } else { -1 });
        self
    }

    /// The cell at place `cell` (below [`TILE_CELLS`]) of this tile.
    #[inline]
    pub fn cell(self, cell: u16) -> CellIndex {
        let cell = i32::from(cell);
        CellIndex {
            x: self.x * TILE_EDGE + (cell & 7),
            y: self.y * TILE_EDGE + (cell >> 3 & 7),
            z: self.z * TILE_EDGE + (cell >> 6 & 7),
        }
    }

    /// The cells of the tile.
    pub fn cells(self) -> CellBox {
        let min = self.cell(0);
        CellBox { min, max: CellIndex { x: min.x + TILE_EDGE, y: min.y + TILE_EDGE, z: min.z + TILE_EDGE } }
    }
}

/// The position of a cell, in cells from the grid's origin: the cell spans origin + index·resolution to origin +
/// (index+1)·resolution.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct CellIndex {
    /// Index along x.
    pub x: i32,
    /// Index along y.
    pub y: i32,
    /// Index along z; 0 in a grid of two dimensions.
    pub z: i32,
}

impl CellIndex {
    /// The tile that holds the cell, and the cell's place in it: x + 8·y + 64·z of the last three bits of each index.
    #[inline]
    pub fn tile(self) -> (TileIndex, u16) {
        let tile = TileIndex { x: self.x >> 3, y: self.y >> 3, z: self.z >> 3 };
        let place = (self.x & 7) | (self.y & 7) << 3 | (self.z & 7) << 6;
        (tile, u16::try_from(place).unwrap_or(0))
    }
}

impl From<[i32; 3]> for CellIndex {
    fn from([x, y, z]: [i32; 3]) -> CellIndex {
        CellIndex { x, y, z }
    }
}

impl From<CellIndex> for [i32; 3] {
    fn from(CellIndex { x, y, z }: CellIndex) -> [i32; 3] {
        [x, y, z]
    }
}

/// Cells from `min` up to but not including `max`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct CellBox {
    /// Lowest cell.
    pub min: CellIndex,
    /// One beyond the highest cell along each axis.
    pub max: CellIndex,
}

impl CellBox {
    /// Number of cells along x, y, z; 0 if the box is empty.
    pub fn size(&self) -> [u64; 3] {
        let along = |min: i32, max: i32| u64::try_from(i64::from(max) - i64::from(min)).unwrap_or(0);
        [along(self.min.x, self.max.x), along(self.min.y, self.max.y), along(self.min.z, self.max.z)]
    }

    /// Number of cells.
    pub fn count(&self) -> u128 {
        self.size().iter().map(|&size| u128::from(size)).product()
    }

    /// Whether the box contains the cell.
    pub fn contains(&self, cell: CellIndex) -> bool {
        (self.min.x..self.max.x).contains(&cell.x)
            && (self.min.y..self.max.y).contains(&cell.y)
            && (self.min.z..self.max.z).contains(&cell.z)
    }

    /// The cells that lie in both boxes.
    pub fn intersection(&self, other: &CellBox) -> CellBox {
        CellBox {
            min: CellIndex {
                x: self.min.x.max(other.min.x),
                y: self.min.y.max(other.min.y),
                z: self.min.z.max(other.min.z),
            },
            max: CellIndex {
                x: self.max.x.min(other.max.x),
                y: self.max.y.min(other.max.y),
                z: self.max.z.min(other.max.z),
            },
        }
    }

    /// The smallest box that holds both boxes; an empty box adds nothing.
    pub fn union(&self, other: &CellBox) -> CellBox {
        if self.is_empty() {
            return *other;
        }
        if other.is_empty() {
            return *self;
        }
        CellBox {
            min: CellIndex {
                x: self.min.x.min(other.min.x),
                y: self.min.y.min(other.min.y),
                z: self.min.z.min(other.min.z),
            },
            max: CellIndex {
                x: self.max.x.max(other.max.x),
                y: self.max.y.max(other.max.y),
                z: self.max.z.max(other.max.z),
            },
        }
    }

    /// Whether the box contains no cell.
    pub fn is_empty(&self) -> bool {
        self.size().contains(&0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_and_tiles_lead_to_each_other() {
        for cell in [(0, 0, 0), (7, 8, -1), (-8, -9, 15), (-1, 63, 64)] {
            let cell = CellIndex { x: cell.0, y: cell.1, z: cell.2 };
            let (tile, place) = cell.tile();
            assert_eq!(tile.cell(place), cell);
            assert!(tile.cells().contains(cell));
        }
        assert_eq!(CellIndex { x: -1, y: 0, z: 0 }.tile().0, TileIndex { x: -1, y: 0, z: 0 });
    }

    #[test]
    fn boxes_know_their_size() {
        let cells = CellBox { min: [-8, 0, 3].into(), max: [8, 5, 4].into() };
        assert_eq!((cells.size(), cells.count()), ([16, 5, 1], 80));
        assert_eq!(CellBox { min: [3, 0, 0].into(), max: [1, 9, 9].into() }.count(), 0);
        let all = CellBox { min: [i32::MIN; 3].into(), max: [i32::MAX; 3].into() };
        assert_eq!(all.size(), [u64::from(u32::MAX); 3]);
        let tile = TileIndex { x: 1, y: 0, z: -1 }.cells();
        assert_eq!((tile.size(), tile.count()), ([8, 8, 8], 512));
        let apart = tile.intersection(&TileIndex { x: 3, y: 0, z: -1 }.cells());
        assert!(apart.is_empty());
        assert_eq!(tile.union(&TileIndex { x: 2, y: 0, z: -1 }.cells()).size(), [16, 8, 8]);
        assert_eq!(apart.union(&tile), tile);
    }
}
