//! Occupancy grids with a pose and a resolution of their own, as cells of a map.
//!
//! Invariant: pure. A cell of the map is occupied if anything in it is occupied, and free if something in it is free
//! and nothing is occupied; a cell that no cell of the grid shows is not seen.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix3, Point3};
use tidemap_grid::{
    index::{CellBox, CellIndex, TileIndex},
    mask::{Mask, TileMasks},
};

use super::scan::Scan;

/// Maximum number of cells of a grid, 8,192 by 8,192.
pub const GRID_CELLS_MAX: usize = 1 << 26;

/// A part of a cell by which a border may be off.
const TOLERANCE: f64 = 1e-6;

/// A grid of one layer that was seen, at any pose and with any resolution, such as the map of a SLAM program.
#[derive(Clone, Debug, PartialEq)]
pub struct OccupancyGrid {
    /// Pose of its lower corner: the transform map_from_grid.
    pub pose: Isometry3<f64>,
    /// Length of a cell's edge, metres, above 0.
    pub resolution_m: f64,
    /// Number of cells of a row.
    pub width: usize,
    /// Cells row by row, from the corner along x: below 0 not seen, 0 free, above 0 occupied.
    pub cells: Vec<i8>,
}

/// Why a grid cannot become cells of a map.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the error texts name the variants and fields")]
pub enum OccupancyError {
    #[error("a resolution of {0} m: use a number above 0")]
    Resolution(String),
    #[error("{cells} cells in rows of {width}: use whole rows, at least one")]
    Rows { cells: usize, width: usize },
    #[error("a grid of {cells} cells of {resolution_m} m; at most {GRID_CELLS_MAX} are taken")]
    TooManyCells { cells: usize, resolution_m: String },
    #[error("the pose has a number that is not finite")]
    Pose,
    #[error("its place is too far from the origin of the map")]
    TooFar,
    #[error("the map has no grid: create the map with a resolution")]
    NoGrid,
}

impl OccupancyGrid {
    /// Checks the grid by itself.
    ///
    /// # Errors
    /// [`OccupancyError`].
    pub fn check(&self) -> Result<(), OccupancyError> {
        if !(self.resolution_m.is_finite() && self.resolution_m > 0.0) {
            return Err(OccupancyError::Resolution(self.resolution_m.to_string()));
        }
        if self.width == 0 || self.cells.is_empty() || !self.cells.len().is_multiple_of(self.width) {
            return Err(OccupancyError::Rows { cells: self.cells.len(), width: self.width });
        }
        self.is_small(self.cells.len())?;
        let numbers = self.pose.translation.vector.iter().chain(self.pose.rotation.coords.iter());
        if !numbers.copied().all(f64::is_finite) {
            return Err(OccupancyError::Pose);
        }
        Ok(())
    }

    fn is_small(&self, cells: usize) -> Result<(), OccupancyError> {
        if cells <= GRID_CELLS_MAX {
            return Ok(());
        }
        Err(OccupancyError::TooManyCells { cells, resolution_m: self.resolution_m.to_string() })
    }

    /// The grid in the cells of a map, whose cells have this edge and begin at this origin, in metres.
    ///
    /// # Errors
    /// [`OccupancyError`].
    pub fn in_cells(&self, resolution_m: f64, origin_m: [f64; 3]) -> Result<Scan, OccupancyError> {
        self.check()?;
        if !(resolution_m.is_finite() && resolution_m > 0.0) {
            return Err(OccupancyError::Resolution(resolution_m.to_string()));
        }
        let turn = *self.pose.rotation.to_rotation_matrix().matrix();
        let parts = self.parts(resolution_m, &turn)?;
        let height = self.cells.len() / self.width;
        let field = MapField::around(self, height, resolution_m, origin_m)?;
        self.is_small(field.width.saturating_mul(field.height))?;
        let mut seen = vec![-1_i8; field.width * field.height];
        let edge = self.resolution_m / parts as f64;
        let known = self.cells.iter().enumerate().filter(|(_, cell)| **cell >= 0);
        for (place, &cell) in known {
            let corner = [place % self.width, place / self.width].map(|index| index as f64 * self.resolution_m);
            for part in 0..parts * parts {
                let [dx, dy] = [part % parts, part / parts].map(|part| (part as f64 + 0.5) * edge);
                let (x, y) = (corner[0] + dx, corner[1] + dy);
                let at = [0, 1].map(|row| turn[(row, 0)] * x + turn[(row, 1)] * y + self.pose.translation.vector[row]);
                if let Some(slot) = field.place(at).and_then(|place| seen.get_mut(place)) {
                    *slot = (*slot).max(cell.min(1));
                }
            }
        }
        field.scan(&seen)
    }

