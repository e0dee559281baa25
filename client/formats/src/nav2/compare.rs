//! A map of a map server compared with a map: the occupied cells of each that the other one has, too.
//!
//! The cells may have different sizes and lie beside each other. Two cells are within a cell of each other if their
//! centres are apart, along x and along y, by at most the wider cell's side; if one of them is narrower, by half the
//! difference more, so that each narrow cell of the neighbouring wide cell counts.
//!
//! Invariant: positions are compared in metres, never by index. What a map does not cover is unknown in it.

use super::{Grid, GridCell, Thresholds};
use crate::MapPicture;

/// Tolerance of positions, in cells, for the rounding of numbers in files.
const TOLERANCE: f64 = 1e-3;
/// Maximum ratio of the sides of cells. Beyond it, a wide cell has hundreds of narrow ones within a cell.
const RATIO_MAX: f64 = 20.0;

/// The cells of one map, counted against the other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SideCounts {
    /// Occupied cells.
    pub occupied: u64,
    /// The occupied cells with an occupied cell of the other map within a cell.
    pub found: u64,
    /// Free cells whose place is occupied in the other map, without an occupied cell of their own map within a cell.
    pub free_but_occupied: u64,
    /// Free and occupied cells whose place is unknown in the other map.
    pub unknown_there: u64,
}

/// The result of a comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// The cells of the file.
    pub file: SideCounts,
    /// The cells of the map.
    pub map: SideCounts,
    /// The wider cell's side: the distance that counts as within a cell, metres.
    pub within_m: f64,
}

/// Why maps cannot be compared. The boxes are the lower and the upper corner, metres.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum NotComparable {
    /// The maps cover different places.
    #[error(
        "the maps do not overlap: the file covers {}, and the map {}. Is the file of this place, and is its origin that \
         of the map's frame?",
        box_text(*.file),
        box_text(*.map)
    )]
    Apart { file: [[f64; 2]; 2], map: [[f64; 2]; 2] },
    /// The maps overlap where one of them is unknown.
    #[error("no cell is known in both maps: the file covers {}, and the map {}", box_text(*.file), box_text(*.map))]
    NothingKnown { file: [[f64; 2]; 2], map: [[f64; 2]; 2] },
    /// The sizes of the cells are too different.
    #[error(
        "the cells of the file are {file_m} m wide and those of the map {map_m} m: one may be at most 20 times as wide as \
         the other. Is the resolution of the file right?"
    )]
    Ratio { file_m: f64, map_m: f64 },
}

fn box_text([min, max]: [[f64; 2]; 2]) -> String {
    format!("x {:.2} to {:.2} m and y {:.2} to {:.2} m", min[0], max[0], min[1], max[1])
}

/// A flat map in its place.
struct Layer {
    resolution_m: f64,
    origin_m: [f64; 2],
    size_cells: [usize; 2],
    cells: Vec<GridCell>,
}

/// Compares a map of a map server with the cells of a map. A cell of the map is free, occupied or unknown by its
/// probability, as a file of mode trinary shows it; cells of the file between the thresholds are unknown.
///
/// # Errors
/// The maps have nothing in common, or cells of very different sizes.
pub fn compare(file: &Grid, map: &MapPicture, thresholds: Thresholds) -> Result<Agreement, NotComparable> {
    let of_map = map.cells.iter().map(|cell| thresholds.cell(map.value_of(*cell).map(f64::from)));
    let [width, height, _] = map.size_cells.map(|size| size as usize);
    let map = Layer {
        resolution_m: map.resolution_m,
        origin_m: [map.origin_m[0], map.origin_m[1]],
        size_cells: [width, height],
        cells: of_map.take(width * height).collect(),
    };
    let file = Layer {
        resolution_m: file.resolution_m,
        origin_m: file.origin_m,
        size_cells: file.size_cells.map(|size| size as usize),
        cells: file.cells.clone(),
    };
    let (narrow, wide) = (file.resolution_m.min(map.resolution_m), file.resolution_m.max(map.resolution_m));
    if wide > narrow * RATIO_MAX {
        return Err(NotComparable::Ratio { file_m: file.resolution_m, map_m: map.resolution_m });
    }
    let boxes = (file.bounds_m(), map.bounds_m());
    if (0..2).any(|axis| boxes.0[1][axis] <= boxes.1[0][axis] || boxes.1[1][axis] <= boxes.0[0][axis]) {
        return Err(NotComparable::Apart { file: boxes.0, map: boxes.1 });
    }
    let reach_m = wide + (wide - narrow) / 2.0 + TOLERANCE * narrow;
    let (of_file, known_in_both) = counts(&file, &map, reach_m);
    if known_in_both == 0 {
        return Err(NotComparable::NothingKnown { file: boxes.0, map: boxes.1 });
    }
    let (of_map, _) = counts(&map, &file, reach_m);
    Ok(Agreement { file: of_file, map: of_map, within_m: wide })
}

