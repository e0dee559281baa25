//! Compares the traversal with a dense sampler, and tests edge cases of rays, grids and limits.

use std::collections::BTreeSet;

use proptest::prelude::*;

use super::*;
use crate::index::{CellBox, CellIndex, TILE_EDGE, TILE_LIMIT};

const LIMITS: CastLimits = CastLimits { ray_cells: 100_000, cells: 10_000_000, tiles: 100_000 };

fn spec(is_flat: bool, extent: Option<CellBox>) -> GridSpec {
    GridSpec { is_flat, origin_m: [-1.0, 0.25, 3.0], extent, ..GridSpec::new(0.5) }
}

fn unit() -> GridSpec {
    GridSpec { resolution_m: 1.0, origin_m: [0.0; 3], ..spec(false, None) }
}

fn at([x, y, z]: [f64; 3]) -> Isometry3<f64> {
    Isometry3::translation(x, y, z)
}

fn points(pose: Isometry3<f64>, points: &[[f32; 3]]) -> Readings {
    Readings { pose, min_range_m: 0.0, max_range_m: None, rays: Rays::Points(points.concat()) }
}

type Cells = BTreeSet<(i32, i32, i32)>;

/// Free and occupied cells.
fn cells(tiles: &[(TileIndex, TileMasks)]) -> (Cells, Cells) {
    let (mut free, mut occupied) = (Cells::new(), Cells::new());
    for (index, masks) in tiles {
        for place in masks.observed().cells() {
            let cell = index.cell(place);
            let set = if masks.occupied().contains(place) { &mut occupied } else { &mut free };
            assert!(set.insert((cell.x, cell.y, cell.z)));
        }
    }
    (free, occupied)
}

fn cast_cells(spec: &GridSpec, readings: &Readings) -> (Cells, Cells) {
    cells(&cast(spec, readings, LIMITS).expect("within the limits"))
}

fn line(cells: &[(i32, i32, i32)]) -> Cells {
    cells.iter().copied().collect()
}

#[test]
fn cells_on_the_way_are_free_and_the_last_is_occupied() {
    let (free, occupied) = cast_cells(&unit(), &points(at([0.5, 0.5, 0.5]), &[[3.0, 0.0, 0.0]]));
    assert_eq!(free, line(&[(0, 0, 0), (1, 0, 0), (2, 0, 0)]));
    assert_eq!(occupied, line(&[(3, 0, 0)]));
    let (free, occupied) = cast_cells(&unit(), &points(at([0.5, 0.5, 0.5]), &[[0.0, -9.0, 0.0]]));
    assert_eq!(free, (-8..=0).map(|y| (0, y, 0)).collect());
    assert_eq!(occupied, line(&[(0, -9, 0)]));
}

#[test]
fn rays_of_no_length_and_along_borders_end_where_they_should() {
    let (free, occupied) = cast_cells(&unit(), &points(at([0.5; 3]), &[[0.0; 3], [0.25, 0.0, 0.0]]));
    assert!(free.is_empty());
    assert_eq!(occupied, line(&[(0, 0, 0)]));
    // The end lies on the border between cells, which belongs to the upper cell.
    let (free, occupied) = cast_cells(&unit(), &points(at([1.0, 2.0, 3.0]), &[[2.0, 0.0, 0.0], [-2.0, 0.0, 0.0]]));
    assert_eq!(free, line(&[(0, 2, 3), (1, 2, 3), (2, 2, 3)]));
    assert_eq!(occupied, line(&[(3, 2, 3), (-1, 2, 3)]));
}

#[test]
fn occupied_wins_and_points_may_repeat() {
    let ends = [[3.0, 0.0, 0.0], [6.0, 0.0, 0.0], [3.0, 0.0, 0.0]];
    let (free, occupied) = cast_cells(&unit(), &points(at([0.5; 3]), &ends));
    assert_eq!(occupied, line(&[(3, 0, 0), (6, 0, 0)]));
    // Cell 4 lies beside the end in cell 3.
    assert_eq!(free, line(&[(0, 0, 0), (1, 0, 0), (2, 0, 0), (5, 0, 0)]));
}

#[test]
fn ranges_bound_what_is_believed() {
    let mut readings = points(at([0.5; 3]), &[[9.0, 0.0, 0.0], [0.0, 0.5, 0.0], [f32::NAN, 0.0, 0.0]]);
    (readings.min_range_m, readings.max_range_m) = (0.6, Some(2.0));
    let (free, occupied) = cast_cells(&unit(), &readings);
    assert!(occupied.is_empty());
    assert_eq!(free, line(&[(0, 0, 0), (1, 0, 0), (2, 0, 0)]));
    let rays = Rays::Planar {
        angle_min_rad: 0.0,
        angle_increment_rad: std::f64::consts::FRAC_PI_2,
        ranges_m: vec![1.0, 4.0, f32::NAN, 0.1, f32::NEG_INFINITY],
        sensor_range_m: 5.0,
        free_range_m: 0.0,
    };
    let (free, occupied) = cast_cells(&unit(), &Readings { rays, ..readings });
    assert_eq!(occupied, line(&[(1, 0, 0)]));
    assert_eq!(free, line(&[(0, 0, 0), (0, 1, 0), (0, 2, 0)]));
}

