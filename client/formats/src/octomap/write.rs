//! A map as an occupancy tree: a `.bt` file with the known cells, free or occupied.
//!
//! A cell of the map is a cell of the tree, so that the map's origin has to be a whole number of cells from the centre
//! of the tree. Cubes of cells that agree become one leaf, as large as possible.
//!
//! Invariant: reading the file gives exactly the known cells of the picture; the bytes of a tree are written once, in
//! order, and its depth bounds the recursion.

#[cfg(test)]
mod tests;

use super::{BINARY_START, CENTRE, DEPTH, child_corner};
use crate::{MapPicture, PictureCell, PictureError};

/// From this probability on a cell is occupied, as in OctoMap.
const OCCUPIED_FROM: f32 = 0.5;
/// The part of a cell by which the map may be moved.
const OFF_MAX: f64 = 0.01;

/// The meanings of the two bits of a child.
const UNKNOWN: u16 = 0;
const FREE: u16 = 1;
const OCCUPIED: u16 = 2;
const HAS_CHILDREN: u16 = 3;

/// The known cells as a `.bt` file.
///
/// # Errors
/// The picture is invalid, lies beyond the tree, or has no cells where the tree has them.
pub fn write(picture: &MapPicture) -> Result<Vec<u8>, PictureError> {
    picture.check()?;
    let mut writer = TreeWriter { picture, lowest: lowest_key(picture)?, nodes: 1, data: Vec::new() };
    let kind = writer.node([0; 3], 0);
    // The root has no parent that could state its kind: a tree without known cells has no nodes. Whole trees of one
    // value have more cells than a picture.
    let nodes = if kind == UNKNOWN { 0 } else { writer.nodes };
    let resolution_m = picture.resolution_m;
    let header = format!("{BINARY_START}\n# written by tidemap\nid OcTree\nsize {nodes}\nres {resolution_m}\ndata\n");
    Ok([header.as_bytes(), &writer.data].concat())
}

/// The key of the picture's first cell.
fn lowest_key(picture: &MapPicture) -> Result<[i64; 3], PictureError> {
    let cells = picture.origin_m.map(|origin_m| origin_m / picture.resolution_m);
    let beyond =
        || PictureError::BeyondTree { origin_m: picture.origin_m, reach_m: f64::from(CENTRE) * picture.resolution_m };
    let is_within = |axis: usize| {
        let last = cells[axis] + f64::from(picture.size_cells[axis]);
        cells[axis].round() >= -f64::from(CENTRE) && last.round() <= f64::from(CENTRE)
    };
    if !(0..3).all(is_within) {
        return Err(beyond());
    }
    let off_cells = cells.iter().map(|cell| (cell - cell.round()).abs()).fold(0.0, f64::max);
    if off_cells > OFF_MAX {
        return Err(PictureError::OffTree { resolution_m: picture.resolution_m, off_cells });
    }
    // Within ±32768, which was checked.
    #[allow(clippy::cast_possible_truncation, reason = "checked above")]
    Ok(cells.map(|cell| cell.round() as i64 + i64::from(CENTRE)))
}

struct TreeWriter<'a> {
    picture: &'a MapPicture,
    lowest: [i64; 3],
    /// Number of nodes written, including leaves.
    nodes: u64,
    data: Vec<u8>,
}

impl TreeWriter<'_> {
    /// Writes the descendants of a node, and returns the two bits for its parent. Nothing is written of a node without
    /// children.
    fn node(&mut self, corner: [u32; 3], depth: u32) -> u16 {
        if !self.overlaps(corner, 1 << (DEPTH - depth)) {
            return UNKNOWN;
        }
        if depth == DEPTH {
            return self.cell(corner);
        }
        let (start, nodes_before) = (self.data.len(), self.nodes);
        self.data.extend([0; 2]);
        let kinds: [u16; 8] =
            std::array::from_fn(|child| self.node(child_corner(corner, depth, child as u32), depth + 1));
        let is_one = kinds[0] != HAS_CHILDREN && kinds.iter().all(|&kind| kind == kinds[0]);
        if is_one {
            self.data.truncate(start);
            self.nodes = nodes_before;
            return kinds[0];
        }
        self.nodes += kinds.iter().filter(|&&kind| kind != UNKNOWN).count() as u64;
        let bits = kinds.iter().rev().fold(0, |bits, kind| bits << 2 | kind);
        self.data[start..start + 2].copy_from_slice(&u16::to_le_bytes(bits));
        HAS_CHILDREN
    }

    /// Whether a cube has cells of the picture.
    fn overlaps(&self, corner: [u32; 3], side: i64) -> bool {
        (0..3).all(|axis| {
            let from = i64::from(corner[axis]) - self.lowest[axis];
            from < i64::from(self.picture.size_cells[axis]) && from + side > 0
        })
    }

    fn cell(&self, key: [u32; 3]) -> u16 {
        let [width, height, _] = self.picture.size_cells.map(|size| size as usize);
        // The index is not negative: the cell is in the picture.
        let [x, y, z] = [0, 1, 2].map(|axis| (i64::from(key[axis]) - self.lowest[axis]) as usize);
        match self.picture.cells.get(x + width * (y + height * z)).copied().and_then(PictureCell::probability) {
            None => UNKNOWN,
            Some(probability) if probability >= OCCUPIED_FROM => OCCUPIED,
            Some(_) => FREE,
        }
    }
}
