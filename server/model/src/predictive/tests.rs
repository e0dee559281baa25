//! Tests properties of predictive distributions, and their values against a simulated chain.

use proptest::prelude::*;

use super::*;

proptest! {
    #[test]
    fn intervals_contain_the_value_and_hold_their_level(
        value in 0.0..=1.0_f64, bins in 0.0..500.0_f64, dependence in 0.0..1.0_f64, level in 0.05..0.999_f64,
    ) {
        let predictive = Predictive::new(value, bins, dependence);
        let HeldInterval { interval, mass } = predictive.interval(level);
        prop_assert!(interval.contains(predictive.value()), "{interval:?} {predictive:?}");
        prop_assert!(interval.lower >= 0.0 && interval.upper <= 1.0);
        prop_assert!(mass >= level - 1e-9 && mass <= 1.0, "{mass} of {level}: {predictive:?} {interval:?}");
    }

    #[test]
    fn more_bins_never_widen_the_uncertainty(value in 0.01..0.99_f64, dependence in 0.0..1.0_f64) {
        let learning = |bins| Predictive::new(value, bins, dependence).learning_bits();
        prop_assert!(learning(0.0) >= learning(1.0) && learning(1.0) >= learning(30.0));
        let share = |bins| Predictive::new(value, bins, dependence).variance_share();
        prop_assert!(share(0.0) >= share(1.0) && share(1.0) >= share(30.0));
    }

    #[test]
    fn masses_are_a_distribution_with_the_value_as_mean(value in 0.001..0.999_f64, bins in 0.0..500.0_f64, dependence in 0.0..1.0_f64) {
        let masses = Predictive::new(value, bins, dependence).masses();
        let all: f64 = masses.iter().sum();
        let mean: f64 = masses.iter().enumerate().map(|(k, mass)| k as f64 / 12.0 * mass).sum();
        prop_assert!((all - 1.0).abs() < 1e-6 && (mean - value).abs() < 1e-6, "{all} {mean}");
    }
}

#[test]
fn numbers_without_sense_give_the_prediction_without_bins() {
    let nothing = Predictive::new(f64::NAN, f64::NAN, f64::NAN);
    assert_eq!((nothing.value(), nothing.bins(), nothing.entropy_bits()), (0.5, 0.0, 1.0));
    let sure = Predictive::new(1.0, 1e9, 0.5);
    assert!(sure.value() < 1.0 && sure.entropy_bits() > 0.0 && sure.learning_bits() >= 0.0);
}

#[test]
fn an_hour_of_a_state_that_seldom_changes_is_all_or_nothing() {
    let slow = Predictive::new(0.4, 1e6, 0.99).interval(0.5);
    // Six hours of ten do not contain a single 1.
    assert!(slow.interval.lower == 0.0 && slow.interval.upper <= 0.41 && slow.mass > 0.55, "{slow:?}");
    let fast = Predictive::new(0.4, 1e6, 0.01).interval(0.9);
    assert!(slow.interval.upper - slow.interval.lower < 0.45 && fast.interval.upper < 0.75, "{fast:?}");
}
