//! Masks for the costmap filters of Nav2: where a robot must not go, and how fast it may drive.
//!
//! A mask is a picture of the size of its map, so [`super::write`] writes it: a keepout mask in mode trinary, a speed
//! mask in mode raw. A costmap filter computes `base + multiplier * value` from the value of a cell, 0 to 100; both
//! masks are made for base 0 and multiplier 1. In a keepout mask 100 is forbidden, and 0 is allowed. In a speed mask a
//! value is a percentage of the robot's greatest speed, and 0 means that there is no limit.
//!
//! Invariant: every cell that an area touches is forbidden, except cells that it touches in a corner only; no cell of a
//! speed mask has a limit of less than the slowest speed.

use crate::{MapPicture, PictureCell, PictureError, PictureValue};

/// From this share of the greatest speed on there is no limit: it would be rounded to 100 %.
const NO_LIMIT: f64 = 0.995;

/// The keepout mask of a map: forbidden are the cells that are occupied with at least the probability `occupied_from`,
/// and the cells of areas. `areas`: the corners of polygons in their order, x and y in metres; parts outside of the map
/// are left out. Unknown cells are allowed, as a mask only forbids.
///
/// # Errors
/// The picture is invalid or has several layers.
pub fn keepout(picture: &MapPicture, areas: &[Vec<[f64; 2]>], occupied_from: f64) -> Result<MapPicture, PictureError> {
    picture.check_flat()?;
    let is_forbidden = |cell: &PictureCell| cell.probability().is_some_and(|value| f64::from(value) >= occupied_from);
    let mut forbidden: Vec<bool> = picture.cells.iter().map(is_forbidden).collect();
    for corners in areas {
        forbid(picture, corners, &mut forbidden);
    }
    let cell = |forbidden| PictureCell::Static { probability: if forbidden { 1.0 } else { 0.0 } };
    Ok(mask(picture, forbidden.into_iter().map(cell).collect()))
}

/// The speed mask of a map: the more probable it is that a cell is occupied, the slower. The limit is the probability
/// that the cell is free, at least `slowest`; both are shares of the greatest speed, above 0 to 1. Cells that are
/// certainly free have no limit, and unknown cells stay unknown, which leaves the speed as it is.
///
/// # Errors
/// The picture is invalid or has several layers.
#[allow(clippy::cast_possible_truncation, reason = "a value of a cell is a single")]
pub fn speed(picture: &MapPicture, slowest: f64) -> Result<MapPicture, PictureError> {
    picture.check_flat()?;
    let cell = |cell: &PictureCell| match cell.probability().map(|value| 1.0 - f64::from(value)) {
        None => PictureCell::Unknown,
        Some(share) if share >= NO_LIMIT => PictureCell::Static { probability: 0.0 },
        Some(share) => PictureCell::Static { probability: share.max(slowest).min(1.0) as f32 },
    };
    Ok(mask(picture, picture.cells.iter().map(cell).collect()))
}

/// A picture of the same place with other cells.
fn mask(picture: &MapPicture, cells: Vec<PictureCell>) -> MapPicture {
    let MapPicture { resolution_m, origin_m, min_cell, size_cells, .. } = *picture;
    MapPicture {
        resolution_m,
        origin_m,
        min_cell,
        size_cells,
        cells,
        value: PictureValue::Probability,
        levels: (0.0, 1.0),
    }
}

