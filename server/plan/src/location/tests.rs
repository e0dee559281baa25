//! The information of a visit, against known values.

use proptest::prelude::*;

use super::*;

#[test]
fn a_visit_gives_the_entropy_of_all_that_it_shows() {
    assert!((information_bits([0.5, 0.5, 0.25, 1.0]) - 2.811_278_124_459_133).abs() < 1e-12);
    assert!(information_bits([]).abs() < 1e-12);
}

#[test]
fn a_visit_saves_the_guesses_that_would_be_wrong() {
    assert!((expected_errors([0.5, 0.9, 0.2]) - 0.8).abs() < 1e-12);
}

#[test]
fn what_was_expected_anyway_is_no_surprise() {
    // If both models agree, the cross entropy is the entropy.
    assert!((surprise_bits([(0.3, 0.3)]) - information_bits([0.3])).abs() < 1e-12);
    // A model that is certain of the contrary has the largest gain: log2 20 bits.
    assert!((surprise_bits([(1.0, 0.0)]) - 20_f64.log2()).abs() < 1e-9);
    assert!(surprise_bits([(0.0, 0.0)]) < 0.1);
}

proptest! {
    #[test]
    fn surprise_is_never_below_what_the_short_term_leaves_open(expected in 0.0..=1.0_f64, informed in 0.05..=0.95_f64) {
        // Checks Gibbs' inequality.
        prop_assert!(surprise_bits([(expected, informed)]) >= information_bits([expected]) - 1e-12);
    }

    #[test]
    fn nothing_is_ever_nan_or_negative(a in prop::num::f64::ANY, b in prop::num::f64::ANY) {
        for value in [information_bits([a, b]), surprise_bits([(a, b)]), expected_errors([a, b])] {
            prop_assert!(value >= 0.0 && value.is_finite(), "{value}");
        }
    }
}
