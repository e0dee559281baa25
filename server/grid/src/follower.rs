//! Follows the readings of some cells from scan to scan.
//!
//! A scan is logged as the bits of its tiles that differ from the scan before. A follower begins with the current masks
//! of the tiles of its cells, and passes each scan once, in log order. Invariant: its readings are the readings that
//! the map learns, if no scan is left out since the view that it began with.

use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
};

use crate::{
    index::{CellIndex, TileId, TileIndex},
    mask::Mask,
    scan::{CellRef, LoggedScan, Scans},
    view::GridView,
};

/// Follows the readings of some cells.
#[derive(Clone, Debug)]
pub struct CellFollower {
    tiles: BTreeMap<TileId, FollowedTile>,
    /// Tiles that no scan has seen yet, with the followed cells of each.
    awaited: HashMap<TileIndex, Mask>,
    /// Number of tiles of the map.
    known_tiles: u32,
    /// The tiles that the last scan saw.
    seen: Arc<[TileId]>,
}

#[derive(Clone, Copy, Debug)]
struct FollowedTile {
    index: TileIndex,
    cells: Mask,
    /// The observed mask of the last scan of the tile in log order.
    observed: Mask,
    occupied: Mask,
}

/// A reading of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct CellReading {
    /// The tile that holds the cell.
    pub tile: TileId,
    /// The index of the tile.
    pub index: TileIndex,
    /// The place of the cell in the tile.
    pub cell: u16,
    /// Whether the cell was read as occupied.
    pub is_occupied: bool,
}

impl CellFollower {
    /// Follows these cells from the newest scan of a view on. Cells that were never observed may be among them.
    pub fn new(grid: &GridView, cells: impl IntoIterator<Item = CellIndex>) -> CellFollower {
        let mut by_tile: HashMap<TileIndex, Mask> = HashMap::new();
        for (index, place) in cells.into_iter().map(CellIndex::tile) {
            by_tile.entry(index).or_default().insert(place);
        }
        let known_tiles = u32::try_from(grid.tiles()).unwrap_or(u32::MAX);
        let seen = Arc::clone(&grid.last_seen);
        let mut follower = CellFollower { tiles: BTreeMap::new(), awaited: HashMap::new(), known_tiles, seen };
        for (index, cells) in by_tile {
            match grid.find(index) {
                Some(id) => {
                    let shown = grid.live(id).map(|tile| tile.arrival).unwrap_or_default();
                    let (observed, occupied) = (shown.observed(), shown.occupied());
                    follower.tiles.insert(id, FollowedTile { index, cells, observed, occupied });
                }
                None => _ = follower.awaited.insert(index, cells),
            }
        }
        follower
    }

    /// Passes the scans of an event; `read` receives the number of each scan in the event and the readings of the
    /// followed cells.
    pub fn pass(&mut self, event: &Scans, mut read: impl FnMut(usize, CellReading)) {
        for &index in &event.new_tiles {
            if let Some(cells) = self.awaited.remove(&index) {
                let tile = FollowedTile { index, cells, observed: Mask::EMPTY, occupied: Mask::EMPTY };
                self.tiles.insert(TileId(self.known_tiles), tile);
            }
            self.known_tiles = self.known_tiles.saturating_add(1);
        }
        for (number, scan) in event.scans.iter().enumerate() {
            if let Some(seen) = &scan.seen {
                self.seen = Arc::clone(seen);
            }
            for (&id, tile) in &mut self.tiles {
                tile.flip(id, scan);
                if self.seen.binary_search(&id).is_err() {
                    continue;
                }
                let index = tile.index;
                for cell in (tile.cells & tile.observed).cells() {
                    let is_occupied = tile.occupied.contains(cell);
                    read(number, CellReading { tile: id, index, cell, is_occupied });
                }
            }
        }
    }
}

impl FollowedTile {
    fn flip(&mut self, id: TileId, scan: &LoggedScan) {
        for (flips, bits) in [(&scan.observed_flips, &mut self.observed), (&scan.occupied_flips, &mut self.occupied)] {
            let from = flips.partition_point(|cell| cell.tile() < id);
            let of_tile = flips[from..].iter().take_while(|cell| cell.tile() == id);
            of_tile.copied().map(CellRef::cell).for_each(|cell| bits.flip(cell));
        }
        // A cell that is not observed has no occupied bit.
        self.occupied = self.occupied & self.observed;
    }
}

#[cfg(test)]
mod tests;
