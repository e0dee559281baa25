//! The hall whose walls are known: its scans agree with its plan, and its robot drifts as far as the options allow.
//!
//! Invariant: expected cells are computed here from measured ranges, never by the hall.

use std::collections::{HashMap, HashSet};

use tidemap_sim::{Hall, HallOptions, HallPose, HallScan, HallScore, HallThing, TableScore};

/// Patrols of a working day that between them see the hall with and without the table.
const PATROLS: [u32; 6] = [2, 9, 12, 14, 20, 28];

fn hall(options: HallOptions) -> Hall {
    Hall::new(options).expect("a zone of the database")
}

fn scans(hall: &Hall) -> Vec<HallScan> {
    PATROLS.iter().flat_map(|&patrol| hall.patrol(0, patrol)).collect()
}

/// The measured end of each beam, seen from a pose.
fn ends(scan: &HallScan, pose: HallPose) -> impl Iterator<Item = [f64; 2]> + '_ {
    (0..).zip(&scan.ranges_m).filter(|(_, range)| range.is_finite()).map(move |(beam, range)| {
        let angle = pose.yaw_rad + scan.scanner.angle_min_rad + f64::from(beam) * scan.angle_increment_rad;
        [pose.place_m[0] + range * angle.cos(), pose.place_m[1] + range * angle.sin()]
    })
}

fn cell(place: [f64; 2]) -> [i32; 2] {
    place.map(|along| (along / 0.1).floor() as i32)
}

#[test]
fn ends_of_beams_from_true_poses_cover_the_walls_that_are_visible() {
    let hall = hall(HallOptions::default());
    let (mut truth, mut counts) = (hall.truth(), HashMap::<[i32; 2], u32>::new());
    for scan in scans(&hall) {
        truth.note(&scan);
        for end in ends(&scan, scan.true_pose) {
            *counts.entry(cell(end)).or_default() += 1;
        }
    }
    let is_wall = |thing: Option<HallThing>| thing.is_some_and(|thing| thing != HallThing::Table);
    let visible: Vec<_> = truth.cells().iter().filter(|cell| is_wall(cell.thing) && cell.ends >= 3).collect();
    let covered = visible.iter().filter(|cell| counts.contains_key(&cell.index)).count();
    assert!(visible.len() > 1_500, "{} cells of walls", visible.len());
    assert!(covered * 100 > visible.len() * 98, "{covered} of {}", visible.len());
    // Every kind of thing is seen, and no end is farther from all things than the noise of a range.
    let score = HallScore::new(&truth, |index| counts.get(&index).map(|_| 1.0));
    assert!(score.walls.iter().all(|(_, share)| share.among >= 20 && share.share() > 0.98), "{score}");
    assert_eq!((score.false_walls.found, score.hidden_walls), (0, 0), "{score}");
    assert!(score.false_walls.among > 30_000, "{score}");
    let table = TableScore::new(&truth, |index| counts.get(&index).map(|_| 1.0));
    assert!(table.occupied.among >= 40 && table.occupied.share() > 0.98, "{table:?}");
}

#[test]
fn ends_of_beams_from_poses_that_are_far_off_are_false_walls() {
    let hall = hall(HallOptions { drift_m: 0.8, stops: 30, ..HallOptions::default() });
    let mut truth = hall.truth();
    let mut occupied = HashSet::new();
    for scan in scans(&hall) {
        truth.note(&scan);
        occupied.extend(ends(&scan, scan.reported_pose).map(cell));
    }
    let score = HallScore::new(&truth, |index| occupied.contains(&index).then_some(1.0));
    assert!(score.false_walls.share() > 0.01 && score.hidden_walls > 0, "{score}");
    // A grid that is unknown everywhere has neither walls nor free cells.
    let unknown = HallScore::new(&truth, |_| None);
    assert_eq!((unknown.recall().found, unknown.false_walls.found, unknown.free.found), (0, 0, 0), "{unknown}");
}

#[test]
fn scanners_see_the_things_at_their_height_and_dark_walls_return_few_beams() {
    let hall = hall(HallOptions { noise_m: 0.0, ..HallOptions::default() });
    let (mut lost, mut by_scanner) = (HashMap::<bool, u32>::new(), HashMap::<&str, HashSet<&str>>::new());
    let truth = hall.truth();
    for scan in scans(&hall) {
        let things = scan.ends.iter().flatten().filter_map(|&end| truth.cell_at(end)?.thing);
        by_scanner.entry(scan.scanner.name).or_default().extend(things.map(HallThing::name));
        for range in &scan.ranges_m {
            *lost.entry(range.is_infinite()).or_default() += 1;
        }
    }
    let (low, high) = (&by_scanner["low"], &by_scanner["high"]);
    assert!(low.contains("low_shelf") && low.contains("table") && high.contains("high_board"));
    assert!(!low.contains("high_board") && !high.contains("low_shelf") && !high.contains("table"), "{high:?}");
    assert!(lost[&true] * 50 > lost[&false] && lost[&true] < lost[&false], "{lost:?}");
}

#[test]
fn the_table_stands_from_nine_to_twelve_on_working_days() {
    let hall = hall(HallOptions { stops: 8, beams: 4, ..HallOptions::default() });
    for (day, is_working) in [(0, true), (4, true), (5, false), (6, false), (28, true)] {
        assert_eq!((hall.is_working_day(day), hall.patrols(day)), (is_working, if is_working { 34 } else { 24 }));
        let (from, to) = (hall.utc_nanos(day, 9 * 60), hall.utc_nanos(day, 12 * 60));
        let mut last = i64::MIN;
        for scan in (0..hall.patrols(day)).flat_map(|patrol| hall.patrol(day, patrol)) {
            assert_eq!(scan.has_table, is_working && (from..to).contains(&scan.utc_nanos), "day {day}");
            assert!(scan.utc_nanos > last, "day {day}");
            last = scan.utc_nanos;
        }
    }
}

#[test]
fn reported_poses_drift_slowly_and_not_beyond_the_maximum() {
    let hall = hall(HallOptions { beams: 1, ..HallOptions::default() });
    let (mut greatest, mut last) = (0.0_f64, None::<[f64; 2]>);
    for scan in (0..34).flat_map(|patrol| hall.patrol(0, patrol)).filter(|scan| scan.scanner.name == "low") {
        let apart = [0, 1].map(|axis| scan.reported_pose.place_m[axis] - scan.true_pose.place_m[axis]);
        let length = |[x, y]: [f64; 2]| (x * x + y * y).sqrt();
        assert!(length(apart) <= 0.1 + 1e-12, "{apart:?}");
        assert!((scan.reported_pose.yaw_rad - scan.true_pose.yaw_rad).abs() <= 0.003 + 1e-12);
        greatest = greatest.max(length(apart));
        if let Some(last) = last.replace(apart).filter(|_| scan.true_pose.place_m[1] > 18.0) {
            assert!(length([0, 1].map(|axis| apart[axis] - last[axis])) < 0.09, "from {last:?} to {apart:?}");
        }
    }
    assert!(greatest > 0.08, "{greatest}");
}

#[test]
fn patrols_depend_on_their_seed_and_number_only() {
    let scans = |seed, patrol| hall(HallOptions { seed, stops: 3, ..HallOptions::default() }).patrol(1, patrol);
    assert_eq!(scans(1, 5), scans(1, 5));
    assert_ne!(scans(1, 5)[0].ranges_m, scans(2, 5)[0].ranges_m);
    assert_ne!(scans(1, 5)[0].ranges_m, scans(1, 6)[0].ranges_m);
}
