//! Beams at their own times, in the forms in which drivers write them.

use std::f64::consts::FRAC_PI_2;

use super::*;

/// A robot at (0.05, 0.05) that turns by a quarter in the second after second 1, and then drives along y.
fn turning() -> Recorded {
    let places = [[0.05, 0.05, 0.0], [0.05, 0.05, FRAC_PI_2], [0.05, 1.05, FRAC_PI_2]];
    (1..)
        .zip(places)
        .map(|(second, place)| {
            let stamp = second * SECOND;
            ("/tf", TF, stamp, transform(stamp, ("odom", "laser"), place))
        })
        .collect()
}

#[track_caller]
fn check(result: &Converted, wanted: &[[f64; 2]]) {
    let ends = ends(&result.made[0]);
    assert_eq!(ends.len(), wanted.len(), "{ends:?}");
    for (end, [x, y]) in ends.iter().zip(wanted) {
        assert!((end.x - x).abs() < 2e-3 && (end.y - y).abs() < 2e-3 && end.z.abs() < 1e-6, "{ends:?}");
    }
}

fn scan(stamp: i64, time_increment: f32, ranges: &[f32]) -> Vec<u8> {
    ScanText { stamp, frame: "laser", increments: [0.0, time_increment], limits: [0.1, 10.0], ranges }.bytes()
}

#[test]
fn each_beam_of_a_scan_ends_where_the_sensor_pointed_at_its_time() {
    let nothing = f32::INFINITY;
    for (stamp, increment, ranges, wanted) in [
        (SECOND, 0.5, [3.0, 3.0], [[3.05, 0.05], [2.1713, 2.1713]]),
        (2 * SECOND, 0.5, [3.0, 3.0], [[0.05, 3.05], [0.05, 3.55]]),
        (2 * SECOND, -0.5, [3.0, 3.0], [[0.05, 3.05], [2.1713, 2.1713]]),
    ] {
        let mut recorded = turning();
        recorded.push(("/scan", SCAN, stamp, scan(stamp, increment, &ranges)));
        check(&usual(&recorded), &wanted);
    }
    let mut recorded = turning();
    let many: Vec<f32> = (0..1000).map(|ray| if ray == 0 || ray == 999 { 3.0 } else { nothing }).collect();
    recorded.push(("/scan", SCAN, SECOND, scan(SECOND, 0.001, &many)));
    let result = usual(&recorded);
    check(&result, &[[3.05, 0.05], [0.05, 3.05]].map(|[x, y]| if x > 1.0 { [x, y] } else { [0.0547, y] }));
    assert_eq!(result.converter.beams()[&1].without_return, 998);
    let options = ConvertOptions { at_header: true, ..ConvertOptions::default() };
    check(&converted(&recorded, &Wishes::default(), options), &[[3.05, 0.05], [3.05, 0.05]]);
}

#[test]
fn a_scan_whose_times_cannot_be_is_placed_at_its_stamp_and_counted() {
    for increment in [0.51, f32::NAN, f32::INFINITY, -7.0] {
        let mut recorded = turning();
        recorded.push(("/scan", SCAN, SECOND, scan(SECOND, increment, &[3.0, 3.0])));
        let result = usual(&recorded);
        check(&result, &[[3.05, 0.05], [3.05, 0.05]]);
        let notices = result.converter.beams()[&1].notices();
        assert!(notices[0].starts_with("1 messages have times of beams that are not within"), "{notices:?}");
    }
}

#[test]
fn a_sensor_that_stands_still_gives_a_scan_of_ranges() {
    let mut recorded = turning();
    recorded.truncate(1);
    recorded.push(("/tf", TF, 3 * SECOND, transform(3 * SECOND, ("odom", "laser"), [0.05, 0.05, 0.0])));
    recorded.push(("/scan", SCAN, SECOND, scan(SECOND, 0.25, &[3.0, 3.0])));
    let result = usual(&recorded);
    assert!(matches!(&result.made[0], Ok(Item { made: Made::Scan(_), .. })), "{:?}", result.made);
}

