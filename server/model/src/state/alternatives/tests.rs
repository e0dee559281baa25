//! Tests when the calibrated model is trained again, on which days it is scored, and when it is chosen.

use super::*;
use crate::{
    StateModel, TrainedModelParts,
    models::{Calibrated, CalibratedOptions, Readings},
};

const CALIBRATED: ModelKind = ModelKind::Calibrated;
/// The weight of the errors of a day, after another observed day.
const KEPT_PER_DAY: f64 = 0.93;
const SLOT_NANOS: i64 = 600_000_000_000;
const SLOTS: i64 = 144;

/// Samples every ten minutes of some days, by a function of day and slot of the day.
fn samples(days: std::ops::Range<i64>, value: impl Fn(i64, i64) -> f64) -> Vec<Sample> {
    let slots = days.start * SLOTS..days.end * SLOTS;
    slots
        .map(|slot| Sample {
            utc_nanos: slot * SLOT_NANOS,
            offset_secs: 0,
            value: value(slot.div_euclid(SLOTS), slot % SLOTS),
        })
        .collect()
}

/// A pseudo-random number in `[0,1)`.
fn noise(seed: i64) -> f64 {
    let mixed = (seed as u64).wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ (mixed >> 31)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (mixed >> 11) as f64 / (1_u64 << 53) as f64
}

/// An office that is open by day on weekdays, and is opened and closed a little earlier or later each day.
fn office(day: i64, slot: i64) -> f64 {
    let opened = 48 + (12.0 * noise(day)) as i64;
    let closed = 102 + (12.0 * noise(day + 1_000)) as i64;
    f64::from(u8::from((day + 3) % 7 < 5 && (opened..closed).contains(&slot)))
}

fn train(samples: &[Sample]) -> Calibrated {
    Calibrated::train(Readings::new(samples), CalibratedOptions::default()).unwrap()
}

fn learn(state: &mut StateModel, samples: Vec<Sample>) {
    state.update(&Periodicities::default(), OrderCriterion::SquaredError, samples);
}

fn sum_of(state: &StateModel, wanted: ModelKind) -> Option<f64> {
    let mut sums = state.alternatives().unwrap().error_sums();
    sums.find(|(choice, _)| *choice == wanted).map(|(_, sum)| sum)
}

fn calibrated_error(state: &StateModel) -> Option<f64> {
    sum_of(state, CALIBRATED)
}

fn squared_error(model: &impl TemporalModel, samples: &[Sample]) -> f64 {
    samples.iter().map(|sample| (model.predict(sample.moment()) - sample.value).powi(2)).sum()
}

#[test]
fn a_training_is_due_after_seven_observed_days_and_every_seven_days_and_a_cheap_one_from_the_third_day() {
    let mut state = StateModel::new(&Periodicities::default());
    let due = |state: &StateModel| [ModelKind::Calibrated, ModelKind::PERGAM].map(|kind| state.is_training_due(kind));
    assert_eq!(due(&state), [false, false]);
    // Every other day: only observed days count.
    for observed in 1..7 {
        learn(&mut state, samples(2 * observed..2 * observed + 1, office));
        assert_eq!(due(&state), [observed >= 3, false], "{observed} days");
        if observed >= 3 {
            state = state.with_trained(train(&samples(0..2 * observed + 1, office)), LocalDay(2 * observed as i32));
            assert_eq!(due(&state), [false, false], "trained after {observed} days");
        }
    }
    // Late data does not count as a further day, because the day may be counted already.
    learn(&mut state, samples(1..2, office));
    assert_eq!(due(&state), [false, false]);
    learn(&mut state, samples(14..15, office));
    assert_eq!(due(&state), [true, true]);
    state = state.with_trained(train(&samples(0..15, office)), LocalDay(14));
    assert!(!state.is_training_due(ModelKind::Calibrated));
    // From the first training after seven observed days on, calendar days count.
    learn(&mut state, samples(20..21, office));
    assert!(!state.is_training_due(ModelKind::Calibrated), "six days after");
    learn(&mut state, samples(21..22, office));
    assert!(state.is_training_due(ModelKind::Calibrated), "seven days after");
}