/// Marks the cells that an area covers: the cells that its sides pass through, and in each row the cells between its
/// sides.
fn forbid(picture: &MapPicture, corners: &[[f64; 2]], forbidden: &mut [bool]) {
    let [width, height, _] = picture.size_cells.map(|size| size as usize);
    let in_cells =
        |corner: &[f64; 2]| [0, 1].map(|axis| (corner[axis] - picture.origin_m[axis]) / picture.resolution_m);
    let corners: Vec<[f64; 2]> = corners.iter().map(in_cells).collect();
    let sides = || corners.iter().copied().zip(corners.iter().copied().cycle().skip(1));
    let low = corners.iter().map(|corner| corner[1]).fold(f64::INFINITY, f64::min);
    let high = corners.iter().map(|corner| corner[1]).fold(f64::NEG_INFINITY, f64::max);
    for row in rows_between(low, high, height) {
        let cells = &mut forbidden[row * width..(row + 1) * width];
        let (bottom, top) = (row as f64, row as f64 + 1.0);
        let middle = bottom + 0.5;
        let mut crossings = Vec::new();
        for (from, to) in sides() {
            if let Some((left, right)) = side_in_row(from, to, bottom, top) {
                mark(cells, left, right);
            }
            if (from[1] > middle) != (to[1] > middle) {
                crossings.push(from[0] + (to[0] - from[0]) * (middle - from[1]) / (to[1] - from[1]));
            }
        }
        crossings.sort_by(f64::total_cmp);
        for pair in crossings.chunks_exact(2) {
            mark(cells, pair[0], pair[1]);
        }
    }
}

/// The rows of cells between two heights, which are in cells from the lowest row.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "values beyond the rows saturate")]
fn rows_between(low: f64, high: f64, height: usize) -> std::ops::Range<usize> {
    let first = low.floor().max(0.0) as usize;
    first.min(height)..(high.ceil().max(0.0) as usize).min(height)
}

/// The part of a row through which a side runs, from left to right; `None` if the side does not pass the row.
fn side_in_row(from: [f64; 2], to: [f64; 2], bottom: f64, top: f64) -> Option<(f64, f64)> {
    let (low, high) = if from[1] <= to[1] { (from, to) } else { (to, from) };
    if high[1] < bottom || low[1] >= top {
        return None;
    }
    let rise = high[1] - low[1];
    let at =
        |y: f64| if rise > 0.0 { low[0] + (high[0] - low[0]) * ((y - low[1]) / rise).clamp(0.0, 1.0) } else { low[0] };
    // A level side has its own ends.
    let (one, other) = if rise > 0.0 { (at(bottom), at(top)) } else { (low[0], high[0]) };
    Some((one.min(other), one.max(other)))
}

