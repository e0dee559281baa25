//! Points of a cloud that end in the same cell, merged.
//!
//! Invariant: of the points of a cell the first of the cloud is taken, as it is.

use std::{
    collections::HashSet,
    hash::{BuildHasherDefault, Hasher},
};

use nalgebra::Isometry3;

/// The cells of a grid, for merging points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellSize {
    /// Edge of a cell, metres.
    pub resolution_m: f64,
    /// Corner of cell (0, 0, 0), metres.
    pub origin_m: [f64; 3],
}

/// Cells are spread enough for one multiplication.
#[derive(Default)]
struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.write_u64(u64::from(*byte));
        }
    }

    fn write_u64(&mut self, value: u64) {
        let mixed = (self.0 ^ value).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        self.0 = mixed ^ (mixed >> 32);
    }
}

/// The first point of each cell, and how many points there were.
pub(super) fn points(
    points: impl Iterator<Item = [f64; 3]>,
    pose: &Isometry3<f64>,
    cells: CellSize,
) -> (Vec<[f32; 3]>, usize) {
    let mut seen: HashSet<u64, BuildHasherDefault<CellHasher>> = HashSet::default();
    let mut taken = Vec::new();
    let mut count = 0;
    for point in points {
        count += 1;
        let placed = pose.transform_point(&point.into());
        let mut key = 0_u64;
        for axis in 0..3 {
            let cell = ((placed[axis] - cells.origin_m[axis]) / cells.resolution_m).floor();
            // 21 bits an axis: cells further apart than a million are far outside of any cloud.
            key = key << 21 | (cell as i64).cast_unsigned() & 0x1F_FFFF;
        }
        if seen.insert(key) {
            taken.push(point.map(|along| along as f32));
        }
    }
    (taken, count)
}