    /// Cells that are larger than the cells of the map are divided, so that no cell of the map is left out between.
    fn parts(&self, resolution_m: f64, turn: &Matrix3<f64>) -> Result<usize, OccupancyError> {
        let ratio = (self.resolution_m / resolution_m - TOLERANCE).ceil().max(1.0);
        let yaw = turn[(1, 0)].atan2(turn[(0, 0)]);
        let is_turned = (2.0 * yaw).sin().abs() > TOLERANCE;
        let parts = if is_turned { ratio * 2.0 } else { ratio };
        // A ratio above the limit is refused below.
        let parts = if parts > GRID_CELLS_MAX as f64 { GRID_CELLS_MAX } else { parts as usize };
        self.is_small(self.cells.len().saturating_mul(parts).saturating_mul(parts))?;
        Ok(parts)
    }
}

/// The cells of the map around a grid.
struct MapField {
    resolution_m: f64,
    origin_m: [f64; 2],
    /// Index x, y, z of the first cell.
    first: [i64; 3],
    width: usize,
    height: usize,
}

impl MapField {
    fn around(
        grid: &OccupancyGrid,
        height: usize,
        resolution_m: f64,
        origin_m: [f64; 3],
    ) -> Result<Self, OccupancyError> {
        let size = [grid.width, height].map(|cells| cells as f64 * grid.resolution_m);
        let corners = [[0.0, 0.0], [size[0], 0.0], [0.0, size[1]], size];
        let corners = corners.map(|[x, y]| grid.pose * Point3::new(x, y, 0.0));
        let range = |axis: usize| {
            let all = corners.map(|corner| (corner[axis] - origin_m[axis]) / resolution_m);
            let (low, high) = all.iter().fold((f64::MAX, f64::MIN), |(low, high), &at| (low.min(at), high.max(at)));
            let (low, high) = (index((low + TOLERANCE).floor())?, index((high - TOLERANCE).ceil())?);
            Ok::<_, OccupancyError>((low, usize::try_from((high - low).max(1)).unwrap_or(usize::MAX)))
        };
        let ((x, width), (y, height)) = (range(0)?, range(1)?);
        let z = index(((grid.pose.translation.z - origin_m[2]) / resolution_m + TOLERANCE).floor())?;
        Ok(Self { resolution_m, origin_m: [origin_m[0], origin_m[1]], first: [x, y, z], width, height })
    }

    /// The place of a point among the cells, row by row; `None`: outside.
    fn place(&self, at: [f64; 2]) -> Option<usize> {
        let index = |axis: usize| {
            let cell = ((at[axis] - self.origin_m[axis]) / self.resolution_m).floor() as i64 - self.first[axis];
            usize::try_from(cell).ok()
        };
        let (column, row) = (index(0)?, index(1)?);
        (column < self.width && row < self.height).then(|| row * self.width + column)
    }

    fn scan(&self, seen: &[i8]) -> Result<Scan, OccupancyError> {
        let cell = |[x, y, z]: [i64; 3]| {
            let index = |at: i64| i32::try_from(at).map_err(|_| OccupancyError::TooFar);
            Ok(CellIndex { x: index(x)?, y: index(y)?, z: index(z)? })
        };
        let [x, y, z] = self.first;
        let end = [x.saturating_add_unsigned(self.width as u64), y.saturating_add_unsigned(self.height as u64), z + 1];
        let shown = CellBox { min: cell(self.first)?, max: cell(end)? };
        Ok(Scan::Map { tiles: tiles_of(seen, [self.width, self.height], shown.min), shown })
    }
}

