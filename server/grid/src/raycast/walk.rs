//! Traversal of rays that start at one place, and the tiles that they pass.
//!
//! Invariant: a ray takes as many steps along each axis as its end's cell is away from its start's cell, so that it
//! ends in that cell in spite of rounding on the way.

use std::{collections::HashMap, hint::select_unpredictable};

use tidemap_model::special::square;

use super::{
    CastError, CastLimits, GRAZING_CELLS, RayPart, Tile,
    clip::{Clipped, clip},
};
use crate::{
    index::{CellBox, CellIndex, TileIndex},
    mask::{Mask, TileMasks},
    spec::GridSpec,
};

/// No link yet.
const UNKNOWN: u32 = u32::MAX;
/// The traversed length of a ray, in fixed point.
const ONE: f64 = (1u64 << 61) as f64;
/// Bits of each axis in a place that is spread: three, and one above them that shows when a tile is left.
const FIELDS: [u32; 3] = [0x007, 0x070, 0x700];
const GUARDS: u32 = 0x888;

fn spread(place: u16) -> u32 {
    let place = u32::from(place);
    place & 7 | (place & 0o70) << 1 | (place & 0o700) << 2
}

fn gather(spread: u32) -> u16 {
    (spread & 7 | spread >> 1 & 0o70 | spread >> 2 & 0o700) as u16
}

/// A position along the traversed part of a ray, in fixed point; positions far beyond its end are limited.
fn fixed(along: f64) -> u64 {
    (along * ONE).clamp(0.0, 2.0 * ONE) as u64
}

/// The positions along a ray at which the borders of one axis are crossed.
#[derive(Clone, Copy)]
struct Borders {
    next: u64,
    apart: u64,
}

impl Borders {
    /// The first border lies `first` cells away, and the ray goes `along` cells in all. Exactly `crossings` borders are
    /// crossed up to its end, despite rounding.
    fn new(crossings: u32, first: f64, along: f64) -> Borders {
        let until = ONE as u64;
        if crossings == 0 {
            return Borders { next: u64::MAX, apart: 0 };
        }
        let count = u64::from(crossings);
        let share = along.recip();
        let mut borders = Borders { next: fixed(first * share), apart: fixed(share.abs()).max(1) };
        let last = borders.next.saturating_add(borders.apart.saturating_mul(count - 1));
        if last > until {
            let over = last - until;
            if over > borders.next && count > 1 {
                borders = Borders { next: 0, apart: until / (count - 1) };
            } else {
                borders.next = borders.next.saturating_sub(over);
            }
        }
        let beyond = borders.next.saturating_add(borders.apart.saturating_mul(count));
        borders.next += (until + 1).saturating_sub(beyond);
        borders
    }
}

