//! Points of a cloud that end in the same cell, merged.
//!
//! Invariant: of the points of a cell the first of the cloud is taken, as it is.

use std::{
    collections::HashSet,
    hash::{BuildHasherDefault, Hasher},
};

use nalgebra::{Isometry3, Vector3};

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

/// The largest whole number up to this one. `f64::floor` calls a function where the processor's instruction may be
/// missing.
fn floor(value: f64) -> i64 {
    let whole = value as i64;
    whole.saturating_sub(i64::from(whole as f64 > value))
}

/// The first point of each cell, and how many points there were, which are at most `points_max`.
pub(super) fn points(
    points: impl Iterator<Item = [f64; 3]>,
    points_max: usize,
    pose: &Isometry3<f64>,
    cells: CellSize,
) -> (Vec<[f32; 3]>, usize) {
    let mut seen: HashSet<u64, BuildHasherDefault<CellHasher>> =
        HashSet::with_capacity_and_hasher(points_max, BuildHasherDefault::default());
    let mut taken = Vec::with_capacity(points_max);
    let mut count = 0;
    let rotation = pose.rotation.to_rotation_matrix();
    let corner = Vector3::from(cells.origin_m) - pose.translation.vector;
    for point in points {
        count += 1;
        let placed = rotation * Vector3::from(point) - corner;
        let mut key = 0_u64;
        for axis in 0..3 {
            let cell = floor(placed[axis] / cells.resolution_m);
            // 21 bits an axis: cells further apart than a million are far outside of any cloud.
            key = key << 21 | cell.cast_unsigned() & 0x1F_FFFF;
        }
        if seen.insert(key) {
            taken.push(point.map(|along| along as f32));
        }
    }
    (taken, count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_each_cell_the_first_point_is_taken_however_far_it_is() {
        let cells = CellSize { resolution_m: 0.1, origin_m: [0.0; 3] };
        let pose = Isometry3::translation(1.0, 0.0, 0.0);
        let given = [[0.01, 0.0, 0.0], [0.09, 0.0, 0.0], [-0.01, 0.0, 0.0], [1e30, -1e30, 1e19], [-1e19, 0.0, 0.0]];
        let (taken, count) = points(given.into_iter(), given.len(), &pose, cells);
        let expected = [given[0], given[2], given[3], given[4]].map(|point| point.map(|along| along as f32));
        assert_eq!((taken.as_slice(), count), (expected.as_slice(), 5));
        for value in [0.0, 0.5, -0.5, 2.0, -2.0, 1e15 + 0.5, -1e15 - 0.5] {
            assert_eq!(floor(value), value.floor() as i64, "{value}");
        }
    }
}
