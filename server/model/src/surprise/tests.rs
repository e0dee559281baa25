//! Tests that runs hold the unusual observations, in order, and within their bounds.

use proptest::prelude::*;

use super::*;

const MINUTE: i64 = 60_000_000_000;
const HOUR: i64 = 60 * MINUTE;

/// An observation of a door for which the model predicted this probability of being open.
fn reading(utc_nanos: i64, value: f64, probability: f64) -> JudgedReading {
    let is_above = value >= 0.5;
    let observed_probability = if is_above { probability } else { 1.0 - probability };
    let (is_unusual, is_unexpected) = (observed_probability <= 1.0 - KEPT_CONFIDENCE, observed_probability < 0.5);
    JudgedReading { utc_nanos, value, probability, observed_probability, is_above, is_unusual, is_unexpected }
}

fn surprises_of(readings: impl IntoIterator<Item = JudgedReading>) -> Surprises {
    let mut surprises = Surprises::default();
    readings.into_iter().for_each(|reading| surprises.observe(reading));
    surprises
}

#[test]
fn a_door_left_open_is_one_run() {
    // Readings come every ten minutes for 42 hours. At its usual hours the open door is no surprise.
    let readings = (0..252).map(|i| {
        let is_usual = (60..108).contains(&i);
        reading(
            i * 10 * MINUTE,
            1.0,
            if is_usual {
                0.8
            } else if i == 7 {
                0.005
            } else {
                0.01
            },
        )
    });
    let closed_again = reading(42 * HOUR, 0.0, 0.01);
    let surprises = surprises_of(readings.chain([closed_again, reading(43 * HOUR, 1.0, 0.02)]));
    let [run, next] = surprises.runs() else { panic!("{surprises:?}") };
    assert_eq!((run.first_nanos, run.last_nanos, run.observations), (0, 251 * 10 * MINUTE, 252 - 48));
    assert_eq!((run.value, run.probability, run.observed_probability), (1.0, 0.005, 0.005));
    // Only the first observation of each half-hour counts.
    let bins = f64::from((252 - 48) / 3);
    assert!((run.bits - bins * observed_bits(0.01)).abs() < 1e-9, "{}", run.bits);
    assert_eq!((next.first_nanos, next.observations), (43 * HOUR, 1));
    assert!(surprises.is_open() && surprises.dropped() == 0);
}

#[test]
fn more_readings_of_the_same_hours_are_no_greater_surprise() {
    let hours = |step: i64| surprises_of((0..6 * HOUR / step).map(|i| reading(i * step, 1.0, 0.01))).runs()[0].bits;
    assert!((hours(MINUTE) - hours(30 * MINUTE)).abs() < 1e-9);
    assert!((hours(MINUTE) - 12.0 * observed_bits(0.01)).abs() < 1e-9);
    // A bin counts at most ten bits, however certain the model is.
    assert_eq!(surprises_of([reading(0, 1.0, 0.0)]).runs()[0].bits, 10.0);
}

#[test]
fn a_run_ends_with_the_contrary_and_after_a_day_of_silence() {
    let both = surprises_of([reading(0, 1.0, 0.01), reading(MINUTE, 0.0, 0.99), reading(2 * MINUTE, 1.0, 0.01)]);
    let sides: Vec<bool> = both.runs().iter().map(|run| run.is_above).collect();
    assert_eq!(sides, [true, false, true]);
    let later = |gap| surprises_of([reading(0, 1.0, 0.01), reading(gap, 1.0, 0.01)]).runs().len();
    assert_eq!((later(24 * HOUR), later(24 * HOUR + 1)), (1, 2));
}

#[test]
fn a_run_begins_with_what_is_unusual_and_goes_on_with_what_is_less_likely_than_the_contrary() {
    let p = |slot: i64, probability| reading(slot * 30 * MINUTE, 1.0, probability);
    assert_eq!(surprises_of([p(0, 0.3), p(1, 0.4)]).runs(), []);
    let surprises = surprises_of([p(0, 0.4), p(1, 0.05), p(2, 0.3), p(3, 0.5), p(4, 0.25)]);
    let [run] = surprises.runs() else { panic!("{surprises:?}") };
    assert_eq!((run.first_nanos, run.last_nanos, run.observations), (30 * MINUTE, 120 * MINUTE, 3));
    assert!((run.bits - observed_bits(0.05) - observed_bits(0.3) - 2.0).abs() < 1e-12, "{}", run.bits);
}