/// The counts of the cells of one map against another, and the number of cells that are known in both.
fn counts(own: &Layer, other: &Layer, reach_m: f64) -> (SideCounts, u64) {
    let (mut counts, mut known_in_both) = (SideCounts::default(), 0);
    for (index, cell) in own.cells.iter().enumerate() {
        let Some(is_occupied) = cell.occupied() else { continue };
        let centre_m = own.centre_m(index);
        let there = other.at(centre_m);
        counts.occupied += u64::from(is_occupied);
        counts.found += u64::from(is_occupied && other.is_occupied_near(centre_m, reach_m));
        match there.occupied() {
            None => counts.unknown_there += 1,
            Some(is_occupied_there) => {
                known_in_both += 1;
                let differs = !is_occupied && is_occupied_there && !own.is_occupied_near(centre_m, reach_m);
                counts.free_but_occupied += u64::from(differs);
            }
        }
    }
    (counts, known_in_both)
}

impl Layer {
    fn bounds_m(&self) -> [[f64; 2]; 2] {
        let upper = |axis: usize| self.origin_m[axis] + self.size_cells[axis] as f64 * self.resolution_m;
        [self.origin_m, [upper(0), upper(1)]]
    }

    fn centre_m(&self, index: usize) -> [f64; 2] {
        let at = [index % self.size_cells[0], index / self.size_cells[0]];
        [0, 1].map(|axis| self.origin_m[axis] + (at[axis] as f64 + 0.5) * self.resolution_m)
    }

    /// The cell in which a place lies.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the map by the check")]
    fn at(&self, place_m: [f64; 2]) -> GridCell {
        let [x, y] = [0, 1].map(|axis| ((place_m[axis] - self.origin_m[axis]) / self.resolution_m + TOLERANCE).floor());
        let is_within = x >= 0.0 && y >= 0.0 && x < self.size_cells[0] as f64 && y < self.size_cells[1] as f64;
        if is_within { self.cells[x as usize + self.size_cells[0] * y as usize] } else { GridCell::Unknown }
    }

