//! Tests the search for periods, against the formula.

use super::*;
use crate::civil::NANOS_PER_SEC;
use crate::periodicity::Periodicities;

const DAY_NANOS: i64 = 86_400 * NANOS_PER_SEC;
const WEEK_NANOS: i64 = 7 * DAY_NANOS;

/// Times every half hour over 40 days, which is not a whole number of weeks, and holds a month.
fn times() -> impl Iterator<Item = i64> + Clone {
    (0..48 * 40).map(|half_hour| half_hour * 1_800 * NANOS_PER_SEC)
}

fn weeks(time: i64) -> f64 {
    time as f64 / WEEK_NANOS as f64
}

/// The candidates of times, and the errors there.
fn residuals(times: impl Iterator<Item = i64> + Clone, error: impl Fn(f64) -> f64) -> (Candidates, Residuals) {
    let candidates = Candidates::new(&Periodicities::default(), times.clone());
    let mut residuals = Residuals::new(&candidates, 1);
    for time in times {
        residuals.add(candidates.slot(time), 0, 2.0, error(weeks(time)));
        residuals.add_at(time, &candidates, (0, 2.0, error(weeks(time))));
    }
    (candidates, residuals)
}

#[test]
fn the_spectrum_is_the_modulus_of_the_sum() {
    let error = |weeks: f64| (weeks * 40.0).sin() + 0.3 * (weeks * 7.0 * TAU).cos() + 0.7;
    let (candidates, residuals) = residuals(times(), error);
    let weeks: Vec<f64> = times().map(weeks).collect();
    let mean = weeks.iter().map(|&weeks| error(weeks)).sum::<f64>() / weeks.len() as f64;
    let spectrum = residuals.spectrum(&candidates);
    assert_eq!(spectrum.len(), 85, "84 of the week, and a month");
    for (period, found) in spectrum {
        let (mut re, mut im) = (0.0, 0.0);
        for &weeks in &weeks {
            let angle = TAU * weeks * 604_800.0 / period.secs();
            re += 2.0 * (error(weeks) - mean) * angle.cos();
            im -= 2.0 * (error(weeks) - mean) * angle.sin();
        }
        assert!((found - re.hypot(im)).abs() < 1e-6, "{period:?}: {found}, expected {}", re.hypot(im));
    }
}

#[test]
fn the_strongest_period_is_the_strongest_that_may_be_taken() {
    let wave = |weeks: f64| (TAU * weeks).cos() + 0.5 * (7.0 * TAU * weeks).sin();
    let divisor = |days: i64, taken: &[HypertimePeriod]| {
        let (candidates, residuals) = residuals((0..days * 24).map(|hour| hour * 3_600 * NANOS_PER_SEC), wave);
        residuals.strongest(&candidates, taken).map(|period| (period.cycle_nanos / DAY_NANOS, period.divisor))
    };
    assert_eq!(divisor(28, &[]), Some((7, 1)));
    let week = HypertimePeriod { cycle_nanos: WEEK_NANOS, divisor: 1 };
    assert_eq!(divisor(28, &[week]), Some((7, 7)));
    assert_eq!(divisor(7, &[]), Some((7, 1)));
    assert_ne!(divisor(6, &[]), Some((7, 1)));
    assert_eq!(divisor(0, &[]), None);
}

#[test]
fn a_month_is_found_beside_the_periods_of_a_week() {
    let month = 2_629_746.0 / 604_800.0;
    let (candidates, residuals) = residuals(times(), |weeks| (TAU * weeks / month).cos());
    let found = residuals.strongest(&candidates, &[]).expect("a period");
    assert_eq!(found.secs(), 2_629_746.0);
}

#[test]
fn errors_in_long_slots_carry_no_information_about_short_periods() {
    let (candidates, residuals) = residuals(times(), |weeks| (TAU * 7.0 * weeks).cos());
    let found = |hours: i64| {
        let slots = residuals.clone().in_slots_of(hours * 3_600 * NANOS_PER_SEC);
        slots.strongest(&candidates, &[]).map(|period| period.divisor)
    };
    assert_eq!(found(6), Some(7));
    assert_ne!(found(7), Some(7));
}
