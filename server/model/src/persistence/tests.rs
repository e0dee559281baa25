//! Tests the properties of `persistence.rs`, against a naive oracle where there is one.

use super::*;

const SEC: i64 = 1_000_000_000;

#[track_caller]
fn check(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-9 * expected.abs().max(1.0), "{found}, expected {expected}");
}

#[test]
fn tau_is_an_hour_before_anything_changed() {
    let mut persistence = Persistence::default();
    check(persistence.tau_secs(), 3600.0);
    assert_eq!(persistence.last(), None);
    persistence.observe(100 * SEC, 1.0);
    check(persistence.tau_secs(), 3600.0);
    assert_eq!(persistence.last(), Some((100 * SEC, 1.0)));
}

#[test]
fn tau_follows_the_changes_by_hand() {
    let mut persistence = Persistence::default();
    persistence.observe(0, 0.0);
    persistence.observe(60 * SEC, 0.0);
    // m = 1, no change: 1/τ = (1/3600)/2.
    check(persistence.tau_secs(), 7200.0);
    persistence.observe(120 * SEC, 1.0);
    // m = 2, a change within a minute: 1/τ = (1/3600 + 1/60)/3.
    check(persistence.tau_secs(), 3.0 / (1.0 / 3600.0 + 1.0 / 60.0));
    persistence.observe(140 * SEC, 0.5);
    check(persistence.tau_secs(), 4.0 / (1.0 / 3600.0 + 1.0 / 60.0 + 0.5 / 20.0));
}

#[test]
fn late_and_repeated_observations_change_nothing() {
    let mut persistence = Persistence::default();
    persistence.observe(60 * SEC, 1.0);
    persistence.observe(120 * SEC, 0.0);
    let before = persistence;
    persistence.observe(120 * SEC, 1.0);
    persistence.observe(90 * SEC, 1.0);
    assert_eq!(persistence, before);
}

#[test]
fn blend_fades_from_the_last_value_to_the_prediction() {
    let mut persistence = Persistence::default();
    check(persistence.blend(0.3, 7), 0.3);
    persistence.observe(1000 * SEC, 1.0);
    check(persistence.blend(0.3, 999 * SEC), 0.3);
    check(persistence.blend(0.3, 1000 * SEC), 1.0);
    let weight = (-0.5_f64).exp();
    check(persistence.blend(0.3, 2800 * SEC), weight + 0.3 * (1.0 - weight));
    check(persistence.blend(0.3, i64::MAX), 0.3);
}

#[test]
fn damaged_parts_are_refused() {
    let parts = PersistenceParts { pairs: 3, change_rate_sum: 0.5, last: Some((1, 0.5)) };
    assert_eq!(Persistence::from_parts(parts).map(|p| p.to_parts()), Ok(parts));
    assert!(Persistence::from_parts(PersistenceParts { change_rate_sum: f64::INFINITY, ..parts }).is_err());
    assert!(Persistence::from_parts(PersistenceParts { last: Some((1, f64::NAN)), ..parts }).is_err());
}

proptest::proptest! {
    #[test]
    fn answers_stay_within_0_and_1(
        observed in proptest::collection::vec((proptest::num::i64::ANY, 0.0..=1.0), 0..20),
        p in 0.0..=1.0,
        at in proptest::num::i64::ANY,
    ) {
        let mut persistence = Persistence::default();
        for (utc_nanos, value) in observed {
            persistence.observe(utc_nanos, value);
        }
        proptest::prop_assert!(persistence.tau_secs() > 0.0 && persistence.tau_secs().is_finite());
        proptest::prop_assert!((0.0..=1.0).contains(&persistence.blend(p, at)));
    }
}
