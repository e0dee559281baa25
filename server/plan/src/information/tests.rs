//! Known values, and invariants.

use proptest::prelude::*;

use super::*;

#[test]
fn only_certainties_are_taken() {
    for wrong in [0.5, 1.0, 0.0, -1.0, 2.0, f64::NAN, f64::INFINITY] {
        let error = Certainty::new(wrong).unwrap_err().to_string();
        assert!(error.contains("above 0.5 and below 1") && error.contains(&wrong.to_string()), "{error}");
    }
    assert_eq!(Certainty::new(0.95), Ok(Certainty::default()));
}

#[test]
fn a_look_teaches_only_where_looks_are_counted() {
    let (gain, known) = (Certainty::default().bits(0.3), Predictive::new(0.3, 2.0, 0.0));
    let worth = |measure| LookWorth { measure, ..LookWorth::default() };
    assert_eq!(worth(InformationMeasure::RaL).bits(0.3, Some(known)), gain);
    assert_eq!(worth(InformationMeasure::Learn).bits(0.3, Some(known)), known.learning_bits());
    assert_eq!(worth(InformationMeasure::Both).bits(0.3, Some(known)), gain + 4.0 * known.learning_bits());
    assert_eq!(InformationMeasure::ALL.map(|measure| worth(measure).bits(0.3, None)), [gain, 0.0, gain]);
}

#[test]
fn information_has_its_known_values() {
    let certainty = Certainty::default();
    assert!((certainty.bits(0.5) - (1.0 - 0.286_396_957_115_956_4)).abs() < 1e-12);
    assert!((certainty.bits(0.25) - (0.811_278_124_459_132_8 - 0.286_396_957_115_956_4)).abs() < 1e-12);
    assert_eq!((certainty.bits(0.05), certainty.bits(0.97), certainty.bits(1.0)), (0.0, 0.0, 0.0));
    assert_eq!(certainty.bits(f64::NAN), certainty.most_bits());
    // A more certain observation has information about a state of 0.05 or 0.95.
    assert!(
        (Certainty::new(0.99).unwrap().bits(0.95) - (0.286_396_957_115_956_4 - 0.080_793_135_895_911_2)).abs() < 1e-9
    );
}

#[test]
fn sets_are_sums() {
    assert!((entropy_of([0.5, 0.25, 0.0]) - 1.811_278_124_459_132_8).abs() < 1e-12);
    assert_eq!(entropy_of([]), 0.0);
    let certainty = Certainty::default();
    assert_eq!(certainty.bits_of([0.5, 0.3]), certainty.bits(0.5) + certainty.bits(0.3));
}

proptest! {
    #[test]
    fn no_number_gives_nan_or_less_than_nothing(p in prop::num::f64::ANY, certainty in 0.5_f64..1.0) {
        prop_assume!(certainty > 0.5);
        let certainty = Certainty::new(certainty).unwrap();
        prop_assert!((0.0..=certainty.most_bits()).contains(&certainty.bits(p)));
        prop_assert!(certainty.most_bits() < 1.0);
        prop_assert!((0.0..=1.0 + 1e-12).contains(&entropy_of([p])));
    }

    #[test]
    fn what_is_nearer_to_a_half_teaches_more(one in 0.0_f64..0.5, other in 0.0_f64..0.5) {
        let bits = |p| Certainty::default().bits(p);
        let (low, high) = (one.min(other), one.max(other));
        prop_assert!(bits(low) <= bits(high) + 1e-15);
        prop_assert!((bits(high) - bits(1.0 - high)).abs() < 1e-12);
    }
}

#[test]
fn a_look_at_labels_is_worth_their_entropy_less_what_it_leaves() {
    let certainty = Certainty::default();
    for p in [0.05, 0.2, 0.5, 0.9] {
        let difference = certainty.bits_of_labels(&[p, 1.0 - p]) - certainty.bits(p);
        assert!(difference.abs() < 1e-12, "{p}: {difference}");
    }
    let even = certainty.bits_of_labels(&[0.25; 4]);
    assert!((even - (2.0 - 0.286_396_957_115_956_4 - 0.05 * 3.0_f64.log2())).abs() < 1e-12, "{even}");
    assert_eq!(certainty.bits_of_labels(&[1.0, 0.0, 0.0]), 0.0);
}