#[test]
fn a_beam_without_a_return_frees_nothing_unless_it_is_known_to() {
    for no_return in [f32::INFINITY, 5.0, 6.0, f32::MAX] {
        let seen = |free_range_m, max_range_m| {
            let (angle_min_rad, angle_increment_rad) = (0.0, std::f64::consts::FRAC_PI_2);
            let ranges_m = vec![no_return, 1.0];
            let rays = Rays::Planar { angle_min_rad, angle_increment_rad, ranges_m, sensor_range_m: 5.0, free_range_m };
            cast_cells(&unit(), &Readings { pose: at([0.5; 3]), min_range_m: 0.0, max_range_m, rays })
        };
        let hit = line(&[(0, 1, 0)]);
        assert_eq!(seen(0.0, Some(5.0)), (line(&[(0, 0, 0)]), hit.clone()));
        assert_eq!(seen(2.0, None), (line(&[(0, 0, 0), (1, 0, 0), (2, 0, 0)]), hit.clone()));
        assert_eq!(seen(2.0, Some(1.0)), (line(&[(0, 0, 0), (1, 0, 0)]), hit));
    }
}

#[test]
fn the_end_of_a_ray_frees_no_cell_beside_the_end_of_another() {
    let grazed = |ends: &[[f32; 3]]| {
        let (free, occupied) = cast_cells(&unit(), &points(at([0.5; 3]), ends));
        let on_line: Vec<i32> = free.iter().filter(|(_, y, z)| (*y, *z) == (0, 0)).map(|(x, _, _)| *x).collect();
        (on_line, occupied)
    };
    let other = [10.0, 1.0, 0.0];
    // The last eight cells of a ray pass the end of another; those before do not count as grazing.
    let (free, occupied) = grazed(&[[12.0, 0.0, 0.0], other]);
    assert_eq!(free, (0..12).filter(|x| *x != 10).collect::<Vec<_>>());
    assert_eq!(occupied, line(&[(12, 0, 0), (10, 1, 0)]));
    assert_eq!(grazed(&[[19.0, 0.0, 0.0], other]).0, (0..19).collect::<Vec<_>>());
    // The cell before the end of a ray is free, but not in a corner of ends.
    assert_eq!(grazed(&[[11.0, 0.0, 0.0]]).0, (0..11).collect::<Vec<_>>());
    assert_eq!(grazed(&[[11.0, 0.0, 0.0], other]).0, (0..10).collect::<Vec<_>>());
    // A ray also grazes an end below it, in another tile.
    let (free, _) = grazed(&[[12.0, 0.0, 0.0], [10.0, 0.0, -1.0]]);
    assert_eq!(free, (0..12).filter(|x| *x != 10).collect::<Vec<_>>());
}

#[test]
fn a_pose_turns_the_rays() {
    let quarter = std::f64::consts::FRAC_PI_2;
    let turned = |axis: Vector3<f64>| Isometry3::new(Vector3::repeat(0.5), axis * quarter);
    let pose = turned(Vector3::z());
    let (_, occupied) = cast_cells(&unit(), &points(pose, &[[3.0, 1.0, 0.0]]));
    assert_eq!(occupied, line(&[(-1, 3, 0)]));
    let pose = turned(Vector3::y());
    let (_, occupied) = cast_cells(&unit(), &points(pose, &[[3.0, 0.0, 0.0]]));
    assert_eq!(occupied, line(&[(0, 0, -3)]));
}