    /// Whether the centre of an occupied cell is at most `reach_m` from a place, along x and along y.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "values beyond the map saturate")]
    fn is_occupied_near(&self, place_m: [f64; 2], reach_m: f64) -> bool {
        let [columns, rows] = [0, 1].map(|axis| {
            let cells = |metres: f64| (metres - self.origin_m[axis]) / self.resolution_m - 0.5;
            let first = cells(place_m[axis] - reach_m).ceil().max(0.0) as usize;
            let beyond = (cells(place_m[axis] + reach_m).floor() + 1.0).max(0.0) as usize;
            first..beyond.min(self.size_cells[axis])
        });
        rows.into_iter().any(|row| {
            let cell = |column: usize| self.cells[column + self.size_cells[0] * row];
            columns.clone().any(|column| cell(column) == GridCell::Occupied)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PictureCell, picture::samples};

    /// A map from its rows, the top row first: # is occupied, . free, and a blank unknown.
    fn file(rows: &[&str], resolution_m: f64, origin_m: [f64; 2]) -> Grid {
        let cell = |letter| match letter {
            '#' => GridCell::Occupied,
            '.' => GridCell::Free,
            _ => GridCell::Unknown,
        };
        let size_cells = [rows[0].len() as u32, rows.len() as u32];
        let cells = rows.iter().rev().flat_map(|row| row.chars().map(cell)).collect();
        Grid { resolution_m, origin_m, size_cells, cells, free_205: 0 }
    }

    fn map(rows: &[&str], resolution_m: f64, [x, y]: [f64; 2]) -> MapPicture {
        let cell = |letter| match letter {
            '#' => PictureCell::Changing { probability: 0.9 },
            '.' => PictureCell::Static { probability: 0.0 },
            '-' => PictureCell::Changing { probability: 0.5 },
            _ => PictureCell::Unknown,
        };
        MapPicture {
            resolution_m,
            origin_m: [x, y, 0.0],
            size_cells: [rows[0].len() as u32, rows.len() as u32, 1],
            cells: rows.iter().rev().flat_map(|row| row.chars().map(cell)).collect(),
            ..samples::flat()
        }
    }

    fn compared(file: &Grid, map: &MapPicture) -> (SideCounts, SideCounts) {
        let Agreement { file, map, .. } = compare(file, map, Thresholds::default()).expect("maps that overlap");
        (file, map)
    }

    fn side(occupied: u64, found: u64, free_but_occupied: u64, unknown_there: u64) -> SideCounts {
        SideCounts { occupied, found, free_but_occupied, unknown_there }
    }

    const WALL: [&str; 3] = ["...#....", "...#....", "...#...."];

    #[test]
    fn a_map_agrees_with_itself() {
        let (of_file, of_map) = compared(&file(&WALL, 0.1, [0.3, -2.0]), &map(&WALL, 0.1, [0.3, -2.0]));
        assert_eq!((of_file, of_map), (side(3, 3, 0, 0), side(3, 3, 0, 0)));
    }

    #[test]
    fn a_wall_that_is_one_cell_off_agrees_and_one_that_is_two_cells_off_does_not() {
        for (off, found, differ) in [(1.0, 3, 0), (-1.0, 3, 0), (2.0, 0, 3), (-2.0, 0, 3)] {
            let (of_file, of_map) = compared(&file(&WALL, 0.1, [off * 0.1, 0.0]), &map(&WALL, 0.1, [0.0; 2]));
            // The columns that lie beside the other map are unknown in it.
            let beside = off.abs() as u64 * 3;
            assert_eq!(of_file, side(3, found, differ, beside), "{off}");
            assert_eq!(of_map, side(3, found, differ, beside), "{off}");
        }
        // Also diagonally.
        for (off, found) in [(0.1, 1), (0.2, 0)] {
            let dot = ["....", ".#..", "....", "...."];
            let (of_file, of_map) = compared(&file(&dot, 0.1, [off, off]), &map(&dot, 0.1, [0.0; 2]));
            assert_eq!((of_file.found, of_map.found), (found, found), "{off}");
        }
    }

    #[test]
    fn cells_of_other_sizes_are_compared_in_metres() {
        let fine = ["......##........", "......##........"];
        let coarse = ["...#...."];
        let (of_file, of_map) = compared(&file(&fine, 0.05, [0.0; 2]), &map(&coarse, 0.1, [0.0; 2]));
        assert_eq!((of_file, of_map), (side(4, 4, 0, 0), side(1, 1, 0, 0)));
        for (origin, found) in [(0.1, (4, 1)), (0.2, (0, 0))] {
            let (of_file, of_map) = compared(&file(&fine, 0.05, [origin, 0.0]), &map(&coarse, 0.1, [0.0; 2]));
            assert_eq!((of_file.found, of_map.found), found, "{origin}");
        }
        let (of_file, of_map) = compared(&file(&coarse, 0.1, [0.0; 2]), &map(&fine, 0.05, [0.0; 2]));
        assert_eq!((of_file.found, of_map.found), (1, 4));
    }

    #[test]
    fn what_one_map_does_not_know_is_counted_and_does_not_agree() {
        let (of_file, of_map) = compared(&file(&["#..#.."], 1.0, [0.0; 2]), &map(&["# .-.#"], 1.0, [0.0; 2]));
        // Unknown: the second cell, and the fourth, which is between the thresholds.
        assert_eq!((of_file, of_map), (side(2, 1, 1, 2), side(2, 1, 0, 0)));
        let (of_file, of_map) = compared(&file(&["#....#"], 1.0, [0.0; 2]), &map(&["#."], 1.0, [0.0; 2]));
        assert_eq!((of_file, of_map), (side(2, 1, 0, 4), side(1, 1, 0, 0)));
    }

    #[test]
    fn maps_that_have_nothing_in_common_are_refused() {
        let compare = |file: &Grid, map: &MapPicture| compare(file, map, Thresholds::default());
        let apart = compare(&file(&WALL, 0.1, [0.8, 0.0]), &map(&WALL, 0.1, [0.0; 2]));
        let text = apart.map_err(|error| error.to_string()).expect_err("they touch only");
        assert!(text.contains("file covers x 0.80 to 1.60 m and y 0.00 to 0.30 m"), "{text}");
        let unknown = compare(&file(&["##  "], 1.0, [0.0; 2]), &map(&["  ##"], 1.0, [0.0; 2]));
        assert!(matches!(unknown, Err(NotComparable::NothingKnown { .. })), "{unknown:?}");
        let ratio = compare(&file(&WALL, 5.0, [0.0; 2]), &map(&WALL, 0.05, [0.0; 2]));
        assert_eq!(ratio, Err(NotComparable::Ratio { file_m: 5.0, map_m: 0.05 }));
    }
}
