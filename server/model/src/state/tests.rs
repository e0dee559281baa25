//! The promises of `state.rs`, tested against a naive oracle where there is one.

use proptest::prelude::*;

use super::*;
use crate::{catalogue::TRAINED_AT_NIGHT, evaluate, models::Moment};

const MINUTE_NANOS: i64 = 60_000_000_000;
const DAY_NANOS: i64 = 1440 * MINUTE_NANOS;

fn week() -> Periodicities {
    Periodicities::default()
}

/// Samples every ten minutes for some days from `from_day`: open by day, with some noise.
fn door(from_day: i64, days: i64) -> Vec<Sample> {
    (from_day * 144..(from_day + days) * 144)
        .map(|slot| {
            let noise = (slot * 7_919 % 100) < 10;
            let open = (54..108).contains(&(slot % 144)) && slot / 144 % 7 < 5;
            let value = f64::from(u8::from(open != noise));
            Sample { utc_nanos: slot * 10 * MINUTE_NANOS, offset_secs: 0, value }
        })
        .collect()
}

#[test]
fn the_first_update_has_nothing_to_score() {
    let mut state = StateModel::new(&week());
    assert_eq!(state.spectral(), &SpectralModel::default());
    let outcome = state.update(&week(), OrderCriterion::SquaredError, door(0, 1));
    assert_eq!(outcome, UpdateOutcome { observations: 144, ..UpdateOutcome::default() });
    assert_eq!(state.order(), 0);
    assert_eq!(state.spectral(), &SpectralModel::train(state.accumulator(), &week()));
    assert_eq!(state.update(&week(), OrderCriterion::SquaredError, vec![]), UpdateOutcome::default());
}

#[test]
fn a_day_is_scored_by_the_model_before_it() {
    let mut state = StateModel::new(&week());
    state.update(&week(), OrderCriterion::SquaredError, door(0, 14));
    let before = state.clone();
    let day = door(14, 1);
    let outcome = state.update(&week(), OrderCriterion::SquaredError, day.clone());
    assert_eq!((outcome.observations, outcome.scored), (144, 144));
    assert_eq!((outcome.order_before, outcome.order), (before.order(), state.order()));
    for (order, evaluation) in evaluate(before.spectral(), &week(), &day, ORDER_MAX).iter().enumerate() {
        assert!((outcome.squared_errors[order] - evaluation.squared_error).abs() < 1e-9);
        let expected = before.errors().sums()[order] * 0.93 + evaluation.squared_error;
        assert!((state.errors().sums()[order] - expected).abs() < 1e-9);
    }
    assert!(state.order() >= 1);
    assert_eq!(state.errors().last_day(), Some(LocalDay(14)));
}

#[test]
fn zero_one_counts_wrong_predictions() {
    let mut state = StateModel::new(&week());
    state.update(&week(), OrderCriterion::ZeroOne, door(0, 14));
    let (before, day) = (state.clone(), door(14, 1));
    state.update(&week(), OrderCriterion::ZeroOne, day.clone());
    for (order, evaluation) in evaluate(before.spectral(), &week(), &day, ORDER_MAX).iter().enumerate() {
        let expected = before.errors().sums()[order] * 0.93 + evaluation.wrong as f64;
        assert!((state.errors().sums()[order] - expected).abs() < 1e-9);
    }
}

#[test]
fn older_data_is_folded_in_but_not_scored() {
    let mut state = StateModel::new(&week());
    let mut on_time = door(0, 10);
    let late: Vec<Sample> = on_time.drain(300..400).collect();
    state.update(&week(), OrderCriterion::SquaredError, on_time);
    let before = state.clone();
    let outcome = state.update(&week(), OrderCriterion::SquaredError, late);
    assert_eq!((outcome.observations, outcome.scored), (100, 0));
    assert_eq!(state.errors(), before.errors());
    assert_eq!(state.accumulator().observations(), 1440);
}

#[test]
fn clocks_set_back_over_midnight_do_not_begin_the_day_twice() {
    // St John's 2006: at 00:01 the clocks went back to 23:01, so the date goes back for an hour.
    let at = |minute: i64| Sample {
        utc_nanos: 13_450 * DAY_NANOS + minute * MINUTE_NANOS,
        offset_secs: if minute < 151 { -9_000 } else { -12_600 },
        value: 0.5,
    };
    let samples: Vec<Sample> = (0..600).map(at).collect();
    let mut state = StateModel::new(&week());
    let outcome = state.update(&week(), OrderCriterion::SquaredError, samples);
    // The 150 minutes of the first day have no predecessor; all later ones belong to the second.
    assert_eq!((outcome.observations, outcome.scored), (600, 450));
}