#[test]
fn what_comes_late_is_a_run_of_its_own_and_ends_nothing() {
    let mut surprises = surprises_of([reading(10 * HOUR, 1.0, 0.01)]);
    surprises.observe(reading(5 * HOUR, 0.0, 0.01));
    surprises.observe(reading(6 * HOUR, 1.0, 0.02));
    surprises.observe(reading(11 * HOUR, 1.0, 0.01));
    let runs: Vec<(i64, u64)> = surprises.runs().iter().map(|run| (run.first_nanos, run.observations)).collect();
    assert_eq!(runs, [(6 * HOUR, 1), (10 * HOUR, 2)]);
}

#[test]
fn the_strongest_and_the_newest_are_kept() {
    let day = 24 * HOUR;
    let long = (0..84).map(|i| reading(i * 30 * MINUTE, 1.0, 0.01));
    // There is a single surprise every twelve hours for a hundred days.
    let short = (4..200).flat_map(|i| [reading(i * 12 * HOUR, 1.0, 0.02), reading(i * 12 * HOUR + 1, 0.0, 0.0)]);
    let surprises = surprises_of(
        [reading(0, 0.0, 0.0)].into_iter().chain(long).chain([reading(2 * day - 1, 0.0, 0.0)]).chain(short),
    );
    assert_eq!(surprises.runs().len(), RUNS_MAX);
    assert_eq!(surprises.dropped(), 1 + 196 - RUNS_MAX as u64);
    assert_eq!(surprises.runs()[0].observations, 84, "a month later a door left open is still stronger");
    // Of equally strong runs, the oldest was removed.
    assert_eq!(surprises.runs()[1].first_nanos, (200 - 63) * 12 * HOUR);
}

#[test]
fn what_is_not_kept_is_counted() {
    let mut surprises = surprises_of([reading(0, 1.0, 0.01), reading(1, 0.0, 0.99), reading(2, 1.0, 0.01)]);
    surprises.retain(|run| run.first_nanos < 2);
    assert_eq!((surprises.runs().len(), surprises.dropped(), surprises.is_open()), (2, 1, false));
}

#[test]
fn stored_parts_are_checked() {
    let run = surprises_of([reading(5, 1.0, 0.01)]).runs()[0];
    let parts = |runs: Vec<SurpriseRun>| Surprises::from_parts(runs, false, 0);
    assert!(parts(vec![run; RUNS_MAX]).is_ok());
    for wrong in [
        vec![run; RUNS_MAX + 1],
        vec![SurpriseRun { last_nanos: 4, ..run }],
        vec![SurpriseRun { probability: 1.5, ..run }],
        vec![SurpriseRun { observed_probability: f64::NAN, ..run }],
        vec![SurpriseRun { value: f64::INFINITY, ..run }],
        vec![SurpriseRun { bits: -1.0, ..run }],
        vec![SurpriseRun { first_nanos: 6, last_nanos: 6, ..run }, run],
    ] {
        assert!(parts(wrong.clone()).is_err(), "{wrong:?}");
    }
}

proptest! {
    #[test]
    fn whatever_is_observed_the_runs_stay_in_order_and_within_their_bounds(
        readings in prop::collection::vec((0..500_i64, 0..2_u8, 0.0..=1.0_f64), 0..400),
        cut in 0..400_usize,
    ) {
        let readings: Vec<JudgedReading> =
            readings.iter().map(|&(hour, value, p)| reading(hour * HOUR, f64::from(value), p)).collect();
        let surprises = surprises_of(readings.clone());
        prop_assert!(surprises.runs().len() <= RUNS_MAX);
        let stored = |one: &Surprises| Surprises::from_parts(one.runs().to_vec(), one.is_open(), one.dropped());
        prop_assert_eq!(stored(&surprises).unwrap(), surprises.clone());
        // Storing and reading back between two observations changes nothing.
        let (before, after) = readings.split_at(cut.min(readings.len()));
        let mut again = stored(&surprises_of(before.iter().copied())).unwrap();
        after.iter().for_each(|&reading| again.observe(reading));
        prop_assert_eq!(again, surprises);
    }
}