/// The tiles of cells that were seen, rows x of layers y of a volume: below 0 not seen, 0 free, above 0 occupied.
///
/// `size` is the number of cells along x and y; `first` the index of the first cell.
#[must_use]
pub fn tiles_of(seen: &[i8], size: [usize; 2], first: CellIndex) -> Vec<(TileIndex, TileMasks)> {
    let mut tiles: BTreeMap<(i32, i32, i32), (Mask, Mask)> = BTreeMap::new();
    let shifted = |first: i32, by: usize| first.saturating_add(i32::try_from(by).unwrap_or(i32::MAX));
    let layer = size[0].saturating_mul(size[1]).max(1);
    for (place, &cell) in seen.iter().enumerate().filter(|(_, cell)| **cell >= 0) {
        let [x, y, z] = [place % layer % size[0], place % layer / size[0], place / layer];
        let index = CellIndex { x: shifted(first.x, x), y: shifted(first.y, y), z: shifted(first.z, z) };
        let (tile, at) = index.tile();
        let (observed, occupied) = tiles.entry((tile.z, tile.y, tile.x)).or_insert((Mask::EMPTY, Mask::EMPTY));
        observed.insert(at);
        if cell > 0 {
            occupied.insert(at);
        }
    }
    let masks = |((z, y, x), (observed, occupied))| (TileIndex { x, y, z }, TileMasks::clipped(observed, occupied));
    tiles.into_iter().map(masks).collect()
}