#[test]
fn with_a_half_life_an_old_routine_is_unlearned() {
    // The door is open by day for eight weeks, then by night.
    let mut samples = door(0, 56);
    samples.extend(door(56, 21).into_iter().map(|sample| Sample { value: 1.0 - sample.value, ..sample }));
    let squared = |half_life_days| {
        let mut state = StateModel::new(&week());
        let models = crate::EnabledModels::default().without_ensemble();
        let rules = UpdateRules { half_life_days, models, ..UpdateRules::default() };
        state.update(&week(), rules, samples.clone());
        let next: Vec<Sample> =
            door(77, 7).into_iter().map(|sample| Sample { value: 1.0 - sample.value, ..sample }).collect();
        state.update(&week(), rules, next).squared_error_in_force
    };
    let (for_ever, forgetting) = (squared(None), squared(Some(5.0)));
    assert!(forgetting < 0.6 * for_ever, "{forgetting} with a half-life, {for_ever} without");
}

#[test]
fn forgetting_does_not_depend_on_the_order_of_days() {
    let rules = UpdateRules { half_life_days: Some(3.0), ..UpdateRules::default() };
    let (mut in_order, mut late) = (StateModel::new(&week()), StateModel::new(&week()));
    in_order.update(&week(), rules, door(0, 10));
    let (early, rest): (Vec<Sample>, Vec<Sample>) =
        door(0, 10).into_iter().partition(|sample| sample.local_day().0 == 4);
    late.update(&week(), rules, rest);
    late.update(&week(), rules, early);
    let (one, other) = (in_order.accumulator().to_parts(), late.accumulator().to_parts());
    assert_eq!((one.observations, one.first_nanos), (other.observations, other.first_nanos));
    assert!((one.weight - other.weight).abs() < 1e-9 && (one.sum - other.sum).abs() < 1e-9);
    for (a, b) in one.spectrum.as_flattened().iter().zip(other.spectrum.as_flattened()) {
        assert!((a - b).abs() < 1e-9);
    }
    let weight = |state: &StateModel| state.alternatives().unwrap().hours().weight(30);
    assert!((weight(&in_order) - weight(&late)).abs() < 1e-9);
}

#[test]
fn a_routine_of_the_clock_and_the_kind_of_day_chooses_the_model_that_has_it() {
    // One hour, on weekdays only: few components cannot describe this.
    let sharp = |days: i64| {
        let open = |slot: i64| (60..66).contains(&(slot % 144)) && (slot / 144 + 3) % 7 < 5;
        let sample = move |slot: i64| Sample {
            utc_nanos: slot * 10 * MINUTE_NANOS,
            offset_secs: 0,
            value: f64::from(u8::from(open(slot))),
        };
        (0..days * 144).map(sample).collect::<Vec<Sample>>()
    };
    let mut state = StateModel::new(&week());
    state.update(&week(), OrderCriterion::SquaredError, sharp(28));
    let errors: Vec<_> = state.alternatives().unwrap().error_sums().collect();
    assert!(matches!(state.choice(), ModelKind::Histogram { .. }), "{errors:?}");
    assert!(matches!(
        state.chosen(&Periodicities::default()),
        Some(ActiveModel::Histogram(_) | ActiveModel::Combination(_))
    ));
}

#[test]
fn a_change_of_routine_rings_the_alarm_until_it_is_history() {
    let mut state = StateModel::new(&week());
    state.update(&week(), OrderCriterion::SquaredError, door(0, 42));
    let rang = |state: &StateModel| state.alternatives().unwrap().alarm().alarm_day();
    assert_eq!(rang(&state), None);
    let changed: Vec<Sample> =
        door(42, 7).into_iter().map(|sample| Sample { value: 1.0 - sample.value, ..sample }).collect();
    state.update(&week(), OrderCriterion::SquaredError, changed);
    let day = rang(&state).expect("rings").0;
    assert!((43..49).contains(&day), "{day}");
}

