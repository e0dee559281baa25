//! Why a scan of tiles is invalid.
//!
//! Invariant: a message names the field, the value and the limit.

use tidemap_grid::index::TileIndex;

use super::MASK_BYTES;

/// Why a scan of tiles is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the error texts name the fields")]
pub enum TileError {
    #[error("new_tiles: {0} entries are not x, y, z of each tile")]
    Coordinates(usize),
    #[error("tile {}, {}, {} appears twice", .0.x, .0.y, .0.z)]
    Twice(TileIndex),
    #[error("slot {slot} is beyond the stream's {tiles} tiles")]
    Slot { slot: u64, tiles: usize },
    #[error("seen: {length} slots from slot {first} are beyond the stream's {tiles} tiles")]
    RunBeyond { first: u64, length: u32, tiles: usize },
    #[error("seen: {0} entries are not pairs of a gap and a length")]
    Runs(usize),
    #[error("seen: a run of 0 slots")]
    EmptyRun,
    #[error("a scan of tiles shows no tile: it must show at least 1")]
    NoTile,
    #[error("seen is empty, but there is no scan of tiles before this one")]
    NothingBefore,
    #[error("{what}: {found} bytes for {tiles} tiles: it must be {MASK_BYTES} each")]
    Masks { what: &'static str, found: usize, tiles: usize },
    #[error("the parts of a scan are not of one kind")]
    Parts,
    #[error("a cell of tile {}, {}, {} is occupied, but not observed", .0.x, .0.y, .0.z)]
    OccupiedUnobserved(TileIndex),
}