#[test]
fn a_training_is_due_when_the_alarm_has_rung_since() {
    let mut state = StateModel::new(&Periodicities::default());
    learn(&mut state, samples(0..42, office));
    let mut trained = None;
    for day in 42..56 {
        let rang = state.alternatives().unwrap().alarm().alarm_day();
        if let Some(rang) = rang {
            assert!(state.is_training_due(ModelKind::Calibrated), "it rang on {rang}, trained on {trained:?}");
            assert_eq!(trained, Some(i64::from(rang.0) - 1));
            let again = state.clone().with_trained(train(&samples(0..day, office)), LocalDay(day as i32 - 1));
            assert!(!again.is_training_due(ModelKind::Calibrated), "it was trained after the alarm");
            return;
        }
        state = state.with_trained(train(&samples(0..42, office)), LocalDay(day as i32 - 1));
        trained = Some(day - 1);
        assert!(!state.is_training_due(ModelKind::Calibrated));
        learn(&mut state, samples(day..day + 1, |day, slot| 1.0 - office(day, slot)));
    }
    panic!("the alarm has not rung");
}

#[test]
fn a_day_is_scored_by_the_model_before_it() {
    let mut state = StateModel::new(&Periodicities::default());
    learn(&mut state, samples(0..14, office));
    let first = train(&samples(0..14, office));
    state = state.with_trained(first.clone(), LocalDay(13));
    assert_eq!(calibrated_error(&state), None, "nothing was scored");
    assert!(matches!(state.choice(), ModelKind::Histogram { .. }));
    let before = sum_of(&state, state.choice()).unwrap();
    let day = samples(14..15, office);
    learn(&mut state, day.clone());
    let after = calibrated_error(&state).unwrap();
    // The sum begins with the error of the model in force.
    let expected = before * KEPT_PER_DAY + squared_error(&first, &day);
    assert!((after - expected).abs() < 1e-9, "{after}, expected {expected}");
    // Another model, two days without observations, which do not count, and a day.
    let second = train(&samples(0..15, office));
    state = state.with_trained(second.clone(), LocalDay(14));
    assert_eq!(calibrated_error(&state), Some(after), "a model alone is no score");
    let day = samples(17..18, office);
    learn(&mut state, day.clone());
    let expected = after * KEPT_PER_DAY + squared_error(&second, &day);
    assert!((calibrated_error(&state).unwrap() - expected).abs() < 1e-9);
}

#[test]
fn it_begins_with_the_sum_of_the_spectral_model_where_that_is_in_force() {
    let chance = |day: i64, slot: i64| f64::from(u8::from(noise(day * SLOTS + slot) < 0.3));
    let mut state = StateModel::new(&Periodicities::default());
    learn(&mut state, samples(0..14, chance));
    assert_eq!(state.choice(), ModelKind::Spectral);
    let before = sum_of(&state, ModelKind::Spectral).unwrap();
    let model = train(&samples(0..14, chance));
    state = state.with_trained(model.clone(), LocalDay(13));
    let day = samples(14..15, chance);
    learn(&mut state, day.clone());
    let expected = before * KEPT_PER_DAY + squared_error(&model, &day);
    // Another order may be best after the day, and it has another sum.
    let after = calibrated_error(&state).unwrap();
    assert!((after - expected).abs() < 0.05 * expected, "{after}, expected {expected}");
}