#[test]
fn a_scan_that_ends_after_the_last_transform_has_no_place() {
    let mut recorded = turning();
    recorded.push(("/scan", SCAN, 3 * SECOND, scan(3 * SECOND, 0.25, &[3.0, 3.0])));
    assert!(matches!(&usual(&recorded).made[..], [Err(NotMade::NoTransform(FrameError::After { .. }))]));
}

/// The number types of fields.
const INT32: u8 = 5;
const UINT32: u8 = 6;
const FLOAT: u8 = 7;
const DOUBLE: u8 = 8;

#[test]
fn each_point_of_a_cloud_ends_where_the_sensor_was_at_its_time() {
    // Real stamps: a second is a small part of them.
    let epoch = 1_700_000_000 * SECOND;
    let point = [3.0, 0.0, 0.0_f32];
    let wanted = [[3.05, 0.05], [2.1713, 2.1713]];
    let float = |number: f32| number.to_le_bytes().to_vec();
    let double = |number: f64| number.to_le_bytes().to_vec();
    let whole = |number: u32| number.to_le_bytes().to_vec();
    let seconds = 1_700_000_001.0;
    for (name, kind, first, last) in [
        ("t", UINT32, whole(0), whole(500_000_000)),
        ("time", FLOAT, float(0.0), float(0.5)),
        ("timestamp", DOUBLE, double(seconds), double(seconds + 0.5)),
        ("timestamp", DOUBLE, double(seconds * 1e9), double((seconds + 0.5) * 1e9)),
        ("timestamp", DOUBLE, double(seconds * 1e6), double((seconds + 0.5) * 1e6)),
        ("offset_time", UINT32, whole(0), whole(500_000_000)),
        ("time_offset_ns", INT32, whole(0), whole(500_000_000)),
        ("t", FLOAT, float(0.0), float(5e8)),
    ] {
        let mut recorded: Recorded = turning();
        for (_, _, recorded_nanos, data) in &mut recorded {
            *recorded_nanos += epoch;
            // The seconds stand behind the header of CDR and the number of transforms.
            let second = u32::try_from(*recorded_nanos / SECOND).unwrap();
            data[8..12].copy_from_slice(&second.to_le_bytes());
        }
        let stamp = epoch + SECOND;
        let size = first.len();
        let points = [(&point, first), (&point, last)];
        recorded.push(("/points", CLOUD, stamp, cloud(stamp, "laser", &[(name, kind, size)], &points)));
        check(&usual(&recorded), &wanted);
    }
    // The stamp of some drivers is that of the last point.
    let mut recorded = turning();
    let points = [(&point, float(-0.5)), (&point, float(0.0))];
    recorded.push(("/points", CLOUD, 2 * SECOND, cloud(2 * SECOND, "laser", &[("time", FLOAT, 4)], &points)));
    check(&usual(&recorded), &[[2.1713, 2.1713], [0.05, 3.05]]);
    assert_eq!(usual(&recorded).converter.beams()[&1].wrong_times, 0);
}

#[test]
fn a_cloud_whose_times_are_of_another_clock_is_placed_at_its_stamp_and_counted() {
    let point = [3.0, 0.0, 0.0_f32];
    for (first, last) in [(5_000.0, 5_000.5), (0.0, f64::NAN), (1e10, 3e10), (-2.0, 2.0e9)] {
        let mut recorded = turning();
        let points = [first, last].map(|number: f64| (&point, number.to_le_bytes().to_vec()));
        recorded.push(("/points", CLOUD, SECOND, cloud(SECOND, "laser", &[("timestamp", DOUBLE, 8)], &points)));
        let result = usual(&recorded);
        check(&result, &[[3.05, 0.05], [3.05, 0.05]]);
        assert_eq!(result.converter.beams()[&1].wrong_times, 1, "{first} {last}");
    }
}