#[test]
fn rays_are_cut_to_the_extent() {
    let extent = CellBox { min: CellIndex { x: 2, y: -1, z: 0 }, max: CellIndex { x: 5, y: 2, z: 1 } };
    let spec = GridSpec { extent: Some(extent), ..unit() };
    let ends = [[3.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [-4.0, 0.0, 0.0], [4.5, 0.0, 0.0]];
    let (free, occupied) = cast_cells(&spec, &points(at([0.5; 3]), &ends));
    assert_eq!(occupied, line(&[(3, 0, 0)]));
    assert_eq!(free, line(&[(2, 0, 0), (4, 0, 0)]));
    let (free, occupied) = cast_cells(&spec, &points(at([9.5, 0.5, 0.5]), &[[-5.0, 0.0, 0.0], [-19.0, 0.0, 0.0]]));
    assert_eq!((free, occupied), (line(&[(2, 0, 0), (3, 0, 0)]), line(&[(4, 0, 0)])));
    for far in [1e30, f64::MAX] {
        assert_eq!(cast(&spec, &points(at([far, 0.0, 0.0]), &[[1.0, 0.0, 0.0]]), LIMITS), Ok(Vec::new()));
    }
}

#[test]
fn heights_do_not_matter_in_a_flat_grid() {
    let flat = GridSpec { is_flat: true, ..unit() };
    let (free, occupied) = cast_cells(&flat, &points(at([0.5, 0.5, 40.0]), &[[2.0, 0.0, -300.0]]));
    assert_eq!((free, occupied), (line(&[(0, 0, 0), (1, 0, 0)]), line(&[(2, 0, 0)])));
}

#[test]
fn what_exceeds_a_limit_is_an_error() {
    let readings = points(at([0.5; 3]), &[[1.0, 0.0, 0.0], [500.0, 0.0, 0.0]]);
    let with = |ray_cells, cells, tiles| cast(&unit(), &readings, CastLimits { ray_cells, cells, tiles });
    assert!(with(501, 503, 63).is_ok());
    assert_eq!(with(500, 503, 63), Err(CastError::RayTooLong { ray: 1, cells: 501, max: 500 }));
    assert_eq!(with(501, 502, 63), Err(CastError::TooManyCells { max: 502 }));
    assert_eq!(with(501, 503, 62), Err(CastError::TooManyTiles { max: 62 }));
    let nothing = points(Isometry3::identity(), &[[f32::INFINITY, 0.0, 0.0]]);
    assert_eq!(cast(&unit(), &nothing, LIMITS), Ok(Vec::new()));
}

/// Whether a ray comes as near to a cell as `slack` cells.
fn touches(cell: (i32, i32, i32), start: [f64; 3], end: [f64; 3], slack: f64) -> bool {
    let low = [f64::from(cell.0), f64::from(cell.1), f64::from(cell.2)];
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for axis in 0..3 {
        let along = end[axis] - start[axis];
        let (near, far) = (low[axis] - slack - start[axis], low[axis] + 1.0 + slack - start[axis]);
        if along.abs() < 1e-12 {
            if near > 0.0 || far < 0.0 {
                return false;
            }
            continue;
        }
        let (one, other) = (near / along, far / along);
        enter = enter.max(one.min(other));
        leave = leave.min(one.max(other));
    }
    enter <= leave + 1e-9
}

proptest! {
    #[test]
    fn a_traversal_is_what_a_dense_sampler_sees(
        from in prop::array::uniform3(-6.0f64..6.0),
        along in prop::array::uniform3(-9.0f32..9.0),
        is_flat in any::<bool>(),
        extent in prop::option::of((-8i32..4, -8i32..4, -8i32..4, 1i32..14)),
    ) {
        let extent = extent.map(|(x, y, z, size)| CellBox {
            min: CellIndex { x, y, z: if is_flat { 0 } else { z } },
            max: CellIndex { x: x + size, y: y + size, z: if is_flat { 1 } else { z + size } },
        });
        let spec = spec(is_flat, extent);
        let allowed = spec.allowed();
        let (free, occupied) = cast_cells(&spec, &points(at(from), &[along]));
        let place = |share: f64| -> [f64; 3] {
            let mut place: [f64; 3] = std::array::from_fn(|axis| from[axis] + f64::from(along[axis]) * share);
            if is_flat {
                place[2] = spec.origin_m[2];
            }
            place
        };
        let in_cells = |place: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|axis| (place[axis] - spec.origin_m[axis]) / spec.resolution_m)
        };
        let end = spec.cell_at(place(1.0)).expect("near");
        let end_cell: Cells = allowed.contains(end).then_some((end.x, end.y, end.z)).into_iter().collect();
        prop_assert_eq!(&occupied, &end_cell);
        let seen: Cells = free.union(&occupied).copied().collect();
        // Every sample that lies clearly inside a cell of the extent lies in a cell that was seen.
        for sample in 0..=2000 {
            let place = place(f64::from(sample) / 2000.0);
            let cell = spec.cell_at(place).expect("near");
            let is_inside = in_cells(place).iter().take(if is_flat { 2 } else { 3 }).all(|along| {
                (1e-6..1.0 - 1e-6).contains(&(along - along.floor()))
            });
            if is_inside && allowed.contains(cell) {
                prop_assert!(seen.contains(&(cell.x, cell.y, cell.z)), "{cell:?} was passed");
            }
        }
        // No other cell was seen.
        for &cell in &seen {
            let is_allowed = allowed.contains(CellIndex { x: cell.0, y: cell.1, z: cell.2 });
            prop_assert!(is_allowed);
            prop_assert!(touches(cell, in_cells(place(0.0)), in_cells(place(1.0)), 1e-6), "{cell:?} was not passed");
        }
    }
}

