//! Scans in the form that the log holds: differences from the masks that their tiles had before.
//!
//! Invariant: cells are numbered tile·512 + place. A flip means that a tile's bit differs from the last scan *in log
//! order* that saw the tile, whichever producer made that scan; a tile never seen before has no bit set.

use std::sync::Arc;

use crate::index::{CellBox, TILE_CELLS, TileId, TileIndex};

/// A cell of a map, as one number: the tile and the place in the tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct CellRef(pub u32);

impl CellRef {
    /// Maximum number of tiles that can be numbered.
    pub const TILES_MAX: u32 = u32::MAX / TILE_CELLS as u32;

    /// The cell at place `cell` of a tile.
    #[inline]
    pub fn new(tile: TileId, cell: u16) -> CellRef {
        CellRef(tile.0.wrapping_mul(TILE_CELLS as u32) + u32::from(cell))
    }

    /// The tile that holds the cell.
    #[inline]
    pub fn tile(self) -> TileId {
        TileId(self.0 / TILE_CELLS as u32)
    }

    /// The place of the cell in the tile.
    #[inline]
    pub fn cell(self) -> u16 {
        (self.0 % TILE_CELLS as u32) as u16
    }
}

/// The source of a scan's readings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum ScanSource {
    /// The scan states its cells as free or occupied.
    #[default]
    Cells,
    /// Rays of a range sensor; a ray that passes an occupied cell in part reads it as free.
    Rays {
        /// The height of the sensor in a flat grid, in units of [`HEIGHT_BAND_M`], rounded; 0 in other grids.
        height: i8,
    },
}

/// Width of a band of heights, metres. Sensors of one band contradict each other in a flat grid; others do not, because
/// they see other things.
pub const HEIGHT_BAND_M: f64 = 0.25;

/// One scan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoggedScan {
    /// When it was made, nanoseconds UTC, at least 0.
    pub utc_nanos: i64,
    /// Seconds to add to UTC for local civil time.
    pub offset_secs: i32,
    /// The source of its readings.
    pub source: ScanSource,
    /// The tiles that were seen, ascending, without duplicates; `None`: equal to the tiles of the previous scan in the
    /// log.
    pub seen: Option<Arc<[TileId]>>,
    /// Cells of seen tiles whose observed bit differs from the last scan of their tile; ascending.
    pub observed_flips: Vec<CellRef>,
    /// Cells of seen tiles whose occupied bit differs; ascending. A cell that is not observed has no occupied bit.
    pub occupied_flips: Vec<CellRef>,
}

/// Scans that became durable together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scans {
    /// Tiles that appear for the first time; their ids continue those of the map.
    pub new_tiles: Vec<TileIndex>,
    /// The accepted scans.
    pub scans: Vec<LoggedScan>,
    /// The cells that the scans show, known and unknown; empty if the scans do not state them.
    pub shown: CellBox,
}