#[test]
fn noise_has_no_rhythm() {
    // Failures at any time of day, each some hours long: twenty sequences.
    for seed in 0..20_u64 {
        let mut random = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let mut failed = false;
        let samples = (0..144 * 60_i64).map(|slot| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            if (random >> 33) % 24 == 0 {
                failed = (random >> 50) % 4 == 0;
            }
            Sample { utc_nanos: slot * 10 * MINUTE_NANOS, offset_secs: 0, value: f64::from(u8::from(failed)) }
        });
        let mut state = StateModel::new(&week());
        state.update(&week(), OrderCriterion::SquaredError, samples.collect());
        assert_eq!((state.order(), state.choice()), (0, ModelKind::Spectral), "seed {seed}");
    }
}

#[test]
fn parts_make_the_same_state_again() {
    let mut state = StateModel::new(&week());
    state.update(&week(), OrderCriterion::SquaredError, door(0, 9));
    let again = StateModel::from_parts(
        Accumulator::from_parts(&week(), state.accumulator().to_parts()).unwrap(),
        SpectralModel::from_parts(
            state.spectral().mean(),
            state.spectral().observations(),
            state.spectral().components().to_vec(),
        )
        .unwrap(),
        state.best_order(),
        OrderErrors::from_parts(state.errors().to_parts()).unwrap(),
    )
    .unwrap()
    .with_alternatives(Alternatives::from_parts(state.alternatives().unwrap().to_parts()).unwrap())
    .with_belief(state.belief().unwrap().clone());
    assert_eq!(again, state);
    let too_high =
        StateModel::from_parts(Accumulator::new(&week()), SpectralModel::default(), 16, OrderErrors::default());
    assert_eq!(too_high, Err(InvalidParts::OrderTooHigh { found: 16 }));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn batches_of_whole_days_in_any_inner_order_give_the_same_state(
        cuts in proptest::collection::vec(1_i64..12, 0..4),
        shuffled in Just(door(0, 12)).prop_shuffle(),
    ) {
        let mut at_once = StateModel::new(&week());
        let whole = at_once.update(&week(), OrderCriterion::SquaredError, door(0, 12));
        let mut cuts = cuts;
        cuts.extend([0, 12]);
        cuts.sort_unstable();
        let mut batched = StateModel::new(&week());
        let mut scored = 0;
        for cut in cuts.windows(2) {
            let days = cut[0] * DAY_NANOS..cut[1] * DAY_NANOS;
            let batch = shuffled.iter().copied().filter(|s| days.contains(&s.utc_nanos)).collect();
            scored += batched.update(&week(), OrderCriterion::SquaredError, batch).scored;
        }
        prop_assert_eq!(&batched, &at_once);
        prop_assert_eq!(scored, whole.scored);
    }
}

#[test]
fn a_published_model_predicts_the_same() {
    let periodicities = Periodicities::default();
    let sample = |slot: i64| Sample {
        utc_nanos: slot * 1_800_000_000_000,
        offset_secs: 3600,
        value: f64::from(u8::from((16..36).contains(&(slot % 48)) ^ (slot % 7 == 0))),
    };
    let mut model = StateModel::new(&periodicities);
    for week in 0..4 {
        let samples: Vec<Sample> = (week * 336..(week + 1) * 336).map(sample).collect();
        model.update(&periodicities, OrderCriterion::SquaredError, samples.clone());
        let day = samples.last().expect("readings").local_day();
        for kind in TRAINED_AT_NIGHT.into_iter().filter(|kind| kind.supports(StateKind::Probability)) {
            let readings = crate::models::Readings::new(&samples);
            if let Ok(trained) = kind.train(readings, StateKind::Probability, &periodicities) {
                model = model.with_trained(trained, day);
            }
        }
        let published = model.published();
        assert_eq!(published.published(), published);
        assert_eq!((published.order(), published.choice()), (model.order(), model.choice()));
        assert_eq!(published.spectral(), model.spectral());
        let (one, other) = (model.chosen(&periodicities), published.chosen(&periodicities));
        assert_eq!(one.is_some(), other.is_some());
        for (one, other) in one.iter().zip(&other) {
            for hour in 0..168 {
                let at = Moment { utc_nanos: 30 * 86_400_000_000_000 + hour * 3_600_000_000_000, offset_secs: 3600 };
                assert_eq!(one.predict(at).to_bits(), other.predict(at).to_bits(), "week {week}, hour {hour}");
            }
        }
    }
}
