//! Tests of states that are not probabilities: their learned data, and that the unit does not matter.

use proptest::prelude::*;

use super::*;
use crate::{Alternatives, StateKind, evaluate::score_samples};

const MINUTE_NANOS: i64 = 60_000_000_000;

/// Values every ten minutes for some days: a mean with a daily rhythm, and noise without one.
fn rhythm(days: i64, seed: u64) -> Vec<f64> {
    let mut state = seed | 1;
    let mut noise = move || {
        // Marsaglia's xorshift.
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state as f64 / u64::MAX as f64
    };
    let value = |slot: i64| {
        let turns = slot as f64 / 144.0;
        (0.5 + 0.35 * (std::f64::consts::TAU * turns).sin() + 0.3 * (noise() - 0.5)).clamp(0.0, 1.0)
    };
    (0..days * 144).map(value).collect()
}

fn samples(values: &[f64], scaled: impl Fn(f64) -> f64) -> Vec<Sample> {
    let sample = |(slot, &value): (i64, &f64)| Sample {
        utc_nanos: 1_700_000_000_000_000_000 + slot * 10 * MINUTE_NANOS,
        offset_secs: 3600,
        value: scaled(value),
    };
    (0..).zip(values).map(sample).collect()
}

fn learned(kind: StateKind, samples: &[Sample], rules: impl Into<UpdateRules>) -> StateModel {
    let mut model = StateModel::of_kind(kind);
    model.update(&Periodicities::default(), rules.into(), samples.to_vec());
    model
}

fn predicted(model: &StateModel, samples: &[Sample]) -> Vec<f64> {
    let periodicities = Periodicities::default();
    let value = |sample: &Sample| {
        model.spectral().predict_value(model.kind(), &periodicities, model.order(), sample.civil_nanos())
    };
    samples.iter().map(value).collect()
}

#[test]
fn a_speed_is_learned_in_its_own_unit_and_beyond_zero_and_one() {
    let learn = samples(&rhythm(21, 5), |value| 40.0 * value - 10.0);
    let model = learned(StateKind::Continuous, &learn, OrderCriterion::SquaredError);
    assert!((model.spectral().mean() - 10.0).abs() < 0.5, "{}", model.spectral().mean());
    assert!(model.order() >= 1);
    let expected = predicted(&model, &learn[..144]);
    let (low, high) = expected.iter().fold((f64::MAX, f64::MIN), |(low, high), &p| (low.min(p), high.max(p)));
    assert!(low < 0.0 && high > 20.0, "{low} {high}");
    let squared: f64 = expected.iter().zip(&learn).map(|(p, sample)| (p - sample.value).powi(2)).sum();
    // The noise is uniform with a width of 12, so its variance is 12.
    assert!((squared / 144.0 - 12.0).abs() < 3.0, "{}", squared / 144.0);
}

#[test]
fn a_state_of_numbers_with_no_learned_data_predicts_0() {
    for kind in [StateKind::Continuous, StateKind::Count] {
        let model = StateModel::of_kind(kind);
        assert_eq!((model.spectral().mean(), model.kind(), model.usual_change()), (0.0, kind, 1.0));
    }
    assert_eq!(StateModel::of_kind(StateKind::Probability), StateModel::new(&Periodicities::default()));
}

#[test]
fn predictions_of_counts_are_never_below_zero() {
    let learn = samples(&rhythm(14, 9), |value| (30.0 * (value - 0.6).max(0.0)).round());
    let model = learned(StateKind::Count, &learn, OrderCriterion::SquaredError);
    let expected = predicted(&model, &learn);
    assert!(model.order() > 0 && expected.iter().all(|&p| p >= 0.0), "order {}", model.order());
    assert!(expected.contains(&0.0));
}

#[test]
fn the_sides_of_one_half_decide_nothing() {
    let learn = samples(&rhythm(14, 3), |value| 900.0 * value);
    let [squared, zero_one] = [OrderCriterion::SquaredError, OrderCriterion::ZeroOne]
        .map(|criterion| learned(StateKind::Continuous, &learn, criterion));
    assert_eq!(squared, zero_one);
}

