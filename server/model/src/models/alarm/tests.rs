//! Tests the properties of `alarm.rs`, over many seeds.

use proptest::prelude::*;
use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};

use super::*;

/// Monday, 2024-01-01.
const MONDAY: i32 = 19_723;

/// A standard normal number (Box and Muller).
fn normal(random: &mut SmallRng) -> f64 {
    let radius = (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * random.random::<f64>()).cos()
}

/// Daily errors that vary about a level in several ways.
type Noise = fn(&mut SmallRng, i32) -> f64;

const NOISES: [(&str, Noise); 6] = [
    ("normal", |random, _| (0.08 + 0.02 * normal(random)).max(0.0)),
    ("wide", |random, _| (0.08 + 0.04 * normal(random)).max(0.0)),
    ("log-normal", |random, _| 0.06 * (0.6 * normal(random)).exp()),
    ("exponential", |random, _| -0.05 * (1.0 - random.random::<f64>()).ln()),
    ("easy weekends", |random, day| if day % 7 >= 5 { 0.0 } else { (0.1 + 0.03 * normal(random)).max(0.0) }),
    (
        "rare odd days",
        |random, _| if random.random::<f64>() < 0.05 { 0.5 } else { 0.05 + 0.03 * random.random::<f64>() },
    ),
];

/// The first of `days` on which the alarm rings.
fn rings(alarm: &mut ChangeAlarm, days: std::ops::Range<i32>, mut mse: impl FnMut(i32) -> f64) -> Option<i32> {
    days.into_iter().find(|&day| alarm.observe(LocalDay(MONDAY + day), mse(day), 1440))
}

#[test]
fn a_year_without_a_change_rings_for_at_most_five_of_a_hundred() {
    for (name, noise) in NOISES {
        let rang = (0..100).filter(|&seed| {
            let mut random = SmallRng::seed_from_u64(seed);
            rings(&mut ChangeAlarm::default(), 0..365, |day| noise(&mut random, day)).is_some()
        });
        let rang = rang.count();
        println!("{name}: {rang} of 100 rang within a year");
        assert!(rang <= 5, "{name}: {rang}");
    }
}

#[test]
fn a_change_of_routine_rings_within_a_week() {
    // A robot expects working hours from nine to five; from some day on people work at night. Each day differs by a
    // share of wrong minutes.
    for seed in 0..100 {
        let mut random = SmallRng::seed_from_u64(seed);
        let mut alarm = ChangeAlarm::default();
        let change = 30 + (seed % 60) as i32;
        let mut mse = |day: i32| {
            let usual = if day % 7 < 5 { 0.08 + 0.02 * normal(&mut random) } else { 0.02 + 0.01 * normal(&mut random) };
            let changed = if day >= change && day % 7 < 5 { 0.25 } else { 0.0 };
            (usual + changed).max(0.0)
        };
        assert_eq!(rings(&mut alarm, 0..change, &mut mse), None, "seed {seed}");
        let rang = rings(&mut alarm, change..change + 7, &mut mse);
        assert!(rang.is_some(), "seed {seed}, change on day {change}");
    }
}

#[test]
fn it_rings_until_it_is_reset_and_then_learns_anew() {
    let mut alarm = ChangeAlarm::default();
    let mse = |day: i32| if day < 40 { 0.05 } else { 0.3 };
    let rang = rings(&mut alarm, 0..60, mse).unwrap();
    assert!((42..47).contains(&rang), "{rang}");
    assert_eq!(alarm.alarm_day(), Some(LocalDay(MONDAY + rang)));
    // The old level does not silence the alarm.
    assert!(alarm.observe(LocalDay(MONDAY + 60), 0.05, 1440));
    assert_eq!(ChangeAlarm::from_parts(alarm.to_parts()), Ok(alarm));
    alarm.reset();
    assert!(!alarm.is_ringing());
    assert_eq!(rings(&mut alarm, 61..200, mse), None);
}

#[test]
fn one_odd_day_or_an_easier_state_does_not_ring() {
    for odd in [1.0, 0.0] {
        let mut alarm = ChangeAlarm::default();
        assert_eq!(rings(&mut alarm, 0..100, |day| if day == 50 { odd } else { 0.1 }), None);
    }
    let mut alarm = ChangeAlarm::default();
    assert_eq!(rings(&mut alarm, 0..200, |day| if day < 50 { 0.1 } else { 0.0 }), None);
}

#[test]
fn a_handful_of_observations_does_not_ring() {
    let mut alarm = ChangeAlarm::default();
    for day in 0..100 {
        let (mse, observations) = if day >= 50 { (1.0, 5) } else { (0.05 + 0.002 * f64::from(day % 3), 1440) };
        assert!(day > 56 || !alarm.observe(LocalDay(MONDAY + day), mse, observations), "day {day}");
    }
}

#[test]
fn a_day_that_is_too_early_or_without_a_valid_error_changes_nothing() {
    let mut alarm = ChangeAlarm::default();
    rings(&mut alarm, 0..20, |_| 0.1);
    let before = alarm;
    for (day, mse, observations) in
        [(19, 1.0, 9), (0, 1.0, 9), (20, f64::NAN, 9), (20, f64::INFINITY, 9), (20, -1.0, 9), (20, 1.0, 0)]
    {
        assert!(!alarm.observe(LocalDay(MONDAY + day), mse, observations));
        assert_eq!(alarm, before);
    }
}

#[test]
fn damaged_parts_are_refused() {
    let damaged = |change: &dyn Fn(&mut ChangeAlarmParts)| {
        let mut parts = ChangeAlarmParts::default();
        change(&mut parts);
        ChangeAlarm::from_parts(parts).is_err()
    };
    assert!(!damaged(&|_| ()));
    assert!(damaged(&|parts| parts.sum = f64::NAN));
    assert!(damaged(&|parts| parts.sum = -1.0));
    assert!(damaged(&|parts| parts.typical_observations = f64::INFINITY));
    assert!(damaged(&|parts| parts.kinds[0].days = -1.0));
    assert!(damaged(&|parts| parts.kinds[1].mean = f64::NAN));
    assert!(damaged(&|parts| parts.kinds[1].variance = -0.1));
}

proptest! {
    #[test]
    fn it_stays_sound_whatever_comes(
        days in prop::collection::vec((any::<i32>(), prop::num::f64::ANY, any::<u64>()), 0..80),
        regular in prop::collection::vec((prop::num::f64::POSITIVE, 1..u64::MAX), 0..80),
    ) {
        let mut alarm = ChangeAlarm::default();
        for (day, &(mse, observations)) in (0..).zip(&regular) {
            alarm.observe(LocalDay(day), mse, observations);
        }
        for &(day, mse, observations) in &days {
            alarm.observe(LocalDay(day), mse, observations);
        }
        prop_assert_eq!(ChangeAlarm::from_parts(alarm.to_parts()), Ok(alarm));
    }
}
