//! Beams without a return, in the forms in which drivers write them.

use super::*;

fn still() -> Recorded {
    let at = |stamp| ("/tf", TF, stamp, transform(stamp, ("odom", "laser"), [1.0, 0.0, 0.0]));
    vec![at(SECOND), at(2 * SECOND)]
}

#[test]
fn a_range_that_is_a_marker_hits_nothing() {
    let ranges = [2.0, 10.0, 11.0, f32::INFINITY, f32::NAN, 0.0, -1.0, 0.05, f32::NEG_INFINITY, 9.999, 65.535, 0.1];
    let scan = ScanText { stamp: SECOND, frame: "laser", increments: [0.1, 0.0], limits: [0.1, 10.0], ranges: &ranges };
    let mut recorded = still();
    recorded.push(("/scan", SCAN, SECOND, scan.bytes()));
    let result = usual(&recorded);
    let Ok(Item { made: Made::Scan(scan), .. }) = &result.made[0] else { panic!("{:?}", result.made) };
    let sign = |range: &f32| {
        if range.is_nan() {
            '?'
        } else if range.is_infinite() {
            '-'
        } else {
            'x'
        }
    };
    assert_eq!(scan.ranges_m.iter().map(sign).collect::<String>(), "x---?????x-x");
    let beams = result.converter.beams()[&1];
    assert_eq!(beams, BeamCounts { all: 12, without_return: 4, without_reading: 5, wrong_times: 0 });
    assert_eq!(
        beams.notices(),
        ["9 of 12 beams have no return, and hit nothing: 4 reach the sensor's limit, 5 have no reading"]
    );
}

#[test]
fn a_point_that_fills_a_place_hits_nothing() {
    let nan = [f32::NAN; 3];
    let far = [1.0, f32::INFINITY, 0.0];
    let points: Vec<(&[f32; 3], Vec<u8>)> =
        [&[2.0, 0.0, 0.5], &nan, &[0.0; 3], &[-0.0, 0.0, -0.0], &far, &[0.0, 0.0, 1.0]]
            .into_iter()
            .map(|point| (point, Vec::new()))
            .collect();
    let mut recorded = still();
    recorded.push(("/points", CLOUD, SECOND, cloud(SECOND, "laser", &[], &points)));
    recorded.push(("/points", CLOUD, 2 * SECOND, cloud(2 * SECOND, "laser", &[], &points[1..5])));
    for merge in [None, Some(CellSize { resolution_m: 0.1, origin_m: [0.0; 3] })] {
        let options = ConvertOptions { merge, ..ConvertOptions::default() };
        let result = converted(&recorded, &Wishes::default(), options);
        assert_eq!(ends(&result.made[0]), [Point3::new(3.0, 0.0, 0.5), Point3::new(1.0, 0.0, 1.0)]);
        assert_eq!(result.made[1], Err(NotMade::Nothing("no beam of the cloud has a return")));
        let beams = result.converter.beams()[&1];
        assert_eq!(beams.notices(), ["8 of 10 beams have no return, and hit nothing"]);
    }
}