fn index(number: f64) -> Result<i64, OccupancyError> {
    // Far beyond the cells that may exist, and exact as a float.
    if number.abs() < 1e12 { Ok(number as i64) } else { Err(OccupancyError::TooFar) }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    use super::*;

    fn grid(at: [f64; 3], yaw_rad: f64, resolution_m: f64, width: usize, cells: &[i8]) -> OccupancyGrid {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
        let pose = Isometry3::from_parts(Translation3::from(Vector3::from(at)), turn);
        OccupancyGrid { pose, resolution_m, width, cells: cells.to_vec() }
    }

    /// The cells row by row, and the first one.
    fn cells(scan: &Scan) -> (Vec<i8>, [i32; 3]) {
        let Scan::Map { tiles, shown } = scan else { panic!("{scan:?}") };
        let mut found = Vec::new();
        for y in shown.min.y..shown.max.y {
            for x in shown.min.x..shown.max.x {
                let (tile, at) = CellIndex { x, y, z: shown.min.z }.tile();
                let masks = tiles.iter().find(|(index, _)| *index == tile).map(|(_, masks)| masks);
                found.push(match masks {
                    Some(masks) if masks.occupied().contains(at) => 1,
                    Some(masks) if masks.observed().contains(at) => 0,
                    _ => -1,
                });
            }
        }
        (found, [shown.min.x, shown.min.y, shown.min.z])
    }

    #[test]
    fn cells_of_the_same_size_stay_as_they_are() {
        let scan = grid([1.0, -0.5, 0.0], 0.0, 0.5, 3, &[0, 1, -1, -1, 0, 100]).in_cells(0.5, [0.0; 3]);
        assert_eq!(cells(&scan.expect("valid")), (vec![0, 1, -1, -1, 0, 1], [2, -1, 0]));
        // Numbers as they come from a file: 0.05 is no binary fraction.
        let scan = grid([0.15, 0.3, 0.0], 0.0, 0.05, 3, &[0, 1, -1, -1, 0, 1]).in_cells(0.05, [-0.1, 0.0, 0.0]);
        assert_eq!(cells(&scan.expect("valid")), (vec![0, 1, -1, -1, 0, 1], [5, 6, 0]));
    }

    #[test]
    fn smaller_cells_are_occupied_together_if_one_is() {
        let scan = grid([10.0, 0.0, 0.0], 0.0, 0.25, 4, &[0, 1, -1, -1, 0, 0, -1, 0]).in_cells(0.5, [0.0; 3]);
        assert_eq!(cells(&scan.expect("valid")), (vec![1, 0], [20, 0, 0]));
    }

    #[test]
    fn larger_cells_fill_all_cells_of_the_map() {
        let scan = grid([0.0; 3], 0.0, 1.0, 3, &[0, 1, -1]).in_cells(0.5, [0.0; 3]);
        let row = [0, 0, 1, 1, -1, -1];
        assert_eq!(cells(&scan.expect("valid")), ([row, row].concat(), [0, 0, 0]));
        let scan = grid([0.0; 3], 0.0, 1.0, 2, &[1, 0]).in_cells(0.3, [0.0; 3]);
        let (found, _) = cells(&scan.expect("valid"));
        // A cell of the border, of which the grid covers a third, is not seen.
        assert!(found.len() == 28 && found[..21].iter().all(|&cell| cell >= 0), "{found:?}");
    }

    #[test]
    fn a_turned_grid_is_where_its_pose_states() {
        // A quarter turn: the x axis of the grid is the y axis of the map.
        let quarter = grid([2.0, 0.0, 0.0], std::f64::consts::FRAC_PI_2, 0.5, 3, &[0, 1, -1, -1, 0, 1]);
        let scan = quarter.in_cells(0.5, [0.0; 3]);
        assert_eq!(cells(&scan.expect("valid")), (vec![-1, 0, 0, 1, 1, -1], [2, 0, 0]));
        // Half of a right angle: no cell of a large area is left out.
        let eighth = grid([0.0; 3], std::f64::consts::FRAC_PI_4, 0.5, 20, &[0; 400]).in_cells(0.5, [0.0; 3]);
        let (found, [first_x, _, _]) = cells(&eighth.expect("valid"));
        let width = found.len() / 29;
        let middle = usize::try_from(-first_x).expect("the corner is inside");
        for row in 9..19 {
            assert!(found[row * width + middle - 5..row * width + middle + 5].iter().all(|&cell| cell == 0), "{row}");
        }
    }

    #[test]
    fn the_origin_and_the_height_of_the_map_count() {
        let scan = grid([1.0, 1.0, 0.7], 0.0, 0.5, 1, &[1]).in_cells(0.5, [0.5, -0.5, 0.2]);
        assert_eq!(cells(&scan.expect("valid")), (vec![1], [1, 3, 1]));
    }

    #[test]
    fn invalid_grids_are_errors_and_no_panics() {
        let wrong = |grid: OccupancyGrid, resolution: f64| grid.in_cells(resolution, [0.0; 3]).expect_err("wrong");
        assert!(matches!(wrong(grid([0.0; 3], 0.0, 0.0, 1, &[1]), 1.0), OccupancyError::Resolution(_)));
        assert!(matches!(wrong(grid([0.0; 3], 0.0, 1.0, 1, &[1]), f64::NAN), OccupancyError::Resolution(_)));
        assert!(matches!(wrong(grid([0.0; 3], 0.0, 1.0, 2, &[1]), 1.0), OccupancyError::Rows { .. }));
        assert!(matches!(wrong(grid([0.0; 3], 0.0, 1.0, 0, &[]), 1.0), OccupancyError::Rows { .. }));
        assert!(matches!(wrong(grid([0.0; 3], 0.0, 1e9, 1, &[1]), 1e-3), OccupancyError::TooManyCells { .. }));
        assert!(matches!(wrong(grid([f64::NAN, 0.0, 0.0], 0.0, 1.0, 1, &[1]), 1.0), OccupancyError::Pose));
        assert!(matches!(wrong(grid([1e300, 0.0, 0.0], 0.0, 1.0, 1, &[1]), 1.0), OccupancyError::TooFar));
        assert!(matches!(wrong(grid([1e11, 0.0, 0.0], 0.0, 1.0, 1, &[1]), 1.0), OccupancyError::TooFar));
    }
}
