//! Tests the properties of `periodicity.rs`, against a naive oracle where there is one.

use super::*;

const DAY_NANOS: i64 = 86_400 * NANOS_PER_SEC;

#[test]
fn the_default_is_a_week_to_an_hour() {
    let week = Periodicities::default();
    assert_eq!(week, Periodicities::harmonics(7 * DAY_NANOS, 168).unwrap());
    assert_eq!((week.len(), week.is_empty()), (168, false));
    assert!((week.period_secs(0) - 604_800.0).abs() < 1e-9);
    assert!((week.period_secs(6) - 86_400.0).abs() < 1e-9);
    assert!((week.period_secs(167) - 3_600.0).abs() < 1e-9);
    assert!(week.period_secs(168).is_infinite());
}

#[test]
fn counts_and_periods_outside_their_ranges_are_refused_by_name() {
    let message = |result: Result<Periodicities, InvalidPeriodicities>| result.unwrap_err().to_string();
    assert_eq!(message(Periodicities::list(vec![])), "0 periodicities, expected 1 to 2048");
    assert_eq!(message(Periodicities::harmonics(DAY_NANOS, 2049)), "2049 periodicities, expected 1 to 2048");
    let range = "expected 1 s to 3155760000 s (100 years)";
    let short = message(Periodicities::list(vec![DAY_NANOS, NANOS_PER_SEC / 2]));
    assert_eq!(short, format!("periodicity 1 has a period of 0.5 s, {range}"));
    let negative = message(Periodicities::harmonics(-NANOS_PER_SEC, 1));
    assert_eq!(negative, format!("periodicity 0 has a period of -1 s, {range}"));
    assert!(Periodicities::harmonics(i64::MAX, 1).is_err());
    let fast = Periodicities::harmonics(10 * NANOS_PER_SEC, 11).unwrap_err();
    assert_eq!(fast, InvalidPeriodicities::Period { index: 10, period_nanos: 909_090_909 });
    let repeated = message(Periodicities::list(vec![DAY_NANOS, 7 * DAY_NANOS, DAY_NANOS]));
    assert_eq!(repeated, "periodicities 0 and 2 both have a period of 86400 s, expected no two equal");
}

#[test]
fn the_ends_of_the_ranges_are_accepted() {
    assert!(Periodicities::list(vec![NANOS_PER_SEC, PERIOD_MAX_NANOS]).is_ok());
    assert!(Periodicities::harmonics(2048 * NANOS_PER_SEC, 2048).is_ok());
    assert!(Periodicities::harmonics(PERIOD_MAX_NANOS, 1).is_ok());
}

#[test]
fn eligible_means_at_least_99_hundredths_of_the_period() {
    let week = Periodicities::default();
    let edge = 598_752 * NANOS_PER_SEC as u64;
    assert!(week.is_eligible(0, edge) && !week.is_eligible(0, edge - 1));
    let day_edge = 85_536 * NANOS_PER_SEC as u64;
    assert!(week.is_eligible(6, day_edge) && !week.is_eligible(6, day_edge - 1));
    let list = Periodicities::list(vec![DAY_NANOS]).unwrap();
    assert!(list.is_eligible(0, day_edge) && !list.is_eligible(0, day_edge - 1));
    assert!(!week.is_eligible(168, u64::MAX) && !list.is_eligible(1, u64::MAX));
}

proptest::proptest! {
    #[test]
    fn phases_are_exact_for_every_time_and_period(
        civil in proptest::num::i64::ANY,
        period in NANOS_PER_SEC..=PERIOD_MAX_NANOS,
    ) {
        let turns = Cycle::new(period).turns(civil);
        let exact = i128::from(civil).rem_euclid(i128::from(period)) as f64 / period as f64;
        let apart = turns - exact;
        proptest::prop_assert!((-0.5..=0.5).contains(&turns));
        proptest::prop_assert!((apart - apart.round()).abs() < 1e-15, "{turns} {exact}");
    }
}