/// The rays of one scan.
#[derive(Debug)]
pub(super) struct Walk<'a> {
    spec: &'a GridSpec,
    allowed: CellBox,
    position_m: [f64; 3],
    /// The position of the sensor, in cells from the grid's origin.
    start: [f64; 3],
    limits: CastLimits,
    cells: u64,
    tiles: Vec<Tile>,
    /// The neighbours of each tile, down and up along each axis.
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

    /// A position of the map in cells from the grid's origin.
    fn in_cells(&self, place_m: [f64; 3]) -> [f64; 3] {
        let mut place = std::array::from_fn(|axis| (place_m[axis] - self.spec.origin_m[axis]) / self.spec.resolution_m);
        if self.spec.is_flat {
            place[2] = 0.0;
        }
        place
    }

    /// Adds a ray. `along_m` is its end, relative to the sensor in the map's directions; `is_hit`: whether it hit
    /// something.
    pub(super) fn ray(&mut self, number: usize, along_m: [f64; 3], is_hit: bool) -> Result<(), CastError> {
        let end = self.in_cells(std::array::from_fn(|axis| self.position_m[axis] + along_m[axis]));
        let Some(clipped) = clip(&self.allowed, self.start, end) else { return Ok(()) };
        let steps = (0..3).map(|axis| u64::from(clipped.from[axis].abs_diff(clipped.to[axis]))).sum::<u64>();
        if steps >= self.limits.ray_cells {
            return Err(CastError::RayTooLong { ray: number, cells: steps + 1, max: self.limits.ray_cells });
        }
        self.cells += steps + 1;
        if self.cells > self.limits.cells {
            return Err(CastError::TooManyCells { max: self.limits.cells });
        }
        let ends_here = is_hit && clipped.is_whole;
        let (tile, place) = self.pass(&clipped, steps, if ends_here { grazing_steps(&clipped, steps) } else { 0 })?;
        let end = &mut self.tiles[tile];
        if ends_here {
            end.occupied.insert(place);
        } else {
            end.free.insert(place);
        }
        Ok(())
    }

    /// Frees the cells of a ray except the last, and returns the last cell as its tile and its place there. The cells
    /// of the last `grazing` steps are only free where no other ray ends beside them.
    fn pass(&mut self, clipped: &Clipped, steps: u64, grazing: u64) -> Result<(usize, u16), CastError> {
        let Clipped { from, to, start, end, .. } = *clipped;
        let (index, place) = CellIndex { x: from[0], y: from[1], z: from[2] }.tile();
        let mut tile = self.first_tile(index)?;
        // The place is mirrored along the axes on which the ray descends, so that every step ascends.
        let mirror = (0..3).filter(|&axis| to[axis] < from[axis]).fold(0, |mirror, axis| mirror | FIELDS[axis]);
        let mut place = spread(place) ^ mirror;
        let [one, two, three] = std::array::from_fn(|axis| {
            let crossings = from[axis].abs_diff(to[axis]);
            let border = f64::from(from[axis].max(from[axis] + (to[axis] - from[axis]).signum()));
            Borders::new(crossings, border - start[axis], end[axis] - start[axis])
        });
        let (mut next, apart) = ([one.next, two.next, three.next], [one.apart, two.apart, three.apart]);
        let last = grazing.min(1);
        let parts = [(steps - grazing, RayPart::Way), (grazing - last, RayPart::Grazing), (last, RayPart::Last)];
        for (count, part) in parts {
            let mut free = self.tiles[tile].passed(part);
            for _ in 0..count {
                let real = place ^ mirror;
                free[(real >> 8 & 7) as usize] |= 1 << (real & 7 | real >> 1 & 0o70);
                // The code avoids branches: which border comes next is unpredictable.
                let is_two = next[1] < next[0];
                let is_three = next[2] < select_unpredictable(is_two, next[1], next[0]);
                let is = [!is_two & !is_three, is_two & !is_three, is_three];
                for axis in 0..3 {
                    next[axis] += select_unpredictable(is[axis], apart[axis], 0);
                }
                place += select_unpredictable(is_three, 0x100, select_unpredictable(is_two, 0x10, 1));
                if place & GUARDS != 0 {
                    let axis = (place & GUARDS).trailing_zeros() as usize / 4;
                    place &= !GUARDS;
                    tile = self.neighbour(tile, axis, mirror & FIELDS[axis] == 0)?;
                    free = self.tiles[tile].passed(part);
                }
            }
        }
        Ok((tile, gather(place ^ mirror)))
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
        let neighbour = self.tile(self.tiles[tile].index.neighbour(axis, is_up))?;
        self.links[tile][side] = neighbour;
        Ok(neighbour as usize)
    }

    /// The number of a tile; adds it if no ray has passed it.
    fn tile(&mut self, index: TileIndex) -> Result<u32, CastError> {
        if let Some(&known) = self.ids.get(&index) {
            return Ok(known);
        }
        let number = u32::try_from(self.tiles.len()).unwrap_or(UNKNOWN);
        if self.tiles.len() >= self.limits.tiles || number == UNKNOWN {
            return Err(CastError::TooManyTiles { max: self.limits.tiles });
        }
        self.ids.insert(index, number);
        self.tiles.push(Tile { index, ..Tile::default() });
        self.links.push([UNKNOWN; 6]);
        Ok(number)
    }

    /// The tiles with their masks, ascending by tile.
    pub(super) fn into_tiles(self) -> Vec<(TileIndex, TileMasks)> {
        let mut tiles: Vec<(TileIndex, TileMasks)> =
            self.tiles.iter().map(|tile| (tile.index, self.masks(tile))).collect();
        tiles.sort_unstable_by_key(|(index, _)| *index);
        tiles
    }

    fn masks(&self, tile: &Tile) -> TileMasks {
        let mut free = tile.free;
        if !(tile.grazed | tile.last).without(free).is_empty() {
            let (beside, beside_two) = self.beside_ends(tile);
            // A cell before the end of its own ray lies beside that end.
            free = free | tile.grazed.without(beside) | tile.last.without(beside_two);
        }
        TileMasks::clipped(free | tile.occupied, tile.occupied)
    }

    /// The cells of a tile that share a face with a cell in which a ray ends, and those that share faces with several.
    fn beside_ends(&self, tile: &Tile) -> (Mask, Mask) {
        let (mut one, mut several) = (Mask::EMPTY, Mask::EMPTY);
        for (axis, is_up) in (0..3).flat_map(|axis| [(axis, false), (axis, true)]) {
            let neighbour = self.ids.get(&tile.index.neighbour(axis, is_up));
            let neighbour = neighbour.and_then(|&number| self.tiles.get(number as usize));
            let beyond = neighbour.map_or(Mask::EMPTY, |neighbour| neighbour.occupied);
            let beside = tile.occupied.beside(axis, is_up, beyond);
            several |= one & beside;
            one |= beside;
        }
        (one, several)
    }
}

/// The number of steps that the last [`GRAZING_CELLS`] cells of a ray take.
fn grazing_steps(clipped: &Clipped, steps: u64) -> u64 {
    let along = (0..3).map(|axis| square(clipped.end[axis] - clipped.start[axis])).sum::<f64>().sqrt();
    if along <= GRAZING_CELLS { steps } else { ((steps as f64 * GRAZING_CELLS / along).ceil() as u64).min(steps) }
}
