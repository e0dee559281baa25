//! The distribution against closed forms, and the invariants of intervals.

mod door;

use std::f64::consts::PI;

use proptest::prelude::*;

use super::{beta::Beta, *};

fn seen(means: &[f64]) -> HourMoments {
    means.iter().fold(HourMoments::default(), |all, &mean| {
        all.and(HourMoments { days: 1.0, sum: mean, sum_of_squares: mean * mean })
    })
}

fn repeated(means: &[f64], times: usize) -> HourMoments {
    seen(&means.repeat(times))
}

#[test]
fn known_distributions_are_met() {
    let uniform = Beta::with_moments(0.5, 1.0 / 3.0);
    let arcsine = Beta::with_moments(0.5, 0.5);
    for x in [0.001, 0.01, 0.2, 0.5, 0.83, 0.999] {
        assert!((uniform.mass_below(x) - x).abs() < 1e-4, "{}", uniform.mass_below(x));
        assert!((arcsine.mass_below(x) - 2.0 / PI * f64::sqrt(x).asin()).abs() < 2e-4);
    }
}

#[test]
fn an_hour_never_seen_may_be_anything() {
    let all = repeated(&[0.0, 0.2, 1.0], 100);
    let anything = Interval { lower: 0.0, upper: 1.0 };
    assert_eq!(credible_interval(0.3, HourMoments::default(), all, 0.9), anything);
    assert_eq!(credible_interval(f64::NAN, all, all, 0.9), anything);
    assert_eq!(credible_interval(0.3, all, all, f64::NAN), anything);
    assert_eq!(credible_interval(0.3, all, all, 1.0), anything);
}

#[test]
fn the_band_narrows_as_days_add_up() {
    for (p, means) in [(0.0, vec![0.0]), (0.4, vec![0.39, 0.41]), (1.0, vec![1.0])] {
        let widths: Vec<f64> = [1, 2, 5, 20, 100]
            .map(|times| {
                let hour = repeated(&means, times);
                credible_interval(p, hour, hour, 0.9).width()
            })
            .to_vec();
        assert!(widths.is_sorted_by(|a, b| a > b || *b < 0.001), "{p}: {widths:?}");
        assert!(widths[0] > 0.4 && widths[4] < 0.1, "{p}: {widths:?}");
    }
}

#[test]
fn an_hour_of_all_or_nothing_needs_both_ends_and_an_even_one_does_not() {
    let door = repeated(&[0.0, 1.0], 50);
    assert_eq!(credible_interval(0.5, door, door, 0.9), Interval { lower: 0.0, upper: 1.0 });
    let street = repeated(&[0.0, 0.25, 0.5, 0.75, 1.0], 50);
    let band = credible_interval(0.5, street, street, 0.5);
    assert!(band.width() < 0.65, "{band:?}");
}

#[test]
fn a_rare_hour_is_bounded_above_only() {
    let hour = repeated(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.3, 0.5], 20);
    let band = credible_interval(0.1, hour, hour, 0.9);
    assert_eq!(band.lower, 0.0);
    assert!(band.upper > 0.2 && band.upper < 0.6, "{band:?}");
}

#[test]
fn a_table_of_hours_gives_the_same_moments() {
    let spread = HourSpread { days: 4.0, mean: 0.5, standard_deviation: (1.0_f64 / 3.0).sqrt() };
    let (from_spread, from_days) = (HourMoments::from(spread), seen(&[0.0, 1.0, 0.0, 1.0]));
    assert!((from_spread.sum_of_squares - from_days.sum_of_squares).abs() < 1e-12);
    assert_eq!((from_spread.days, from_spread.sum), (from_days.days, from_days.sum));
}

