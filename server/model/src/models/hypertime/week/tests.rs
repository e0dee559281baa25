//! The search for periods, against the formula.

use super::*;

/// Errors every half hour, over a span that is not a whole number of weeks.
fn residuals(error: impl Fn(f64) -> f64) -> Residuals {
    let mut residuals = Residuals::new(1);
    for half_hour in 0..48 * 40 {
        let turn = turn(half_hour * 1_800 * NANOS_PER_SEC);
        residuals.add(slot(half_hour * 1_800 * NANOS_PER_SEC), 0, 2.0, error(turn));
    }
    residuals
}

#[test]
fn the_spectrum_is_the_modulus_of_the_sum() {
    let error = |turn: f64| (turn * 40.0).sin() + 0.3 * (turn * 7.0 * TAU).cos() + 0.7;
    let spectrum = residuals(error).spectrum();
    let turns: Vec<f64> = (0..48 * 40).map(|half_hour| turn(half_hour * 1_800 * NANOS_PER_SEC)).collect();
    let mean = turns.iter().map(|&turn| error(turn)).sum::<f64>() / turns.len() as f64;
    for (divisor, found) in (1..=CANDIDATES).zip(spectrum) {
        let (mut re, mut im) = (0.0, 0.0);
        for turn in &turns {
            let angle = TAU * turn * f64::from(divisor);
            re += 2.0 * (error(*turn) - mean) * angle.cos();
            im -= 2.0 * (error(*turn) - mean) * angle.sin();
        }
        assert!((found - re.hypot(im)).abs() < 1e-6, "{divisor}: {found}, expected {}", re.hypot(im));
    }
}

#[test]
fn the_strongest_period_is_the_strongest_that_may_be_taken() {
    let residuals = residuals(|turn| (TAU * turn).cos() + 0.5 * (7.0 * TAU * turn).sin());
    let weeks = |weeks: f64| (weeks * WEEK_NANOS as f64) as u64;
    assert_eq!(residuals.strongest(&[], weeks(4.0)), Some(1));
    assert_eq!(residuals.strongest(&[1], weeks(4.0)), Some(7));
    assert_eq!(residuals.strongest(&[], weeks(0.991)), Some(1));
    assert_ne!(residuals.strongest(&[], weeks(0.98)), Some(1));
    assert_eq!(residuals.strongest(&[], 0), None);
    assert_eq!(Residuals::new(1).strongest(&[], weeks(4.0)), None);
}

#[test]
fn a_time_is_on_the_same_place_of_a_circle_after_its_period() {
    let at = |civil_nanos: i64| {
        let mut point = Vec::new();
        project(turn(civil_nanos), &[7, 84], &mut point);
        point
    };
    for civil in [0, -1, 1_700_000_000_123_456_789, i64::MIN, i64::MAX - WEEK_NANOS] {
        let (now, next_day) = (at(civil), at(civil + WEEK_NANOS / 7));
        for (a, b) in now.iter().zip(&next_day) {
            assert!((a - b).abs() < 1e-9, "{civil}: {now:?}, {next_day:?}");
        }
        assert!(slot(civil) < SLOTS);
    }
}
