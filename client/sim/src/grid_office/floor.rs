//! The floor plan: the tiles, their order, and the cells that are always solid.
//!
//! Rooms are 4.8 m wide, 4.7 m deep and 2.4 m high. They stand in bands, each with a corridor of 1.6 m along its rooms.
//! Every third room is a common room with a kitchen and a meeting table; the others are offices of six desks.
//!
//! Invariant: tiles are numbered along the bands, in alternating direction, so that neighbouring slots are neighbours
//! in the building; the last band may be incomplete.

/// Cells along each side of a tile.
pub(crate) const TILE_SIDE: u32 = 8;
/// Cells of a tile.
pub(crate) const TILE_CELLS: u32 = 512;
/// Cells from floor to ceiling, both included.
pub(crate) const HEIGHT: u32 = 24;
/// Cells from one band to the next: a row of rooms and its corridor.
pub(crate) const BAND_DEPTH: u32 = 64;
/// Cells from one room to the next.
pub(crate) const ROOM_WIDTH: u32 = 48;
/// The row of the wall between rooms and corridor within a band.
pub(crate) const CORRIDOR_WALL: u32 = 47;
/// The columns of the door within the wall of a room.
pub(crate) const DOOR: std::ops::Range<u32> = 4..13;
/// Cells of a door's height.
pub(crate) const DOOR_TOP: u32 = 20;
/// Width and depth of the part of an office that belongs to one desk.
pub(crate) const BAY: (u32, u32) = (15, 22);

const TILE_LAYERS: u32 = HEIGHT / TILE_SIDE;
const BAND_TILES: u32 = BAND_DEPTH / TILE_SIDE;

/// A room, given by the cell of its corner.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FloorRoom {
    pub(crate) x: u32,
    pub(crate) y: u32,
    pub(crate) common: bool,
}

/// The building without the things that change.
#[derive(Clone, Debug)]
pub(crate) struct Floor {
    tiles: u32,
    bands: u32,
    /// Tiles along a band.
    columns: u32,
}

impl Floor {
    /// A floor with this many tiles, at least 1.
    pub(crate) fn new(tiles: u32) -> Self {
        let columns = tiles.div_ceil(TILE_LAYERS);
        // The largest number of bands that leaves the floor about square.
        let bands = (columns / (BAND_TILES * BAND_TILES)).isqrt().max(1);
        Self { tiles, bands, columns: columns.div_ceil(BAND_TILES * bands) }
    }

    /// Number of tiles.
    pub(crate) fn tiles(&self) -> u32 {
        self.tiles
    }

    /// Corner of a tile, in cells.
    fn corner(&self, slot: u32) -> (u32, u32, u32) {
        let (column, layer) = (slot / TILE_LAYERS, slot % TILE_LAYERS);
        let (along, across) = (column / BAND_TILES, column % BAND_TILES);
        let (band, along) = (along / self.columns, along % self.columns);
        let along = if band.is_multiple_of(2) { along } else { self.columns - 1 - along };
        (along * TILE_SIDE, band * BAND_DEPTH + across * TILE_SIDE, layer * TILE_SIDE)
    }

    /// Index of a tile in the map's frame, whose origin is in the middle of the building's floor.
    pub(crate) fn tile(&self, slot: u32) -> [i32; 3] {
        let (x, y, z) = self.corner(slot);
        let index = |cells: u32| (cells / TILE_SIDE).cast_signed();
        let middle = |tiles: u32| (tiles / 2).cast_signed();
        [index(x) - middle(self.columns), index(y) - middle(self.bands * BAND_TILES), index(z)]
    }

    /// `slot * 512 + cell` of a cell; none outside of all tiles.
    pub(crate) fn address(&self, x: u32, y: u32, z: u32) -> Option<u32> {
        if x >= self.columns * TILE_SIDE || y >= self.bands * BAND_DEPTH || z >= HEIGHT {
            return None;
        }
        let band = y / BAND_DEPTH;
        let along = if band.is_multiple_of(2) { x / TILE_SIDE } else { self.columns - 1 - x / TILE_SIDE };
        let column = (band * self.columns + along) * BAND_TILES + (y % BAND_DEPTH) / TILE_SIDE;
        let slot = column * TILE_LAYERS + z / TILE_SIDE;
        let cell = x % TILE_SIDE + TILE_SIDE * (y % TILE_SIDE) + TILE_SIDE * TILE_SIDE * (z % TILE_SIDE);
        (slot < self.tiles).then_some(slot * TILE_CELLS + cell)
    }