/// The one free line of a ray along a diagonal, from a cell's middle, as far as it is allowed.
fn diagonal(from: [i32; 3], step: [i32; 3], allowed: &CellBox) -> Vec<[i32; 3]> {
    let mut at = from;
    let mut cells = Vec::new();
    while allowed.contains(CellIndex { x: at[0], y: at[1], z: at[2] }) {
        cells.push(at);
        at = std::array::from_fn(|axis| at[axis] + step[axis]);
    }
    cells
}

/// Checks that a ray passes the cells of a diagonal and otherwise only neighbours that share a corner with it.
#[track_caller]
fn check_diagonal(spec: &GridSpec, readings: &Readings, from: [i32; 3], step: [i32; 3]) {
    let allowed = spec.allowed();
    let (free, occupied) = cast_cells(spec, readings);
    assert!(occupied.is_empty());
    let expected = diagonal(from, step, &allowed);
    for at in &expected {
        assert!(free.contains(&(at[0], at[1], at[2])), "{at:?} was passed");
    }
    for &(x, y, z) in &free {
        assert!(allowed.contains(CellIndex { x, y, z }), "{x} {y} {z} is outside");
        let steps = |to: i32, axis: usize| (to - from[axis]) * step[axis];
        let along: Vec<i32> = [x, y, z]
            .into_iter()
            .enumerate()
            .filter(|(axis, _)| step[*axis] != 0)
            .map(|(axis, to)| steps(to, axis))
            .collect();
        let (nearest, farthest) = (along.iter().min().expect("an axis"), along.iter().max().expect("an axis"));
        assert!(*nearest >= 0 && farthest - nearest <= 1, "{x} {y} {z} is not on the way");
    }
}

const DIAGONALS: [[i32; 3]; 6] = [[1, 1, 1], [-1, -1, -1], [1, -1, 1], [-1, 1, 0], [0, -1, -1], [0, 0, 1]];

#[test]
fn very_distant_ends_leave_the_ray_where_it_is() {
    let extent = CellBox { min: CellIndex { x: -20, y: -13, z: -9 }, max: CellIndex { x: 31, y: 17, z: 11 } };
    let limit = TILE_LIMIT * TILE_EDGE;
    for far in [1e18f32, 1e30, f32::MAX] {
        for step in DIAGONALS {
            let end: [f32; 3] = std::array::from_fn(|axis| far * step[axis] as f32);
            let within = GridSpec { extent: Some(extent), ..unit() };
            check_diagonal(&within, &points(at([0.5; 3]), &[end]), [0; 3], step);
            // Near the border of all indices, without an extent.
            let from: [i32; 3] = std::array::from_fn(|axis| if step[axis] < 0 { 100 - limit } else { limit - 100 });
            let place = from.map(|cell| f64::from(cell) + 0.5);
            check_diagonal(&unit(), &points(at(place), &[end]), from, step);
        }
    }
}

#[test]
fn planar_scans_may_believe_very_far() {
    let extent = CellBox { min: CellIndex { x: -40, y: -40, z: -1 }, max: CellIndex { x: 40, y: 40, z: 1 } };
    let spec = GridSpec { extent: Some(extent), ..unit() };
    for (max, turn) in [(1e18f32, 1), (1e30, 3), (f32::MAX, 5), (f32::MAX, 7)] {
        let angle_min_rad = f64::from(turn) * std::f64::consts::FRAC_PI_4;
        let rays = Rays::Planar {
            angle_min_rad,
            angle_increment_rad: 0.0,
            ranges_m: vec![f32::INFINITY],
            sensor_range_m: 1.0,
            free_range_m: max,
        };
        let readings = Readings { pose: at([0.5; 3]), min_range_m: 0.0, max_range_m: Some(max), rays };
        let sign = |along: f64| if along > 0.0 { 1 } else { -1 };
        check_diagonal(&spec, &readings, [0; 3], [sign(angle_min_rad.cos()), sign(angle_min_rad.sin()), 0]);
    }
}

#[test]
fn rays_from_very_far_stay_within_the_extent() {
    let extent = CellBox { min: CellIndex { x: -20, y: -13, z: -9 }, max: CellIndex { x: 31, y: 17, z: 11 } };
    let spec = GridSpec { extent: Some(extent), ..unit() };
    for far in [1e9, 1e18, 1e30] {
        for step in DIAGONALS {
            let from: [f64; 3] = std::array::from_fn(|axis| 0.5 - far * f64::from(step[axis]));
            let end: [f32; 3] = std::array::from_fn(|axis| (2.0 * far) as f32 * step[axis] as f32);
            let (free, occupied) = cast_cells(&spec, &points(at(from), &[end]));
            assert!(occupied.is_empty());
            assert!(free.iter().all(|&(x, y, z)| extent.contains(CellIndex { x, y, z })));
        }
    }
}
