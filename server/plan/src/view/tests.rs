//! Views against an oracle that tests every ray against every cell of the region.

use std::{
    collections::BTreeMap,
    ops::ControlFlow,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
};

use proptest::prelude::*;
use tidemap_grid::index::{CellBox, CellIndex};
use tidemap_model::{EarlyStop, StopSignal};

use super::{fan::directions, *};
use crate::{
    information::Certainty,
    predicted::{Lattice, PredictedGrid, PredictedTimes, tests::spec},
};

fn cell(x: i32, y: i32, z: i32) -> CellIndex {
    CellIndex { x, y, z }
}

fn lattice(size: [i32; 3], is_flat: bool) -> Arc<Lattice> {
    let min = cell(-3, 5, if is_flat { 0 } else { -2 });
    let max = cell(min.x + size[0], min.y + size[1], min.z + if is_flat { 1 } else { size[2] });
    Arc::new(Lattice::new(&spec(is_flat), CellBox { min, max }, 1 << 20).unwrap())
}

/// A pseudo-random number in [0, 1) for each seed.
fn dice(seed: u64) -> f64 {
    let mut x = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((x ^ (x >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Most cells are free; some are unknown, occupied, or in between.
fn probability(seed: u64, at: CellIndex) -> Option<f32> {
    let value = |salt: u64| {
        let place = (at.x as u64) << 40 ^ (at.y as u64 & 0xff_ffff) << 16 ^ (at.z as u64 & 0xffff);
        dice(place ^ seed.wrapping_mul(0x2545_f491_4f6c_dd1d) ^ salt << 56)
    };
    match value(1) {
        0.0..0.1 => None,
        0.1..0.6 => Some(0.0),
        0.6..0.65 => Some(0.5),
        0.65..0.7 => Some(1.0),
        _ => Some((value(2) * 0.6) as f32),
    }
}

/// Distances along a ray, from the centre of the cell `from`, at which it enters and leaves a cell along an axis.
fn slab(along: f64, distance: i32) -> Option<(f64, f64)> {
    if along == 0.0 {
        return (distance == 0).then_some((f64::NEG_INFINITY, f64::INFINITY));
    }
    let ahead = f64::from(distance) * along.signum();
    if ahead < 0.0 {
        return None;
    }
    let enter = if ahead == 0.0 { f64::NEG_INFINITY } else { (ahead - 0.5) / along.abs() };
    Some((enter, (ahead + 0.5) / along.abs()))
}

/// Whether, and where, a ray enters a cell; at an exact edge, it crosses along x first, then y, then z.
fn enters(direction: [f64; 3], away: [i32; 3]) -> Option<(f64, usize)> {
    let mut slabs = [(0.0, 0.0); 3];
    for axis in 0..3 {
        slabs[axis] = slab(direction[axis], away[axis])?;
    }
    for one in 0..3 {
        for other in 0..3 {
            let (enter, exit) = (slabs[one].0, slabs[other].1);
            if one != other && (enter > exit || (enter == exit && one > other)) {
                return None;
            }
        }
    }
    let last = (0..3).max_by(|&one, &other| slabs[one].0.total_cmp(&slabs[other].0).then(one.cmp(&other)))?;
    Some((slabs[last].0, last))
}

/// The visible cells with their information.
fn oracle(grid: &PredictedGrid, sensor: &Sensor, from: CellIndex, yaw: f64) -> BTreeMap<CellIndex, f64> {
    let lattice = grid.lattice();
    let range = sensor.range_m / lattice.resolution_m();
    let CellBox { min, max } = lattice.region();
    let mut seen = BTreeMap::new();
    for direction in directions(sensor, lattice, yaw) {
        let mut passed: Vec<((f64, usize), CellIndex)> = Vec::new();
        for z in min.z..max.z {
            for y in min.y..max.y {
                for x in min.x..max.x {
                    let away = [x - from.x, y - from.y, z - from.z];
                    if let Some(enter) = enters(direction, away).filter(|(enter, _)| *enter < range) {
                        passed.push((enter, cell(x, y, z)));
                    }
                }
            }
        }
        passed.sort_by(|(one, _), (other, _)| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)));
        for (_, at) in passed {
            let p = grid.probability(at).map_or(0.5, f64::from);
            seen.insert(at, Certainty::default().bits(p));
            if p > 0.5 {
                break;
            }
        }
    }
    seen
}

fn scene(grid: &PredictedGrid) -> Scene {
    Scene::new(grid, &SceneOptions::default()).unwrap()
}

/// A reported result of [`view_many`].
type ReportedViews = Vec<(usize, Result<Vec<Option<f64>>, ViewError>)>;

fn view_all(scene: &TimedScene, sensor: &Sensor, viewpoints: &[Viewpoint]) -> ReportedViews {
    let mut all = Vec::new();
    let outcome = view_many(scene, sensor, viewpoints, ViewLimits::default(), StopSignal::NEVER, |number, view| {
        all.push((number, view));
        ControlFlow::Continue(())
    });
    outcome.unwrap();
    all
}

fn centre(lattice: &Lattice, at: CellIndex, yaw_rad: f64) -> Viewpoint {
    let [x_m, y_m, z_m] = lattice.centre_m(at);
    Viewpoint { x_m, y_m, z_m: Some(z_m), yaw_rad }
}

prop_compose! {
    fn sensors()(
        range in 0.05_f64..1.4,
        whole in any::<bool>(),
        part in 0.05_f64..6.0,
        height in 0.05_f64..=std::f64::consts::PI,
    ) -> Sensor {
        let horizontal_fov_rad = if whole { std::f64::consts::TAU } else { part };
        Sensor { range_m: range, horizontal_fov_rad, vertical_fov_rad: height, height_m: 0.0 }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn a_group_sees_what_each_of_its_viewpoints_sees_in_the_same_order(
        sensor in sensors(),
        seed in any::<u64>(),
        size in (1_i32..14, 1_i32..14, 1_i32..8),
        is_flat in any::<bool>(),
        viewpoints in proptest::collection::vec((-1_i32..15, -1_i32..15, -1_i32..9), 0..70),
        yaw in -4.0_f64..4.0,
    ) {
        let lattice = lattice(size.into(), is_flat);
        let times = PredictedTimes::from_fn(Arc::clone(&lattice), 1, |at, _| probability(seed, at)).unwrap();
        let scene = scene(&times.at(0).unwrap());
        let fan = Fan::new(&sensor, &lattice, yaw).unwrap();
        let min = lattice.region().min;
        let from: Vec<CellIndex> = viewpoints.iter().map(|&(x, y, z)| cell(min.x + x, min.y + y, min.z + z)).collect();
        let (mut single, mut group) = (ViewScorer::new(&fan), GroupScorer::default());
        // The test runs twice, because the memory is used again.
        for _ in 0..2 {
            let mut seen = vec![Vec::new(); from.len()];
            group.each(&scene, &fan, &from, StopSignal::NEVER, |number, place| seen[number].extend(lattice.cell(place)));
            for (number, (seen, &from)) in seen.iter().zip(&from).enumerate() {
                let expected = if number < GROUP_MAX { single.cells(&scene, &fan, from) } else { Vec::new() };
                prop_assert_eq!(seen, &expected);
            }
        }
    }

    #[test]
    fn the_same_cells_are_seen_as_by_the_oracle(
        sensor in sensors(),
        seed in any::<u64>(),
        size in (1_i32..14, 1_i32..14, 1_i32..8),
        is_flat in any::<bool>(),
        place in (0.0_f64..1.0, 0.0_f64..1.0, 0.0_f64..1.0),
        yaw in -7.0_f64..7.0,
    ) {
        let lattice = lattice([size.0, size.1, size.2], is_flat);
        let CellBox { min, .. } = lattice.region();
        let along = |min: i32, part: f64, size: usize| min + (part * size as f64) as i32;
        let [sx, sy, sz] = lattice.size();
        let from = cell(along(min.x, place.0, sx), along(min.y, place.1, sy), along(min.z, place.2, sz));
        let free = |at| if at == from { Some(0.2) } else { probability(seed, at) };
        let grid = PredictedGrid::from_fn(Arc::clone(&lattice), free);
        let (scene, fan) = (scene(&grid), Fan::new(&sensor, &lattice, yaw).unwrap());
        let expected = oracle(&grid, &sensor, from, yaw);
        let mut scorer = ViewScorer::new(&fan);
        for _ in 0..2 {
            let mut cells = scorer.cells(&scene, &fan, from);
            cells.sort();
            prop_assert_eq!(&cells, &expected.keys().copied().collect::<Vec<_>>());
            let seen = scorer.view(&scene, &fan, from);
            prop_assert_eq!(seen.cells, expected.len() as u64);
            prop_assert!((seen.information_bits - expected.values().sum::<f64>()).abs() < 1e-9);
        }
    }

    #[test]
    fn many_times_give_the_answers_of_each_alone(
        sensor in sensors(),
        seed in any::<u64>(),
        is_flat in any::<bool>(),
        times in prop_oneof![1_usize..6, 120_usize..140, Just(128_usize), Just(256_usize)],
        yaws in prop::collection::vec(-3.0_f64..3.0, 1..4),
    ) {
        let lattice = lattice([13, 11, 5], is_flat);
        // Some cells appear and disappear, some grow more probable, some never change.
        let at_time = |at: CellIndex, time: usize| {
            let kind = dice(seed ^ (at.x as u64) << 30 ^ (at.y as u64 & 0xffff) << 12 ^ (at.z as u64 & 0xfff));
            match kind {
                0.0..0.2 => Some(f32::from(u8::from(dice(seed ^ time as u64 ^ (kind * 1e9) as u64) < 0.4))),
                0.2..0.3 => Some(time as f32 / 300.0),
                0.3..0.32 => Some(0.6 + time as f32 / 1000.0),
                _ => probability(seed, at),
            }
        };
        let day = PredictedTimes::from_fn(Arc::clone(&lattice), times, at_time).unwrap();
        let timed = TimedScene::new(&day, &SceneOptions::default(), StopSignal::NEVER).unwrap();
        let CellBox { min, .. } = lattice.region();
        let viewpoints: Vec<Viewpoint> = yaws
            .iter()
            .enumerate()
            .map(|(number, &yaw)| centre(&lattice, cell(min.x + 4 * number as i32, min.y + 3 * number as i32, min.z), yaw))
            .collect();
        let all = view_all(&timed, &sensor, &viewpoints);
        prop_assert_eq!(all.len(), viewpoints.len());
        let scenes: Vec<Scene> = (0..times).map(|time| scene(&day.at(time).unwrap())).collect();
        for ((number, view), at) in all.iter().zip(&viewpoints) {
            let fan = Fan::new(&sensor, &lattice, at.yaw_rad).unwrap();
            let mut scorer = ViewScorer::new(&fan);
            for (time, scene) in scenes.iter().enumerate() {
                let bits = view.as_ref().ok().and_then(|bits| bits[time]);
                match scene.stand(&sensor, at) {
                    Err(_) => prop_assert_eq!(bits, None),
                    Ok(from) => {
                        let alone = scorer.view(scene, &fan, from).information_bits;
                        let bits = bits.unwrap();
                        prop_assert!((bits - alone).abs() < 1e-9, "view {} time {}: {} {}", number, time, bits, alone);
                    }
                }
            }
        }
    }
}

fn hall() -> (Arc<Lattice>, PredictedGrid) {
    let lattice = lattice([30, 30, 6], false);
    let grid = PredictedGrid::from_fn(Arc::clone(&lattice), |at| Some(if at.x == 10 { 1.0 } else { 0.5 }));
    (lattice, grid)
}

#[test]
fn a_wall_is_seen_and_nothing_behind_it() {
    let (lattice, grid) = hall();
    let sensor = Sensor { range_m: 2.0, ..Sensor::default() };
    let (scene, fan) = (scene(&grid), Fan::new(&sensor, &lattice, 0.0).unwrap());
    let cells = ViewScorer::new(&fan).cells(&scene, &fan, cell(5, 15, 0));
    assert!(cells.iter().any(|at| at.x == 10));
    assert!(cells.iter().all(|at| at.x <= 10));
    assert!(cells.contains(&cell(5, 15, 0)));
}

#[test]
fn a_part_of_the_view_shows_a_part_of_the_cells() {
    let (lattice, grid) = hall();
    let scene = scene(&grid);
    let whole = Sensor { range_m: 2.0, ..Sensor::default() };
    let part = Sensor { horizontal_fov_rad: 1.0, ..whole };
    let from = cell(5, 15, 0);
    let cells = |sensor: &Sensor, yaw: f64| {
        let fan = Fan::new(sensor, &lattice, yaw).unwrap();
        let mut cells = ViewScorer::new(&fan).cells(&scene, &fan, from);
        cells.sort();
        cells
    };
    assert_eq!(cells(&whole, 0.0), cells(&whole, 2.0));
    let ahead = cells(&part, std::f64::consts::PI);
    assert!(ahead.iter().all(|at| at.x <= from.x) && ahead.len() < cells(&whole, 0.0).len());
}

#[test]
fn a_bad_viewpoint_costs_the_others_nothing() {
    let (lattice, grid) = hall();
    let day = PredictedTimes::from_fn(Arc::clone(&lattice), 2, |at, _| grid.probability(at)).unwrap();
    let timed = TimedScene::new(&day, &SceneOptions::default(), StopSignal::NEVER).unwrap();
    let sensor = Sensor { range_m: 1.0, height_m: 0.25, ..Sensor::default() };
    let good = centre(&lattice, cell(5, 15, 0), 0.0);
    let viewpoints = [
        good,
        Viewpoint { x_m: f64::NAN, ..good },
        Viewpoint { yaw_rad: f64::INFINITY, ..good },
        Viewpoint { x_m: 1e300, ..good },
        Viewpoint { z_m: Some(100.0), ..good },
        centre(&lattice, cell(10, 15, 0), 0.0),
        Viewpoint { z_m: None, ..good },
    ];
    let all = view_all(&timed, &sensor, &viewpoints);
    let numbers: Vec<usize> = all.iter().map(|(number, _)| *number).collect();
    assert_eq!(numbers, [0, 1, 2, 3, 4, 5, 6]);
    let fan = Fan::new(&sensor, &lattice, 0.0).unwrap();
    let alone = ViewScorer::new(&fan).view(&scene(&grid), &fan, cell(5, 15, 0)).information_bits;
    assert!((all[0].1.as_ref().unwrap()[1].unwrap() - alone).abs() < 1e-9);
    assert!(matches!(all[1].1, Err(ViewError::NotFinite(_))));
    assert!(matches!(all[2].1, Err(ViewError::NotFinite(_))));
    assert!(matches!(all[3].1, Err(ViewError::Outside { .. })));
    assert!(matches!(all[4].1, Err(ViewError::Outside { .. })));
    assert!(all[5].1.as_ref().unwrap_err().to_string().contains("(10, 15, 0)"));
    assert_eq!(all[6].1, all[0].1);
}

#[test]
fn the_receiver_of_views_can_end_the_work() {
    let (lattice, grid) = hall();
    let day = PredictedTimes::from_fn(Arc::clone(&lattice), 1, |at, _| grid.probability(at)).unwrap();
    let timed = TimedScene::new(&day, &SceneOptions::default(), StopSignal::NEVER).unwrap();
    let sensor = Sensor { range_m: 0.3, ..Sensor::default() };
    let viewpoints = vec![centre(&lattice, cell(5, 15, 0), 0.0); 9];
    let mut reported = 0;
    let answer = view_many(&timed, &sensor, &viewpoints, ViewLimits::default(), StopSignal::NEVER, |_, _| {
        reported += 1;
        if reported == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    assert_eq!((answer, reported), (Ok(()), 3));
}

#[test]
fn views_that_should_stop_end_soon_and_are_not_reported() {
    let (lattice, grid) = hall();
    let day = PredictedTimes::from_fn(Arc::clone(&lattice), 2, |at, _| grid.probability(at)).unwrap();
    let calls = AtomicUsize::new(0);
    let is_set = || calls.fetch_add(1, Ordering::Relaxed) >= 100;
    let stop = StopSignal::new(&is_set);
    let sensor = Sensor { range_m: 0.3, ..Sensor::default() };
    let viewpoints = vec![centre(&lattice, cell(5, 15, 0), 0.0); 1_000];
    let timed = TimedScene::new(&day, &SceneOptions::default(), StopSignal::NEVER).unwrap();
    let mut reported = 0;
    let answer = view_many(&timed, &sensor, &viewpoints, ViewLimits::default(), stop, |_, _| {
        reported += 1;
        ControlFlow::Continue(())
    });
    assert_eq!(answer, Err(TooMuchWork::Stop(EarlyStop)));
    assert!(reported < 128 && calls.load(Ordering::Relaxed) < 400, "{reported}");
    assert_eq!(TimedScene::new(&day, &SceneOptions::default(), stop).map(|_| ()), Err(SceneError::Stop(EarlyStop)));
}

#[test]
fn what_costs_too_much_is_refused_before_it_begins() {
    let (lattice, grid) = hall();
    let day = PredictedTimes::from_fn(Arc::clone(&lattice), 4, |at, _| grid.probability(at)).unwrap();
    let timed = TimedScene::new(&day, &SceneOptions::default(), StopSignal::NEVER).unwrap();
    let viewpoints = vec![centre(&lattice, cell(5, 15, 0), 0.0); 100];
    let limits = ViewLimits { max_work: 10_000 };
    let answer = view_many(&timed, &Sensor::default(), &viewpoints, limits, StopSignal::NEVER, |_, _| unreachable!());
    assert!(answer.unwrap_err().to_string().starts_with("100 views at 4 times"));
}

#[test]
fn wrong_sensors_are_refused_with_the_value() {
    let (lattice, _) = hall();
    let good = Sensor::default();
    for (wrong, word) in [
        (Sensor { range_m: 0.0, ..good }, "range 0"),
        (Sensor { range_m: -1.0, ..good }, "range -1"),
        (Sensor { range_m: f64::NAN, ..good }, "range NaN"),
        (Sensor { range_m: f64::INFINITY, ..good }, "range inf"),
        (Sensor { range_m: 1e6, ..good }, "at most 409.6"),
        (Sensor { horizontal_fov_rad: 0.0, ..good }, "field of view 0"),
        (Sensor { horizontal_fov_rad: f64::NAN, ..good }, "field of view NaN"),
        (Sensor { vertical_fov_rad: -0.1, ..good }, "field of view -0.1"),
        (Sensor { vertical_fov_rad: 4.0, ..good }, "at most π"),
        (Sensor { height_m: f64::NAN, ..good }, "height NaN"),
        (Sensor { range_m: 400.0, ..good }, "shorten its range"),
    ] {
        let error = Fan::new(&wrong, &lattice, 0.0).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
    }
    let (_, grid) = hall();
    for threshold in [-0.1, 1.1, f64::NAN] {
        let options = SceneOptions { threshold, ..SceneOptions::default() };
        assert!(Scene::new(&grid, &options).unwrap_err().to_string().contains("between 0 and 1"));
    }
}

#[test]
fn neighbouring_rays_are_at_most_one_cell_apart_at_full_range() {
    for is_flat in [false, true] {
        let lattice = lattice([60, 60, 30], is_flat);
        let sensor = Sensor { range_m: 1.5, vertical_fov_rad: 3.0, ..Sensor::default() };
        let rays = directions(&sensor, &lattice, 0.0);
        let apart = |one: &[f64; 3], other: &[f64; 3]| {
            let square: f64 = one.iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum();
            square.sqrt() * 15.0
        };
        for pair in rays.windows(2).filter(|pair| pair[0][2] == pair[1][2]) {
            assert!(apart(&pair[0], &pair[1]) <= 1.0 + 1e-9);
        }
        // The first ray of each row points straight behind.
        let first: Vec<[f64; 3]> = rays.chunk_by(|one, next| one[2] == next[2]).map(|row| row[0]).collect();
        assert!(first.windows(2).all(|pair| apart(&pair[0], &pair[1]) <= 1.0 + 1e-9));
        assert_eq!(first.len(), if is_flat { 1 } else { 46 });
    }
}