/// Probability of less than x under a Beta distribution of whole α and β: the probability of α or more successes in α +
/// β - 1 trials.
fn binomial_tail(alpha: u32, beta: u32, x: f64) -> f64 {
    let tries = alpha + beta - 1;
    let mut choose = 1.0;
    let mut sum = 0.0;
    for successes in 0..=tries {
        if successes >= alpha {
            sum += choose * x.powi(successes as i32) * (1.0 - x).powi((tries - successes) as i32);
        }
        choose *= f64::from(tries - successes) / f64::from(successes + 1);
    }
    sum
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![0.0..=1.0, Just(0.0), Just(1.0), Just(f64::NAN), Just(f64::INFINITY), Just(-1e300), 0.0..100.0]
}

fn any_moments() -> impl Strategy<Value = HourMoments> {
    let honest = proptest::collection::vec(0.0..=1.0, 0..30).prop_map(|means| seen(&means));
    let absurd = (any_number(), any_number(), any_number()).prop_map(|(days, sum, sum_of_squares)| HourMoments {
        days,
        sum,
        sum_of_squares,
    });
    prop_oneof![honest, absurd]
}

proptest! {
    #[test]
    fn the_prediction_is_inside_and_the_band_within_bounds(
        p in any_number(), hour in any_moments(), all in any_moments(), level in any_number(),
    ) {
        let Interval { lower, upper } = credible_interval(p, hour, all, level);
        prop_assert!(0.0 <= lower && lower <= upper && upper <= 1.0, "{lower} {upper}");
        if !p.is_nan() {
            let p = p.clamp(0.0, 1.0);
            prop_assert!(lower <= p && p <= upper, "{lower} {p} {upper}");
        }
    }

    #[test]
    fn a_higher_level_is_no_narrower(
        p in 0.0..=1.0, hour in any_moments(), all in any_moments(), low in 0.0..=1.0, more in 0.0..=1.0,
    ) {
        let high = low + (1.0 - low) * more;
        let width = |level| credible_interval(p, hour, all, level).width();
        prop_assert!(width(low) <= width(high));
    }

    #[test]
    fn masses_are_those_of_the_closed_form(alpha in 1_u32..30, beta in 1_u32..30, x in 0.001..0.999) {
        let total = f64::from(alpha + beta);
        let found = Beta::with_moments(f64::from(alpha) / total, 1.0 / (total + 1.0)).mass_below(x);
        let expected = binomial_tail(alpha, beta, x);
        prop_assert!((found - expected).abs() < 5e-4, "{found}, expected {expected}");
    }

    #[test]
    fn the_other_way_round_is_as_wide(p in 0.0..=1.0, means in proptest::collection::vec(0.0..=1.0, 1..30)) {
        let mirrored: Vec<f64> = means.iter().map(|mean| 1.0 - mean).collect();
        let (hour, mirrored) = (seen(&means), seen(&mirrored));
        let (a, b) = (credible_interval(p, hour, hour, 0.9), credible_interval(1.0 - p, mirrored, mirrored, 0.9));
        prop_assert!((a.width() - b.width()).abs() < 0.02, "{a:?} {b:?}");
    }

    #[test]
    fn the_shortest_interval_holds_its_level_and_no_shorter_does(
        mean in 0.01..0.99, scatter in 0.01..0.9, p in 0.0..=1.0, level in 0.1..0.99,
    ) {
        let beta = Beta::with_moments(mean, scatter);
        let found = beta.shortest_around(p, level, 0.01);
        let up_to = |x: f64| if x >= 1.0 { 1.0 } else if x <= 0.0 { 0.0 } else { beta.mass_below(x) };
        prop_assert!(up_to(found.upper) - up_to(found.lower) >= level - 1e-9);
        // A naive search over lower ends returns no interval that is shorter by more than its own step.
        for step in 0..200 {
            let lower = f64::from(step) / 200.0;
            let upper = lower + found.width() - 0.02;
            if (0.01..=p).contains(&lower) && upper >= p && upper <= 0.99 {
                prop_assert!(up_to(upper) - up_to(lower) < level, "{lower} {upper} {found:?}");
            }
        }
    }
}
