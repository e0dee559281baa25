//! Tests the worth of pending readings, against naive sums.

use super::*;
use crate::{LocalDay, OrderCriterion};

const MINUTE_NANOS: i64 = 60_000_000_000;
/// The first day that no update has learned; a Thursday.
const PENDING_DAY: i64 = 42;

/// A reading every ten minutes for some days from `from_day`: open by day from Monday to Friday, with some noise.
fn door(from_day: i64, days: i64) -> Vec<Sample> {
    (from_day * 144..(from_day + days) * 144)
        .map(|slot| {
            let noise = (slot * 7_919 % 100) < 10;
            let is_weekday = (slot / 144 + 3) % 7 < 5;
            let open = (54..108).contains(&(slot % 144)) && is_weekday;
            Sample { utc_nanos: slot * 10 * MINUTE_NANOS, offset_secs: 0, value: f64::from(u8::from(open != noise)) }
        })
        .collect()
}

fn with_values(mut samples: Vec<Sample>, value: impl Fn(f64) -> f64) -> Vec<Sample> {
    samples.iter_mut().for_each(|sample| sample.value = value(sample.value));
    samples
}

fn learned(kind: StateKind, value: impl Fn(f64) -> f64) -> StateModel {
    let mut model = StateModel::of_kind(kind);
    let samples = with_values(door(0, PENDING_DAY), value);
    model.update(&Periodicities::default(), OrderCriterion::SquaredError, samples);
    model
}

fn worth(model: &StateModel, pending: &[Sample]) -> UpdateWorth {
    UpdateWorth::of_state(model, &Periodicities::default(), pending).expect("errors have a unit")
}

#[test]
fn errors_are_naive_sums_of_what_answers() {
    let (model, day) = (learned(StateKind::Probability, |value| value), door(PENDING_DAY, 1));
    let before = worth(&model, &day);
    let naive: f64 = day
        .iter()
        .map(|sample| {
            let predicted = model.chosen_member(&Periodicities::default()).predict(sample.moment());
            (predicted - sample.value).powi(2)
        })
        .sum();
    let weekdays = model.alternatives().expect("it is learned").alarm().to_parts().kinds[0];
    let usual = 144.0 * (weekdays.mean.powi(2) + weekdays.variance);
    assert!((before.squared_error - naive).abs() < 1e-9 * naive, "{before:?}: {naive}");
    assert!((before.usual_squared_error - usual).abs() < 1e-9 * usual, "{before:?}: {usual}");
    assert_eq!(before.readings, 144);
    assert_eq!(before.squared_error_above_usual, (before.squared_error - before.usual_squared_error).max(0.0));
}

#[test]
fn a_changed_routine_is_worth_an_update_and_a_usual_day_is_not() {
    let model = learned(StateKind::Probability, |value| value);
    let usual = worth(&model, &door(PENDING_DAY, 1));
    assert!(usual.gain() < 0.01 && usual.usual_error() > 0.05, "{usual:?}");
    let other = worth(&model, &with_values(door(PENDING_DAY, 1), |value| 1.0 - value));
    assert!(other.gain() > 0.4 && other.usual_error() == usual.usual_error(), "{other:?}");
    assert!((other.gain() - (other.pending_error() - other.usual_error())).abs() < 1e-12);
    // The gain of a state that is easier than usual does not reduce that of another state.
    let mut both = usual;
    both.add(&other);
    assert_eq!(both.readings, 288);
    assert!((both.gain() - (usual.gain() + other.gain()) / 2.0).abs() < 1e-12, "{both:?}");
}

#[test]
fn weekends_are_compared_with_weekends() {
    let model = learned(StateKind::Probability, |value| value);
    let alarm = model.alternatives().expect("it is learned").alarm();
    let [weekday, weekend] = [PENDING_DAY, PENDING_DAY + 2].map(|day| alarm.usual_mse(LocalDay(day as i32)));
    assert!(weekday != weekend, "{weekday:?}");
    let of_weekend = worth(&model, &door(PENDING_DAY + 2, 2));
    let of_week = worth(&model, &door(PENDING_DAY, 2));
    assert!((of_weekend.usual_error() - weekend.expect("days")).abs() < 1e-12);
    assert!((of_week.usual_error() - weekday.expect("days")).abs() < 1e-12);
}

#[test]
fn numbers_are_judged_in_variances_so_that_their_unit_does_not_count() {
    let celsius = |value: f64| 18.0 + 4.0 * value;
    let fahrenheit = |value: f64| 64.4 + 7.2 * value;
    let day = |value: fn(f64) -> f64| with_values(door(PENDING_DAY, 1), value);
    let one = worth(&learned(StateKind::Continuous, celsius), &day(|value| 22.0 - 4.0 * value));
    let other = worth(&learned(StateKind::Continuous, fahrenheit), &day(|value| 71.6 - 7.2 * value));
    assert!(one.gain() > 1.0 && (one.gain() - other.gain()).abs() < 1e-6, "{one:?} {other:?}");
}

#[test]
fn all_error_of_a_state_without_history_counts_as_gain() {
    let new = StateModel::new(&Periodicities::default());
    let shut = with_values(door(0, 1), |_| 0.0);
    assert_eq!(worth(&new, &shut).gain(), 0.25, "it predicts 0.5");
    let number = StateModel::of_kind(StateKind::Continuous);
    assert_eq!(UpdateWorth::of_state(&number, &Periodicities::default(), &shut), None);
    assert_eq!(worth(&new, &[]), UpdateWorth::default());
    assert_eq!(UpdateWorth::default().gain(), 0.0);
}