/// Marks the cells of a row from one place to another.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "values beyond the row saturate")]
fn mark(cells: &mut [bool], left: f64, right: f64) {
    let last = cells.len() as f64;
    if right < 0.0 || left >= last {
        return;
    }
    let (first, end) = (left.floor().max(0.0) as usize, (right.floor() + 1.0).clamp(0.0, last) as usize);
    cells[first..end].fill(true);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{
        super::{GridCell, GridMode, GridSettings, Thresholds, read, read_settings, write},
        *,
    };
    use crate::picture::samples;

    fn read_back(picture: &MapPicture, mode: GridMode) -> Vec<GridCell> {
        let files = write(picture, "mask.pgm", mode, Thresholds::default()).expect("files");
        let settings: GridSettings = read_settings(files.yaml.as_bytes()).expect("settings");
        read(&settings, &files.image).expect("a grid").cells
    }

    /// An empty floor of cells of 1 m.
    fn floor(width: u32, height: u32) -> MapPicture {
        MapPicture {
            resolution_m: 1.0,
            origin_m: [0.0; 3],
            size_cells: [width, height, 1],
            cells: vec![PictureCell::Static { probability: 0.0 }; (width * height) as usize],
            ..samples::flat()
        }
    }

    fn forbidden_cells(picture: &MapPicture) -> Vec<usize> {
        picture.cells.iter().enumerate().filter(|(_, cell)| cell.probability() == Some(1.0)).map(|(at, _)| at).collect()
    }

    #[test]
    fn what_is_occupied_at_the_time_is_forbidden() -> Result<(), PictureError> {
        let mask = keepout(&samples::flat(), &[], 0.65)?;
        let (free, forbidden) = (GridCell::Free, GridCell::Occupied);
        assert_eq!(read_back(&mask, GridMode::Trinary), [free, forbidden, free, free, free, forbidden]);
        assert_eq!(forbidden_cells(&keepout(&samples::flat(), &[], 0.5)?), [1, 4, 5]);
        Ok(())
    }

    #[test]
    fn an_area_forbids_the_cells_that_it_touches() -> Result<(), PictureError> {
        let area = vec![vec![[1.2, 1.2], [3.8, 1.2], [3.8, 3.8], [1.2, 3.8]]];
        let mask = keepout(&floor(5, 5), &area, 0.65)?;
        let expected: Vec<usize> = (1..4).flat_map(|row| (1..4).map(move |column| row * 5 + column)).collect();
        assert_eq!(forbidden_cells(&mask), expected);
        let within_a_cell = vec![vec![[2.2, 2.2], [2.4, 2.2], [2.3, 2.3]]];
        assert_eq!(forbidden_cells(&keepout(&floor(5, 5), &within_a_cell, 0.65)?), [12]);
        let outside = vec![vec![[-9.0, -9.0], [-8.0, -9.0], [-8.0, -8.0]], vec![[9.0, 1.0], [12.0, 1.0], [9.0, 2.0]]];
        assert_eq!(forbidden_cells(&keepout(&floor(5, 5), &outside, 0.65)?), [0; 0]);
        let partly = vec![vec![[-9.0, -9.0], [0.5, -9.0], [0.5, 0.5], [-9.0, 0.5]]];
        assert_eq!(forbidden_cells(&keepout(&floor(5, 5), &partly, 0.65)?), [0]);
        Ok(())
    }

    #[test]
    fn a_probable_obstacle_slows_down() -> Result<(), PictureError> {
        let mask = speed(&samples::flat(), 0.2)?;
        let percent = |percent| GridCell::Between { percent };
        let (no_limit, unknown) = (GridCell::Free, GridCell::Unknown);
        assert_eq!(
            read_back(&mask, GridMode::Raw),
            [no_limit, percent(20), unknown, no_limit, percent(50), percent(20)]
        );
        Ok(())
    }

    proptest! {
        /// A cell is forbidden if, and only if, one of many points of the area is in it.
        #[test]
        fn a_triangle_forbids_what_its_points_are_in(
            corners in proptest::collection::vec((0.01_f64..7.99, 0.01_f64..7.99).prop_map(|(x, y)| [x, y]), 3),
        ) {
            let mask = keepout(&floor(8, 8), std::slice::from_ref(&corners), 0.65).expect("a mask");
            let forbidden = forbidden_cells(&mask);
            for step in 0..=40_u32 {
                for other in 0..=(40 - step) {
                    let shares = [f64::from(step) / 40.0, f64::from(other) / 40.0];
                    let rest = 1.0 - shares[0] - shares[1];
                    let at = [0, 1].map(|axis| {
                        corners[0][axis] * shares[0] + corners[1][axis] * shares[1] + corners[2][axis] * rest
                    });
                    // Next to the border between two cells, the last digit decides.
                    if at.iter().all(|place| (place - place.round()).abs() > 1e-6) {
                        let cell = at[1].floor() as usize * 8 + at[0].floor() as usize;
                        prop_assert!(forbidden.contains(&cell), "{at:?} in {corners:?}");
                    }
                }
            }
            let bounds = |axis: usize| {
                let along = || corners.iter().map(|corner| corner[axis]);
                (along().fold(f64::INFINITY, f64::min).floor(), along().fold(0.0, f64::max).floor())
            };
            for cell in forbidden {
                let (x, y) = ((cell % 8) as f64, (cell / 8) as f64);
                prop_assert!((bounds(0).0..=bounds(0).1).contains(&x) && (bounds(1).0..=bounds(1).1).contains(&y));
            }
        }
    }
}