#[test]
fn a_change_of_routine_rings_the_alarm_whatever_the_unit() {
    let values: Vec<f64> =
        rhythm(80, 11).iter().enumerate().map(|(slot, v)| if slot / 144 < 60 { *v } else { 1.0 - *v }).collect();
    for scale in [1e-6, 1.0, 1e9] {
        let model = learned(StateKind::Continuous, &samples(&values, |v| scale * v), OrderCriterion::SquaredError);
        let alarm = model.alternatives().map(|known| known.alarm().alarm_day());
        let day = alarm.flatten().unwrap_or_else(|| panic!("it does not ring at {scale}"));
        let first = LocalDay::of_civil_nanos(samples(&values, |v| v)[0].civil_nanos());
        assert!((60..70).contains(&(day.0 - first.0)), "{scale}: day {}", day.0 - first.0);
    }
}

#[test]
fn parts_come_back_and_only_as_what_they_are() {
    let periodicities = Periodicities::default();
    let learn = samples(&rhythm(9, 7), |value| 1e12 * (2.0 * value - 1.0));
    let model = learned(StateKind::Continuous, &learn, OrderCriterion::SquaredError);
    let parts = model.accumulator().to_parts();
    let again = Accumulator::from_parts_of(StateKind::Continuous, &periodicities, parts.clone());
    assert_eq!(again.as_ref(), Ok(model.accumulator()));
    assert!(Accumulator::from_parts(&periodicities, parts).is_err());
    let components = model.spectral().components().to_vec();
    let spectral = |kind| SpectralModel::from_parts_of(kind, model.spectral().mean(), 1296, components.clone());
    assert_eq!(spectral(StateKind::Continuous).as_ref(), Ok(model.spectral()));
    assert!(spectral(StateKind::Probability).is_err());
    let known = model.alternatives().map(|known| known.to_parts()).unwrap();
    assert_eq!(Alternatives::from_parts_of(StateKind::Continuous, known).as_ref().ok(), model.alternatives());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    /// Numbers in another unit, with another zero, give an equivalent model; so do those of a probability, except for
    /// saturation.
    #[test]
    fn the_unit_does_not_matter(seed in any::<u64>(), scale in 1e-3..1e6_f64, shift in -5.0..5.0_f64) {
        let periodicities = Periodicities::default();
        let values = rhythm(12, seed);
        let unit = samples(&values, |value| value);
        let of_unit = learned(StateKind::Continuous, &unit, OrderCriterion::SquaredError);
        let probability = learned(StateKind::Probability, &unit, OrderCriterion::SquaredError);
        prop_assert_eq!(probability.spectral(), of_unit.spectral());
        let scaled = samples(&values, |value| scale * (value + shift));
        let model = learned(StateKind::Continuous, &scaled, OrderCriterion::SquaredError);
        for (order, &sum) in model.errors().sums().iter().enumerate() {
            prop_assert!(sum.is_finite() && sum >= 0.0);
            let expected = of_unit.errors().sums()[order] * scale * scale;
            prop_assert!(f64::abs(sum - expected) <= 1e-6 * expected, "order {order}: {sum} {expected}");
        }
        prop_assert_eq!((model.best_order(), model.choice()), (of_unit.best_order(), of_unit.choice()));
        let mean = scale * (of_unit.spectral().mean() + shift);
        prop_assert!((model.spectral().mean() - mean).abs() <= 1e-9 * scale * (1.0 + shift.abs()));
        for (a, b) in model.spectral().components().iter().zip(of_unit.spectral().components()).take(3) {
            prop_assert!((a.amplitude() - scale * b.amplitude()).abs() <= 1e-6 * scale, "{a:?} {b:?}");
        }
        // The fast scoring equals the plain one.
        let score = score_samples(StateKind::Continuous, model.spectral(), &periodicities, &scaled[..200]);
        for order in [0, 1, 7, ORDER_MAX] {
            let error = |sample: &Sample| {
                let p = model.spectral().predict_value(model.kind(), &periodicities, order, sample.civil_nanos());
                (p - sample.value).powi(2)
            };
            let naive: f64 = scaled[..200].iter().map(error).sum();
            prop_assert!((score.squared[order] - naive).abs() <= 1e-6 * naive + 1e-9 * scale * scale, "order {order}");
        }
    }
}
