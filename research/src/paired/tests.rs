//! The paired test finds real differences, and has the error rate of its level.

#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use tidemap_model::{Evaluation, LocalDay};

use super::*;

/// Days of test sets with the given mean squared errors, each from 100 readings.
fn days(sets: &[&[f64]]) -> Vec<DayErrors> {
    let of_set = |(set, mse): (usize, &&[f64])| -> Vec<DayErrors> {
        let day = |(day, mse): (usize, &f64)| DayErrors {
            set,
            day: LocalDay(day as i32),
            errors: Evaluation { observations: 100, squared_error: 100.0 * mse, ..Evaluation::default() },
        };
        mse.iter().enumerate().map(day).collect()
    };
    sets.iter().enumerate().flat_map(of_set).collect()
}

#[test]
fn the_same_predictions_do_not_differ() {
    let days = days(&[&[0.1, 0.2, 0.0, 0.3], &[0.1, 0.4, 0.2, 0.0]]);
    let Difference { mean, test } = difference(&days, &days, 0.05);
    assert_eq!((mean, test), (0.0, Some(PairedTest { interval: Some((0.0, 0.0)), p_value: 1.0 })));
}

#[test]
fn a_steady_difference_is_found_where_days_themselves_vary_much() {
    let baseline = [0.1, 0.5, 0.0, 0.9, 0.3, 0.7, 0.2, 0.6];
    let better = baseline.map(|mse| mse * 0.9 + 0.001 - 0.005);
    let Difference { mean, test } = difference(&days(&[&better]), &days(&[&baseline]), 0.05);
    let PairedTest { interval, p_value } = test.unwrap();
    let (lower, upper) = interval.unwrap();
    assert!(lower < mean && mean < upper && upper < 0.0, "{mean} in {lower} to {upper}");
    assert!(p_value < 0.05, "{p_value}");
}

#[test]
fn one_day_alone_is_no_evidence() {
    let baseline = [0.1; 14];
    let mut worse = baseline;
    worse[3] = 0.9;
    let test = difference(&days(&[&worse]), &days(&[&baseline]), 0.05).test.unwrap();
    assert!(test.p_value > 0.05, "{test:?}");
    // Draws without that day contain no information on how much days vary.
    assert_eq!(test.interval, None);
}

#[test]
fn too_few_days_are_not_tested() {
    let (a, b) = (days(&[&[0.1, 0.2], &[0.3, 0.4], &[0.5, 0.6]]), days(&[&[0.0, 0.0], &[0.0, 0.0], &[0.0, 0.0]]));
    let found = difference(&a, &b, 0.05);
    assert!((found.mean - 0.35).abs() < 1e-12);
    assert_eq!(found.test, None);
    assert_eq!(difference(&[], &[], 0.05), Difference { mean: 0.0, test: None });
}

#[test]
fn test_sets_count_alike_whatever_their_length() {
    let long = [1.0; 12];
    let found = difference(&days(&[&long, &[0.0, 0.0]]), &days(&[&[0.0; 12], &[0.0; 2]]), 0.05);
    assert!((found.mean - 0.5).abs() < 1e-12, "{}", found.mean);
}

/// Without a difference, a test at 5 % finds one in about 5 of 100 experiments, and its interval misses 0 as often.
#[test]
fn the_level_is_kept() {
    let mut random = SmallRng::seed_from_u64(7);
    let experiments = 500;
    let mut found = 0;
    for _ in 0..experiments {
        // Four weeks, the last one a day short, whose days differ by a skewed noise with mean 0.
        let sets: Vec<Vec<PairedDay>> = [7, 7, 7, 6]
            .map(|days| {
                let day = |_| PairedDay { squared: -(random.random_range(1e-9..1.0_f64)).ln() - 1.0, readings: 1.0 };
                (0..days).map(day).collect()
            })
            .to_vec();
        let test = paired(&sets, 0.05, 499).test.unwrap();
        let is_significant = test.p_value <= 0.05;
        let (lower, upper) = test.interval.unwrap();
        assert_eq!(is_significant, lower > 0.0 || upper < 0.0, "{test:?}");
        found += u32::from(is_significant);
    }
    let share = f64::from(found) / f64::from(experiments);
    println!("a difference was found in {share} of experiments without one");
    assert!((0.03..=0.08).contains(&share), "{share}");
}

proptest! {
    #[test]
    fn interval_and_p_value_make_sense_and_agree(
        pairs in prop::collection::vec((0.0..1.0_f64, 0.0..1.0_f64), 6..40),
        significance in 0.01..0.5_f64,
    ) {
        let (a, b): (Vec<f64>, Vec<f64>) = pairs.into_iter().unzip();
        let (a, b) = (days(&[&a]), days(&[&b]));
        let found = difference(&a, &b, significance);
        let test = found.test.unwrap();
        let (lower, upper) = test.interval.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
        prop_assert!(lower <= found.mean && found.mean <= upper);
        prop_assert!(test.p_value > 0.0 && test.p_value <= 1.0);
        // Either way round it is the same evidence.
        let back = difference(&b, &a, significance);
        prop_assert!((back.mean + found.mean).abs() < 1e-12);
        prop_assert!((back.test.unwrap().p_value - test.p_value).abs() < 2e-3);
        // Not on the edge, an interval excludes 0 where the difference is significant.
        if (test.p_value - significance).abs() > 1e-3 {
            prop_assert_eq!(test.p_value <= significance, lower > 0.0 || upper < 0.0);
        }
    }
}

#[test]
fn p_values_are_corrected_for_their_number() {
    assert_eq!(holm(&[0.04, 0.01, 0.5, 0.02]), [0.08, 0.04, 0.5, 0.06]);
    assert_eq!(holm(&[0.6, 0.7]), [1.0, 1.0]);
    assert_eq!(holm(&[]), [0.0; 0]);
}
