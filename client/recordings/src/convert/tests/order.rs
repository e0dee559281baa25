//! Tests of the order of messages: one clock that goes on, one scan a stamp.

use super::*;

/// A robot that is at x = 0 at second 0 of a simulation and drives on by a metre a second; it scans at each half
/// second. The recording begins at another time.
fn run(recorded: &mut Recorded, began: i64, seconds: i64, along: f64) {
    for second in 0..=seconds {
        let stamp = (7 + second) * SECOND;
        let at = transform(stamp, ("odom", "laser"), [second as f64 * along, 0.0, 0.0]);
        recorded.push(("/tf", TF, began + second * SECOND, at));
        if second < seconds {
            let stamp = stamp + SECOND / 2;
            recorded.push(("/scan", SCAN, began + second * SECOND + SECOND / 2, scan(stamp, "laser", 3.0)));
        }
    }
}

fn scan(stamp: i64, frame: &str, range: f32) -> Vec<u8> {
    ScanText { stamp, frame, increments: [0.0; 2], limits: [0.1, 10.0], ranges: &[range] }.bytes()
}

#[test]
fn of_a_clock_that_starts_again_the_longer_part_is_taken() {
    let began = 1_700_000_000 * SECOND;
    for (first, second) in [(3, 8), (8, 3)] {
        let mut recorded = Recorded::new();
        run(&mut recorded, began, first, 1.0);
        run(&mut recorded, began + 20 * SECOND, second, -1.0);
        let result = usual(&recorded);
        let left = result.made.iter().filter(|item| **item == Err(NotMade::OtherPart)).count();
        let taken: Vec<f64> = result.made.iter().filter(|item| item.is_ok()).map(|item| ends(item)[0].x).collect();
        assert_eq!((left, taken.len()), (3, 8));
        let direction = if first > second { 1.0 } else { -1.0 };
        for (step, x) in (0..).zip(taken) {
            let wanted = 3.0 + direction * (f64::from(step) + 0.5);
            assert!((x - wanted).abs() < 1e-6, "{x} in place of {wanted}");
        }
    }
}

#[test]
fn files_in_another_order_are_no_clock_that_goes_back() {
    let mut recorded = Recorded::new();
    run(&mut recorded, 7 * SECOND, 5, 1.0);
    let half = recorded.len() / 2;
    recorded.rotate_left(half);
    let result = usual(&recorded);
    assert!(result.made.iter().all(Result::is_ok), "{:?}", result.made);
}

#[test]
fn of_two_scans_with_one_stamp_the_first_is_taken() {
    let mut recorded = Recorded::new();
    run(&mut recorded, 7 * SECOND, 2, 1.0);
    let stamp = 7 * SECOND + SECOND / 2;
    for (frame, range) in [("laser", 3.0), ("laser", 4.0), ("other", 4.0)] {
        recorded.push(("/scan", SCAN, 8 * SECOND, scan(stamp, frame, range)));
    }
    for second in [7, 9] {
        let stamp = second * SECOND;
        recorded.push(("/tf", TF, stamp, transform(stamp, ("odom", "other"), [0.0; 3])));
    }
    let result = usual(&recorded);
    assert_eq!(result.made.len(), 5);
    assert_eq!(result.made[2], Err(NotMade::Repeated));
    assert_eq!(result.made[3], Err(NotMade::SameStamp));
    assert_eq!(ends(&result.made[4])[0], Point3::new(4.0, 0.0, 0.0), "another sensor of the topic");
    let by_recorder = ConvertOptions { clock: Clock::Recorder, ..ConvertOptions::default() };
    let made = converted(&recorded, &Wishes::default(), by_recorder).made;
    assert_eq!(made[2], Err(NotMade::Repeated));
    assert!(made[3].is_ok(), "each has its own time");
}

/// How many of ten clouds of a second are taken, of two frames each.
fn clouds_taken(points: usize, period_nanos: Option<i64>) -> usize {
    let point: (&[f32; 3], Vec<u8>) = (&[1.0, 0.0, 0.5], Vec::new());
    let points = vec![point; points];
    let mut recorded = Recorded::new();
    for frame in ["left", "right"] {
        for stamp in [7, 9] {
            recorded.push(("/tf", TF, stamp * SECOND, transform(stamp * SECOND, ("odom", frame), [0.0; 3])));
        }
    }
    for tenth in 0..10 {
        for (frame, late) in [("left", 0), ("right", 1)] {
            let stamp = 8 * SECOND + tenth * SECOND / 10 + late;
            recorded.push(("/points", CLOUD, stamp, cloud(stamp, frame, &[], &points)));
        }
    }
    let merge = Some(CellSize { resolution_m: 0.1, origin_m: [0.0; 3] });
    let options = ConvertOptions { merge, period_nanos, ..ConvertOptions::default() };
    let made = converted(&recorded, &Wishes::default(), options).made;
    assert!(made.iter().all(|item| item.is_ok() || *item == Err(NotMade::Thinned)), "{made:?}");
    made.iter().filter(|item| item.is_ok()).count()
}

#[test]
fn of_clouds_with_many_points_one_a_second_is_taken_of_each_frame() {
    assert_eq!(clouds_taken(CLOUD_POINTS_MANY, None), 2);
    assert_eq!(clouds_taken(CLOUD_POINTS_MANY, Some(0)), 20);
    assert_eq!(clouds_taken(CLOUD_POINTS_MANY - 1, None), 20, "they may be parts of one turn of the scanner");
    assert_eq!(clouds_taken(2, Some(SECOND / 2)), 4);
}
