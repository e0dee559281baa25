//! Tests tails against known sums and quantiles.

use proptest::prelude::*;

use super::*;

/// P(0), P(1), … of a Poisson distribution.
fn poisson(mean: f64) -> Vec<f64> {
    let mut masses = vec![(-mean).exp()];
    (1..400).for_each(|k| masses.push(masses[k - 1] * mean / k as f64));
    masses
}

#[test]
fn normal_tails_are_those_of_tables() {
    for (z, two_sided) in [(0.0, 1.0), (1.0, 0.317_310_5), (1.959_964, 0.05), (2.575_829, 0.01), (5.0, 5.733_031e-7)] {
        for sign in [-1.0, 1.0] {
            let found = value_tail(StateKind::Continuous, 3.0, 4.0, 3.0 + sign * 2.0 * z);
            assert!((found - two_sided).abs() < 5e-3 * two_sided, "{z}: {found}");
        }
    }
}

#[test]
fn counts_of_poisson_variance_have_poisson_tails() {
    for mean in [0.01, 0.5, 3.0, 20.0, 120.0] {
        let masses = poisson(mean);
        for value in [0, 1, 2, 5, 10, 20, 40, 100, 150, 200] {
            let at_most: f64 = masses[..=value].iter().sum();
            let at_least: f64 = masses[value..].iter().sum();
            let expected = (2.0 * at_most.min(at_least)).min(1.0);
            let found = value_tail(StateKind::Count, mean, mean, value as f64);
            assert!((found - expected).abs() < 0.002 * expected + 1e-12, "{value} of {mean}: {found}, {expected}");
        }
    }
}

#[test]
fn dispersed_counts_have_the_mean_and_variance_that_were_asked_for() {
    for (mean, dispersion) in [(0.3, 2.0), (4.0, 1.5), (50.0, 20.0)] {
        // The moments from P(X >= k): the mean is the sum of P(X >= k) from 1 on, and E[X²] that of (2k - 1) P(X >= k).
        let (mut first, mut second) = (0.0, 0.0);
        let mut above = 0.0;
        let mut k = 20_000.0;
        let size = mean / (dispersion - 1.0);
        let ratio: f64 = 1.0 - 1.0 / dispersion;
        let mut masses = vec![(-size * f64::ln(dispersion)).exp()];
        (0..20_000).for_each(|i| masses.push(masses[i] * (i as f64 + size) / (i as f64 + 1.0) * ratio));
        while k >= 1.0 {
            above += masses[k as usize];
            first += above;
            second += (2.0 * k - 1.0) * above;
            if k > mean && k < mean + 20.0 * dispersion {
                let found = value_tail(StateKind::Count, mean, dispersion * mean, k);
                let below: f64 = 1.0 - above + masses[k as usize];
                let expected = (2.0 * above.min(below)).min(1.0);
                assert!((found - expected).abs() < 1e-4 * expected + 1e-12, "{k}: {found}, {expected}");
            }
            k -= 1.0;
        }
        assert!((first - mean).abs() < 1e-6 * mean, "{first}");
        assert!((second - first * first - dispersion * mean).abs() < 1e-4 * dispersion * mean);
    }
}

#[test]
fn what_never_varied_is_surprised_by_anything_else_and_not_by_itself() {
    for kind in [StateKind::Continuous, StateKind::Count] {
        for expected in [0.0, 5.0, 1e12] {
            assert!(value_tail(kind, expected, 0.0, expected) > 0.1);
        }
    }
    assert_eq!(value_tail(StateKind::Continuous, 5.0, 0.0, 5.1), 0.0);
    assert!(value_tail(StateKind::Continuous, 5.0, 0.0, 5.000_000_1) > 0.1);
    assert_eq!(value_tail(StateKind::Count, 0.0, 0.0, 1.0), 0.0);
}

#[test]
fn the_tail_of_skewed_counts_falls_from_their_median() {
    let tail = |value| value_tail(StateKind::Count, 192.0, 56_535.0, value);
    let tails: Vec<f64> = (0..400).map(|value| tail(f64::from(value))).collect();
    let median = (0..400).max_by(|&a, &b| tails[a].total_cmp(&tails[b])).expect("400 values");
    assert!((90..140).contains(&median), "{median}");
    assert!(tails[..=median].is_sorted() && tails[median..].is_sorted_by(|a, b| a >= b));
}

proptest! {
    #[test]
    fn a_tail_is_a_probability_that_falls_with_the_distance(
        is_count: bool, expected in prop_oneof![-10.0f64..2000.0, Just(1e12), Just(f64::NAN), Just(f64::INFINITY)],
        variance in prop_oneof![0.0f64..1e5, Just(1e24), Just(f64::NAN)],
        value in prop_oneof![0.0f64..3000.0, Just(1e12), Just(-1e12), Just(f64::NAN)],
    ) {
        let kind = if is_count { StateKind::Count } else { StateKind::Continuous };
        let value = if is_count { value.round() } else { value };
        let tail = value_tail(kind, expected, variance, value);
        prop_assert!((0.0..=1.0).contains(&tail), "{tail}");
        if expected.is_finite() && value.is_finite() {
            let [below, above] = [value - 1.0, value + 1.0].map(|value| value_tail(kind, expected, variance, value));
            // Counts are skewed: their tail is largest at the median, which may lie far below the mean.
            let beyond = match (value < expected, is_count) {
                (true, true) => below.min(above),
                (true, false) => below,
                (false, _) => above,
            };
            prop_assert!(beyond <= tail + 1e-6, "{beyond} beyond {tail}");
        }
    }
}
