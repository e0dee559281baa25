//! The values that each kind of state allows, and the treatment of others.

use super::*;

#[test]
fn each_kind_allows_its_values_and_no_others() {
    let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, 1.000_001e12];
    for kind in StateKind::ALL {
        assert!(kind.allows(0.0) && kind.allows(1.0) && !odd.iter().any(|&value| kind.allows(value)), "{kind:?}");
        assert!(kind.allows(-0.0));
        for value in odd.into_iter().chain([2.5, -1.0]) {
            assert!(kind.bounds().contains(&kind.saturate(value)), "{kind:?} {value}");
        }
    }
    assert!(StateKind::Probability.allows(0.5) && !StateKind::Probability.allows(2.0));
    assert!(StateKind::Continuous.allows(-2.5) && StateKind::Continuous.allows(VALUE_MAX));
    assert!(StateKind::Count.allows(7.0) && !StateKind::Count.allows(2.5) && !StateKind::Count.allows(-1.0));
}

#[test]
fn what_is_not_a_number_saturates_to_not_knowing() {
    assert_eq!(StateKind::ALL.map(|kind| kind.saturate(f64::NAN)), [0.5, 0.0, 0.0]);
    assert_eq!(StateKind::ALL.map(|kind| kind.saturate(-3.25)), [0.0, -3.25, 0.0]);
    assert_eq!(StateKind::ALL.map(|kind| kind.saturate(3.25)), [1.0, 3.25, 3.25]);
}
