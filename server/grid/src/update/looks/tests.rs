//! Compares scoring in scan blocks with scoring the same scans one by one.

use std::sync::Arc;

use proptest::prelude::*;
use tidemap_model::{Component, ORDER_MAX, OrderCriterion, ScoreSums, SpectralModel};

use super::{super::rules::UpdateLimits, super::shared_sums::Counted, *};
use crate::{
    sensors::Sensors,
    spec::{Evidence, SensorNoise},
    tests::{HOUR, SECOND},
};

/// A bit at each scan as toggles.
fn toggles(bits: &[bool]) -> Vec<u32> {
    let before = std::iter::once(false).chain(bits.iter().copied());
    let flips = (0..).zip(before.zip(bits)).filter(|(_, (before, bit))| before != *bit);
    flips.map(|(scan, _)| scan).collect()
}

fn rules(chunk_scans: usize) -> Rules {
    let sensors = Arc::new(Sensors::new(SensorNoise::default()));
    let rules = Rules::new(&Periodicities::default(), OrderCriterion::ZeroOne, Evidence::Readings, &sensors, None);
    Rules { limits: UpdateLimits { chunk_scans, ..UpdateLimits::default() }, ..rules }
}

fn times(nanos: Vec<i64>) -> Times {
    let all = Counted { observations: nanos.len() as u64, first_nanos: 0, last_nanos: 0 };
    Times::of_scans(nanos.clone(), nanos.into(), all, None)
}

/// A model with swings of an hour and more whose predictions leave `[0,1]` at times.
fn model() -> SpectralModel {
    let component = |k: u32| Component { periodicity: k * 11 + 2, gamma_re: 0.1, gamma_im: 0.02 * f64::from(k) - 0.1 };
    SpectralModel::from_parts(0.4, 100, (0..ORDER_MAX as u32).map(component).collect()).expect("valid")
}

/// Scores a cell of a group in scan blocks; also returns the number of scans that counted.
fn by_look(
    (times, rules): (&Times, &Rules),
    (observed, occupied): (&[bool], &[bool]),
    newer_than: i64,
    all: bool,
) -> (ScoreSums, u64) {
    let looks = Looks::new(&times.civil_nanos, &rules.periodicities);
    let mut group = GroupScoring { newer_than: Some(newer_than), all, cursor: Cursor::default() };
    let (observed, occupied) = (toggles(observed), toggles(occupied));
    let (mut sums, mut scored, mut cursor, mut scratch) =
        (ScoreSums::default(), 0, Cursor::default(), Scratch::default());
    for chunk in looks.chunks(times, rules) {
        match group.readings(&observed, &chunk, &mut scratch) {
            Some(mut readings) => {
                scored += readings.scored;
                model().score_readings(&chunk.phasors, readings.of_cell(&occupied, &mut cursor), &mut sums, true);
            }
            None => cursor.skip(&occupied, &chunk),
        }
    }
    (sums, scored)
}

/// Scores the cell scan by scan, each scan at the time that `at` returns for it.
fn by_scan(
    (times, rules): (&Times, &Rules),
    (observed, occupied): (&[bool], &[bool]),
    newer_than: i64,
    at: impl Fn(usize) -> i64,
) -> (ScoreSums, u64) {
    let (mut sums, mut scored) = (ScoreSums::default(), 0);
    for scan in 0..times.utc_nanos.len() {
        if observed[scan] && times.utc_nanos[scan] > newer_than {
            let phasors = PhasorTable::new(&rules.periodicities, &[at(scan)]);
            let value = if occupied[scan] { rules.levels.1 } else { rules.levels.0 };
            model().score_run_values(&phasors, &[value], &mut sums, true);
            scored += 1;
        }
    }
    (sums, scored)
}

#[test]
fn looks_are_aligned_to_the_clock_and_predicted_at_their_mean_time() {
    let minute = 60 * SECOND;
    let scans = [58, 59, 60, 70, 119, 120, 400].map(|secs| secs * SECOND);
    let looks = Looks::new(&scans, &Periodicities::default());
    assert_eq!(looks.bounds, [0, 2, 5, 6, 7]);
    assert_eq!(looks.civil_nanos, [58 * SECOND + SECOND / 2, 83 * SECOND, 2 * minute, 400 * SECOND]);
    let none = Looks::new(&[], &Periodicities::default());
    assert_eq!((none.bounds, none.civil_nanos), (vec![0], Vec::new()));
}

#[test]
fn scans_out_of_order_are_predicted_as_scans_in_order() {
    let scans = [10, 70, 20, 80].map(|secs| secs * SECOND);
    let looks = Looks::new(&scans, &Periodicities::default());
    assert_eq!(looks.civil_nanos, [15, 75, 15, 75].map(|secs| secs * SECOND));
}

#[test]
fn looks_and_scans_differ_by_less_than_a_thousandth_of_the_error() {
    let times = times((0..17_280).map(|scan| scan * 5 * SECOND).collect());
    let rules = rules(256);
    let observed = vec![true; 17_280];
    let occupied: Vec<bool> = (0..17_280).map(|scan| (scan / 431) % 3 == 0).collect();
    let (looks, scored) = by_look((&times, &rules), (&observed, &occupied), -1, true);
    let (scans, each) = by_scan((&times, &rules), (&observed, &occupied), -1, |scan| times.civil_nanos[scan]);
    assert_eq!(scored, each);
    for order in 0..=ORDER_MAX {
        let (a, b) = (looks.squared[order], scans.squared[order]);
        assert!((a - b).abs() < 1e-3 * b, "order {order}: {a} {b}");
        // A block is not divided where the prediction crosses one half.
        let (a, b) = (looks.wrong[order], scans.wrong[order]);
        assert!((a - b).abs() < 0.01 * b, "order {order}: {a} {b} wrong");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_scan_that_counts_is_scored_at_the_mean_time_of_its_look(
        scans in proptest::collection::vec((0_i64..300, any::<bool>(), any::<bool>()), 1..60),
        newer_than in 0_i64..300,
        chunk_scans in 1_usize..9,
        in_order in any::<bool>(),
    ) {
        let mut secs: Vec<i64> = scans.iter().map(|scan| scan.0).collect();
        if in_order {
            secs.sort_unstable();
        }
        let at = |secs: i64| 9 * HOUR + secs * SECOND;
        let times = times(secs.iter().map(|&secs| at(secs)).collect());
        let observed: Vec<bool> = scans.iter().map(|scan| scan.1).collect();
        let occupied: Vec<bool> = scans.iter().map(|scan| scan.1 && scan.2).collect();
        let rules = rules(chunk_scans);
        let mean_of_minute = |scan: usize| {
            let same: Vec<i64> = secs.iter().copied().filter(|other| other / 60 == secs[scan] / 60).collect();
            at(0) + same.iter().sum::<i64>() * SECOND / same.len() as i64
        };
        let bits = (&observed[..], &occupied[..]);
        let (looks, scored) = by_look((&times, &rules), bits, at(newer_than), false);
        let (scans, each) = by_scan((&times, &rules), bits, at(newer_than), mean_of_minute);
        prop_assert_eq!(scored, each);
        for order in 0..=ORDER_MAX {
            prop_assert!((looks.squared[order] - scans.squared[order]).abs() < 1e-9);
            prop_assert_eq!(looks.wrong[order], scans.wrong[order]);
        }
    }
}