#[test]
fn zero_one_counts_wrong_predictions_of_the_calibrated_model() {
    let mut state = StateModel::new(&Periodicities::default());
    let update = |state: &mut StateModel, samples| {
        state.update(&Periodicities::default(), OrderCriterion::ZeroOne, samples);
    };
    update(&mut state, samples(0..14, office));
    let model = train(&samples(0..14, office));
    state = state.with_trained(model.clone(), LocalDay(13));
    for day in 14..16 {
        let before = calibrated_error(&state);
        let day = samples(day..day + 1, office);
        update(&mut state, day.clone());
        let is_wrong = |sample: &&Sample| (model.predict(sample.moment()) >= 0.5) != (sample.value >= 0.5);
        let wrong = day.iter().filter(is_wrong).count() as f64;
        if let Some(before) = before {
            assert!((calibrated_error(&state).unwrap() - before * KEPT_PER_DAY - wrong).abs() < 1e-9);
        }
    }
}

/// The rules with which the chosen model predicts.
fn without_ensemble() -> UpdateRules {
    UpdateRules { models: EnabledModels::default().without_ensemble(), ..UpdateRules::default() }
}

#[test]
fn the_calibrated_model_is_chosen_where_it_predicts_best() {
    // Edges that move by hours from day to day, and a weekend: neither few components nor hourly bins describe this.
    let mut state = StateModel::new(&Periodicities::default());
    let mut seen = Vec::new();
    let mut in_force = [0.0; 2];
    for day in 0..70 {
        let today = samples(day..day + 1, office);
        let before = state.clone();
        let outcome = state.update(&Periodicities::default(), without_ensemble(), today.clone());
        if let Some(ActiveModel::Trained(model)) = before.chosen(&Periodicities::default()) {
            assert!((outcome.squared_error_in_force - squared_error(model, &today)).abs() < 1e-9);
            in_force[0] += outcome.squared_error_in_force;
            in_force[1] += outcome.squared_errors[before.order()];
        }
        seen.extend(today);
        if state.is_training_due(ModelKind::Calibrated) {
            state = state.with_trained(train(&seen), LocalDay(day as i32));
        }
    }
    let errors: Vec<_> = state.alternatives().unwrap().error_sums().collect();
    assert_eq!(state.choice(), CALIBRATED, "{errors:?}");
    assert!(in_force[0] > 0.0 && in_force[0] < 0.9 * in_force[1], "{in_force:?}");
}

#[test]
fn parts_make_the_same_again_and_what_cannot_be_is_refused() {
    let mut state = StateModel::new(&Periodicities::default());
    learn(&mut state, samples(0..9, office));
    let unscored = state.clone().with_trained(train(&samples(0..9, office)), LocalDay(8));
    let mut scored = unscored.clone();
    learn(&mut scored, samples(9..40, office));
    for state in [&state, &unscored, &scored] {
        let known = state.alternatives().unwrap();
        assert_eq!(&Alternatives::from_parts(known.to_parts()).unwrap(), known);
    }
    let parts = scored.alternatives().unwrap().to_parts();
    let is_refused = |change: fn(&mut AlternativesParts)| {
        let mut parts = parts.clone();
        change(&mut parts);
        Alternatives::from_parts(parts).is_err()
    };
    assert!(!is_refused(|parts| parts.choice = 128));
    assert!(is_refused(|parts| (parts.choice, parts.trained) = (128, Vec::new())));
    assert!(is_refused(|parts| parts.choice = 129));
    assert!(is_refused(|parts| parts.choice = 4));
    assert!(is_refused(|parts| parts.choice = 127));
    assert!(is_refused(|parts| parts.choice = 255));
    assert!(is_refused(|parts| parts.error_sums.truncate(3)));
    assert!(is_refused(|parts| (parts.choice, parts.error_sums) = (1, vec![1.0])));
    assert!(!is_refused(|parts| (parts.choice, parts.error_sums) = (0, vec![1.0])));
    assert!(is_refused(|parts| parts.trained.push(parts.trained[0].clone())));
    assert!(is_refused(|parts| parts.trained[0].error_sum = Some(f64::NAN)));
    assert!(is_refused(|parts| parts.trained[0].error_sum = Some(-1.0)));
    assert!(is_refused(|parts| match &mut parts.trained[0].model {
        TrainedModelParts::Calibrated(model) => _ = model.profile.pop(),
        _ => panic!("another model"),
    }));
}
