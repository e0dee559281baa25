//! Tests known values of the learning, its bounds, and its weight in the measures.

use proptest::prelude::*;

use super::*;

#[test]
fn what_a_bin_teaches_has_its_known_values() {
    // If only the mean of a habit is known and the habit is 0 or 1, one observation gives all information.
    assert!((learning_bits(0.5, 0.0) - 1.0).abs() < 1e-9);
    // Beta(1, 1): E[H] is half a nat.
    assert!((learning_bits(0.5, 2.0) - (1.0 - 0.5 / std::f64::consts::LN_2)).abs() < 1e-9);
    // Beta(1, 3): E[H] = ψ(5) - ψ(2) / 4 - 3 ψ(4) / 4 = 1/4 + 3/4 * 1/4 + ... by its harmonic numbers.
    let harmonic = |n: u32| (1..=n).map(|k| 1.0 / f64::from(k)).sum::<f64>();
    let kept = harmonic(4) - 0.25 * harmonic(1) - 0.75 * harmonic(3);
    assert!((learning_bits(0.25, 4.0) - (entropy_bits(0.25) - kept / std::f64::consts::LN_2)).abs() < 1e-9);
    // With many bins, the value is 1 / (2ν) nats.
    assert!((learning_bits(0.3, 1e4) * 2e4 * std::f64::consts::LN_2 - 1.0).abs() < 1e-2);
    for bins in [f64::INFINITY, 1e300, BINS_MAX] {
        assert_eq!(learning_bits(0.5, bins), 0.0);
    }
}

#[test]
fn the_measures_weigh_gain_and_learning() {
    let bits = InformationMeasure::ALL.map(|measure| measure.bits(0.5, 0.25));
    assert_eq!(bits, [0.5, 0.25, 1.5]);
    assert_eq!(InformationMeasure::ALL.map(InformationMeasure::name), ["ral", "learn", "both"]);
    // An observation of a coin that was often thrown is worth less than that of a state with little data.
    let worth = |v: f64, bins: f64| InformationMeasure::Both.bits(entropy_bits(v), learning_bits(v, bins));
    assert!(worth(0.5, 200.0) < worth(0.2, 1.0));
}

proptest! {
    #[test]
    fn what_is_learned_lies_between_nothing_and_the_entropy(value in proptest::num::f64::ANY, bins in proptest::num::f64::ANY) {
        let (bits, entropy) = (learning_bits(value, bins), entropy_bits(value));
        prop_assert!((0.0..=entropy).contains(&bits), "{bits} of {entropy}");
    }

    #[test]
    fn less_is_learned_by_every_bin(value in 0.0..=1.0_f64, bins in 0.0..1e3_f64, more in 0.0..100.0_f64) {
        prop_assert!(learning_bits(value, bins + more) <= learning_bits(value, bins) + 1e-9);
        prop_assert!((learning_bits(value, bins) - learning_bits(1.0 - value, bins)).abs() < 1e-9);
    }
}