    /// The rooms of which at least a corner lies in a tile, along the bands.
    pub(crate) fn rooms(&self) -> Vec<FloorRoom> {
        let across = (self.columns * TILE_SIDE).div_ceil(ROOM_WIDTH);
        (0..self.bands * across)
            .map(|index| FloorRoom {
                x: index % across * ROOM_WIDTH,
                y: index / across * BAND_DEPTH,
                common: index % 3 == 2,
            })
            .filter(|room| self.address(room.x + 1, room.y + 1, 1).is_some())
            .collect()
    }

    /// The solid cells of a tile: word z, bit x + 8 * y.
    pub(crate) fn solid(&self, slot: u32) -> [u64; 8] {
        let (x, y, z) = self.corner(slot);
        let mut words = [0; 8];
        for (layer, word) in (z..).zip(&mut words) {
            for bit in 0..TILE_SIDE * TILE_SIDE {
                *word |= u64::from(self.is_solid(x + bit % TILE_SIDE, y + bit / TILE_SIDE, layer)) << bit;
            }
        }
        words
    }

    fn is_solid(&self, x: u32, y: u32, z: u32) -> bool {
        let (u, v) = (x % ROOM_WIDTH, y % BAND_DEPTH);
        let outer = x == 0 || x + 1 == self.columns * TILE_SIDE || y + 1 == self.bands * BAND_DEPTH;
        if z == 0 || z + 1 == HEIGHT || outer || v == 0 {
            return true;
        }
        if v == CORRIDOR_WALL {
            return !(DOOR.contains(&u) && z <= DOOR_TOP);
        }
        if v > CORRIDOR_WALL {
            return false;
        }
        let across = (self.columns * TILE_SIDE).div_ceil(ROOM_WIDTH);
        let common = (y / BAND_DEPTH * across + x / ROOM_WIDTH) % 3 == 2;
        u == 0 || if common { common_furniture(u, v, z) } else { office_furniture(u, v, z) }
    }
}

fn office_furniture(u: u32, v: u32, z: u32) -> bool {
    let shelf = u >= 46 && v <= 30 && z <= 17;
    let (bay_u, bay_v) = ((u - 1) % BAY.0, (v - 1) % BAY.1);
    let bay = u <= 3 * BAY.0 && v <= 2 * BAY.1 && bay_v < 6;
    let desk_top = bay_u < 14 && z == 7;
    let drawers = bay_u < 4 && z < 7;
    let screen = bay_v == 2 && (5..10).contains(&bay_u) && (8..13).contains(&z);
    shelf || bay && (desk_top || drawers || screen)
}

fn common_furniture(u: u32, v: u32, z: u32) -> bool {
    let counter = u <= 30 && v <= 6 && z <= 8;
    let cupboards = u <= 30 && v <= 3 && (14..20).contains(&z);
    let fridge = (31..37).contains(&u) && v <= 6 && z <= 17;
    let table = (14..34).contains(&u) && (26..36).contains(&v) && (z == 7 || u == 23 && v == 30 && z < 7);
    counter || cupboards || fridge || table
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_tile_is_once_and_addresses_lead_to_it() {
        for tiles in [1, 2, 25, 417, 2000] {
            let floor = Floor::new(tiles);
            let indices: BTreeSet<_> = (0..tiles).map(|slot| floor.tile(slot)).collect();
            assert_eq!(indices.len(), tiles as usize);
            for slot in 0..tiles {
                let (x, y, z) = floor.corner(slot);
                assert_eq!(floor.address(x, y, z), Some(slot * TILE_CELLS));
                assert_eq!(floor.address(x + 3, y + 2, z + 1), Some(slot * TILE_CELLS + 3 + 16 + 64));
            }
        }
    }

    #[test]
    fn a_tenth_to_a_fifth_is_solid() {
        for tiles in [417, 3000] {
            let floor = Floor::new(tiles);
            let solid: u32 = (0..tiles).flat_map(|slot| floor.solid(slot)).map(u64::count_ones).sum();
            let share = f64::from(solid) / f64::from(tiles * TILE_CELLS);
            assert!((0.1..0.2).contains(&share), "{share} of {tiles} tiles");
        }
    }
}
