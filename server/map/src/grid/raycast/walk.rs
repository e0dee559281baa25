//! Traversal of rays that start at one place, and the tiles that they pass.
//!
//! Invariant: a ray takes as many steps along each axis as its end's cell is away from its start's, so that it ends in
//! that cell whatever is rounded on the way.

use std::collections::HashMap;

use super::{
    CastError, CastLimits, Tile,
    clip::{Clipped, clip},
};
use crate::grid::{
    index::{CellBox, CellIndex, TileIndex},
    mask::{Mask, TileMasks},
    spec::GridSpec,
};

/// No link yet.
const UNKNOWN: u32 = u32::MAX;
/// Bit position of an axis' last three bits in a cell's place.
const SHIFTS: [u32; 3] = [0, 3, 6];

/// The rays of one scan.
#[derive(Debug)]
pub(super) struct Walk<'a> {
    spec: &'a GridSpec,
    allowed: CellBox,
    position_m: [f64; 3],
    /// Of the sensor, in cells from the grid's origin.
    start: [f64; 3],
    limits: CastLimits,
    cells: u64,
    tiles: Vec<Tile>,
    /// Per tile its neighbours, down and up along each axis.
    links: Vec<[u32; 6]>,
    ids: HashMap<TileIndex, u32>,
    /// The tile in which a ray began last.
    first: Option<(TileIndex, u32)>,
}

impl<'a> Walk<'a> {
    pub(super) fn new(spec: &'a GridSpec, position_m: [f64; 3], limits: CastLimits) -> Walk<'a> {
        let mut walk = Walk {
            spec,
            allowed: spec.allowed(),
            position_m,
            start: [0.0; 3],
            limits,
            cells: 0,
            tiles: Vec::new(),
            links: Vec::new(),
            ids: HashMap::new(),
            first: None,
        };
        walk.start = walk.in_cells(position_m);
        walk
    }

    /// A place of the map in cells from the grid's origin.
    fn in_cells(&self, place_m: [f64; 3]) -> [f64; 3] {
        let mut place = std::array::from_fn(|axis| (place_m[axis] - self.spec.origin_m[axis]) / self.spec.resolution_m);
        if self.spec.is_flat {
            place[2] = 0.0;
        }
        place
    }

    /// Takes a ray in: where it ends, seen from the sensor in the map's directions, and whether it ends at something.
    pub(super) fn ray(&mut self, number: usize, along_m: [f64; 3], is_hit: bool) -> Result<(), CastError> {
        let end = self.in_cells(std::array::from_fn(|axis| self.position_m[axis] + along_m[axis]));
        let Some(clipped) = clip(&self.allowed, self.start, end) else { return Ok(()) };
        let Clipped { from, to, has_end } = clipped;
        let steps = (0..3).map(|axis| u64::from(from[axis].abs_diff(to[axis]))).sum::<u64>();
        if steps >= self.limits.ray_cells {
            return Err(CastError::RayTooLong { ray: number, cells: steps + 1, max: self.limits.ray_cells });
        }
        self.cells += steps + 1;
        if self.cells > self.limits.cells {
            return Err(CastError::TooManyCells { max: self.limits.cells });
        }
        let (tile, place) = self.pass(end, from, to, steps)?;
        let end = &mut self.tiles[tile];
        if is_hit && has_end {
            end.occupied.insert(place);
        } else {
            end.free.insert(place);
        }
        Ok(())
    }

    /// Frees the cells of a ray but for the last, and gives that: its tile and its place there.
    fn pass(&mut self, end: [f64; 3], from: [i32; 3], to: [i32; 3], steps: u64) -> Result<(usize, u16), CastError> {
        let (index, place) = CellIndex { x: from[0], y: from[1], z: from[2] }.tile();
        let mut tile = self.first_tile(index)?;
        let mut place = u32::from(place);
        let along: [f64; 3] = std::array::from_fn(|axis| end[axis] - self.start[axis]);
        let is_up: [bool; 3] = std::array::from_fn(|axis| to[axis] >= from[axis]);
        // How far along the ray the next border of each axis lies, and how far its borders are apart.
        let mut next: [f64; 3] = std::array::from_fn(|axis| {
            let border = f64::from(from[axis]) + if is_up[axis] { 1.0 } else { 0.0 };
            if from[axis] == to[axis] { f64::INFINITY } else { (border - self.start[axis]) / along[axis] }
        });
        let apart: [f64; 3] = along.map(|along| along.abs().recip());
        let mut left: [u32; 3] = std::array::from_fn(|axis| from[axis].abs_diff(to[axis]));
        let mut free = &mut self.tiles[tile].free.0;
        for _ in 0..steps {
            free[(place >> 6 & 7) as usize] |= 1 << (place & 63);
            let axis = if next[0] <= next[1] {
                if next[0] <= next[2] { 0 } else { 2 }
            } else if next[1] <= next[2] {
                1
            } else {
                2
            };
            left[axis] -= 1;
            next[axis] = if left[axis] == 0 { f64::INFINITY } else { next[axis] + apart[axis] };
            let shift = SHIFTS[axis];
            let three = place >> shift & 7;
            let moved = if is_up[axis] { three + 1 } else { three.wrapping_sub(1) } & 7;
            place = place & !(7 << shift) | moved << shift;
            if moved == if is_up[axis] { 0 } else { 7 } {
                tile = self.neighbour(tile, axis, is_up[axis])?;
                free = &mut self.tiles[tile].free.0;
            }
        }
        Ok((tile, u16::try_from(place).unwrap_or(0)))
    }

    fn first_tile(&mut self, index: TileIndex) -> Result<usize, CastError> {
        match self.first {
            Some((known, tile)) if known == index => Ok(tile as usize),
            _ => {
                let tile = self.tile(index)?;
                self.first = Some((index, tile));
                Ok(tile as usize)
            }
        }
    }

    fn neighbour(&mut self, tile: usize, axis: usize, is_up: bool) -> Result<usize, CastError> {
        let side = 2 * axis + usize::from(is_up);
        let known = self.links[tile][side];
        if known != UNKNOWN {
            return Ok(known as usize);
        }
        let mut index = self.tiles[tile].index;
        let along = [&mut index.x, &mut index.y, &mut index.z];
        let step = if is_up { 1 } else { -1 };
        for (_, along) in along.into_iter().enumerate().filter(|(of, _)| *of == axis) {
            *along += step;
        }
        let neighbour = self.tile(index)?;
        self.links[tile][side] = neighbour;
        Ok(neighbour as usize)
    }

    /// The number of a tile, a new one where no ray has passed it.
    fn tile(&mut self, index: TileIndex) -> Result<u32, CastError> {
        if let Some(&known) = self.ids.get(&index) {
            return Ok(known);
        }
        let number = u32::try_from(self.tiles.len()).unwrap_or(UNKNOWN);
        if self.tiles.len() >= self.limits.tiles || number == UNKNOWN {
            return Err(CastError::TooManyTiles { max: self.limits.tiles });
        }
        self.ids.insert(index, number);
        self.tiles.push(Tile { index, free: Mask::EMPTY, occupied: Mask::EMPTY });
        self.links.push([UNKNOWN; 6]);
        Ok(number)
    }

    /// What was seen, ascending by tile.
    pub(super) fn into_tiles(self) -> Vec<(TileIndex, TileMasks)> {
        let mut tiles: Vec<(TileIndex, TileMasks)> = self.tiles.iter().map(|tile| (tile.index, tile.masks())).collect();
        tiles.sort_unstable_by_key(|(index, _)| *index);
        tiles
    }
}
