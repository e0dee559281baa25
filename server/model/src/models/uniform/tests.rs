//! Tests the properties of `uniform.rs`: states come back exactly, and the spectrum is that of the incremental model.

use proptest::prelude::*;

use super::*;
use crate::{Accumulator, Periodicities, SpectralModel};

const MINUTE_NANOS: i64 = 60_000_000_000;
const WEEK_NANOS: i64 = 7 * 1440 * MINUTE_NANOS;

fn sample(utc_nanos: i64, state: bool) -> Sample {
    Sample { utc_nanos, offset_secs: 3600, value: f64::from(u8::from(state)) }
}

fn regular_samples(states: &[bool], interval_nanos: i64) -> Vec<Sample> {
    (0..).zip(states).map(|(step, &state)| sample(WEEK_NANOS + step * interval_nanos, state)).collect()
}

fn trained(samples: &[Sample], order: usize) -> UniformSpectral {
    UniformSpectral::train(Readings::new(samples), order).unwrap()
}

/// Two weeks, every ten minutes, of a door that is open in working hours, with a few exceptions.
fn office() -> Vec<bool> {
    let open = |step: usize| {
        let (day, hour) = (step / 144 % 7, step % 144 / 6);
        (day < 5 && (9..17).contains(&hour)) != (step % 97 == 13)
    };
    (0..2 * 7 * 144).map(open).collect()
}

#[test]
fn it_equals_the_incremental_model_where_the_periods_are_harmonics_of_the_span() {
    let samples = regular_samples(&office(), 10 * MINUTE_NANOS);
    let periodicities = Periodicities::harmonics(2 * WEEK_NANOS, 336).unwrap();
    let mut accumulator = Accumulator::new(&periodicities);
    accumulator.add(&periodicities, &samples);
    let incremental = SpectralModel::train(&accumulator, &periodicities);
    let model = trained(&samples, ORDER_MAX);
    assert!((model.mean() - incremental.mean()).abs() < 1e-9);
    for (found, expected) in model.components().iter().zip(incremental.components()) {
        assert_eq!(found.periodicity, expected.periodicity + 1);
        assert!((found.amplitude() - expected.amplitude()).abs() < 1e-9);
    }
    for order in [0, 1, 3, ORDER_MAX] {
        let model = model.with_order(order).unwrap();
        for sample in samples.iter().step_by(7) {
            let expected = incremental.predict(&periodicities, order, sample.civil_nanos());
            assert!((model.predict(sample.moment()) - expected).abs() < 1e-9);
            let later = Moment { utc_nanos: sample.utc_nanos + 3 * WEEK_NANOS + 12_345, ..sample.moment() };
            let expected = incremental.predict(&periodicities, order, later.civil_nanos());
            assert!((model.predict(later) - expected).abs() < 1e-9);
        }
    }
}

#[test]
fn predictions_follow_the_local_clock() {
    let model = trained(&regular_samples(&office(), 10 * MINUTE_NANOS), 5);
    let winter = Moment { utc_nanos: 5 * WEEK_NANOS + 9 * 60 * MINUTE_NANOS, offset_secs: 3600 };
    let summer = Moment { utc_nanos: winter.utc_nanos - 60 * MINUTE_NANOS, offset_secs: 7200 };
    assert!((model.predict(winter) - model.predict(summer)).abs() < 1e-12);
}

#[test]
fn the_outlier_set_holds_where_the_prediction_starts_and_stops_to_differ() {
    let mut states = vec![false; 100];
    states[20..23].fill(true);
    states[60] = true;
    let mut model = trained(&regular_samples(&states, MINUTE_NANOS), 0);
    assert_eq!(model.outliers(), [20, 23, 60, 61]);
    assert!((model.estimation_error() - 0.04).abs() < 1e-12);
    assert!((model.compression_ratio(true) - 100.0 / (288.0 + 4.0 * 8.0)).abs() < 1e-12);
    assert!((model.compression_ratio(false) - 100.0 / 288.0).abs() < 1e-12);
    model.append(&sample(WEEK_NANOS + 100 * MINUTE_NANOS, true)).unwrap();
    model.append(&sample(WEEK_NANOS + 101 * MINUTE_NANOS, true)).unwrap();
    assert_eq!(model.outliers(), [20, 23, 60, 61, 100]);
    assert!((model.estimation_error() - 6.0 / 102.0).abs() < 1e-12);
}

#[test]
fn components_pay_where_the_state_has_a_rhythm() {
    let samples = regular_samples(&office(), 10 * MINUTE_NANOS);
    let errors: Vec<f64> = [0, 2, 10].iter().map(|&order| trained(&samples, order).estimation_error()).collect();
    assert!(errors[0] > errors[1] && errors[1] > errors[2], "{errors:?}");
}

#[test]
fn the_error_names_the_usual_interval_and_the_first_reading_that_departs_from_it() {
    let samples = regular_samples(&office(), MINUTE_NANOS);
    let train_error = |samples: &[Sample]| UniformSpectral::train(Readings::new(samples), 2).unwrap_err();
    let first_secs = WEEK_NANOS as f64 / 1e9;
    let mut missing = samples.clone();
    missing.drain(40..70);
    let expected =
        CannotTrain::Irregular { interval_secs: 60.0, at_secs: first_secs + 70.0 * 60.0, after_secs: 31.0 * 60.0 };
    assert_eq!(train_error(&missing), expected);
    let message = train_error(&missing).to_string();
    assert!(message.contains("60 s apart") && message.contains("1860 s after") && message.contains("spectral"));
    let twice = [samples[0], samples[0], samples[0]];
    assert_eq!(
        train_error(&twice),
        CannotTrain::Irregular { interval_secs: 0.0, at_secs: first_secs, after_secs: 0.0 }
    );
    // Each reading is a little later than the one before: no single jump, but a drift.
    let mut drifting = samples[..1000].to_vec();
    for (i, sample) in (0..).zip(&mut drifting) {
        sample.utc_nanos += i * i * 100_000;
    }
    let CannotTrain::Irregular { interval_secs, after_secs, .. } = train_error(&drifting) else { panic!("irregular") };
    assert!((interval_secs - 60.1).abs() < 0.01 && (after_secs - interval_secs).abs() < 0.6);
}

#[test]
fn one_model_answers_and_recalls_at_every_lower_order() {
    let states = office();
    let samples = regular_samples(&states, 10 * MINUTE_NANOS);
    let highest = trained(&samples, ORDER_MAX);
    for order in [0, 1, 4, ORDER_MAX] {
        let model = trained(&samples, order);
        let mut outliers = 0;
        for (step, sample) in (0..).zip(&samples) {
            let p = highest.predict_at_order(order, sample.moment());
            assert!((p - model.predict(sample.moment())).abs() < 1e-12);
            let changes = model.outliers().iter().filter(|&&change| change <= step).count();
            let expected = (changes % 2 == 1).then_some(states[step as usize]);
            assert_eq!(highest.outlier_at(order, sample.moment()), expected, "order {order}, step {step}");
            // The reading nearest to a moment counts.
            let near = Moment { utc_nanos: sample.utc_nanos + 4 * MINUTE_NANOS, ..sample.moment() };
            assert_eq!(highest.outlier_at(order, near), expected);
            outliers += usize::from(expected.is_some());
        }
        assert!(outliers > 10, "{outliers}");
        let beyond =
            |steps: i64| Moment { utc_nanos: samples[0].utc_nanos + steps * 10 * MINUTE_NANOS, offset_secs: 3600 };
        assert_eq!(highest.outlier_at(order, beyond(-1)), None);
        assert_eq!(highest.outlier_at(order, beyond(states.len() as i64)), None);
    }
}

#[test]
fn irregular_samples_are_refused() {
    let states = office();
    let samples = regular_samples(&states, MINUTE_NANOS);
    let refused = |samples: &[Sample]| {
        let found = UniformSpectral::train(Readings::new(samples), 2);
        matches!(found, Err(CannotTrain::Parameter { .. } | CannotTrain::Irregular { .. }))
    };
    assert!(!refused(&samples));
    let mut missing = samples.clone();
    missing.remove(40);
    assert!(refused(&missing));
    let mut late = samples.clone();
    late[40].utc_nanos += MINUTE_NANOS / 200;
    assert!(!refused(&late));
    late[40].utc_nanos += MINUTE_NANOS / 50;
    assert!(refused(&late));
    assert!(refused(&[samples[0], samples[0]]));
    assert!(refused(&samples[..1]));
    assert_eq!(UniformSpectral::train(Readings::new(&[]), 2), Err(CannotTrain::NoReadings));
    for value in [0.5, f64::NAN, -1.0] {
        let mut unsure = samples.clone();
        unsure[3].value = value;
        assert!(refused(&unsure));
    }
    assert!(UniformSpectral::train(Readings::new(&samples), ORDER_MAX + 1).is_err());
    assert!(trained(&samples, 2).with_order(ORDER_MAX + 1).is_err());
    // An appended reading must be the next one.
    let mut model = trained(&samples[..100], 2);
    let before = model.clone();
    assert!(model.append(&samples[101]).is_err());
    assert!(model.append(&samples[99]).is_err());
    assert!(model.append(&Sample { value: 0.5, ..samples[100] }).is_err());
    assert_eq!(model, before);
    model.append(&samples[100]).unwrap();
    assert_eq!(model.reconstruct(), states[..101]);
}

#[test]
fn times_at_the_ends_of_the_range_are_taken() {
    let samples = [sample(i64::MIN, true), sample(-1, false), sample(i64::MAX - 1, true)];
    let model = trained(&samples, 1);
    assert_eq!(model.reconstruct(), [true, false, true]);
    for utc_nanos in [i64::MIN, 0, i64::MAX] {
        let p = model.predict(Moment { utc_nanos, offset_secs: i32::MAX });
        assert!((0.0..=1.0).contains(&p), "{p}");
    }
}

#[test]
fn damaged_parts_are_refused() {
    let good = trained(&regular_samples(&office(), MINUTE_NANOS), 3).to_parts();
    assert!(good.outlier_gaps.len() > 2);
    let damaged = |change: &dyn Fn(&mut UniformSpectralParts)| {
        let mut parts = good.clone();
        change(&mut parts);
        UniformSpectral::from_parts(parts).is_err()
    };
    assert!(!damaged(&|_| ()));
    assert!(damaged(&|parts| parts.interval_nanos = 0));
    assert!(damaged(&|parts| parts.trained_steps = parts.steps + 1));
    assert!(damaged(&|parts| parts.trained_steps = 0));
    assert!(damaged(&|parts| parts.mean = f64::NAN));
    assert!(damaged(&|parts| parts.components = vec![parts.components[0]; 16]));
    assert!(damaged(&|parts| parts.components[0].periodicity = 0));
    assert!(damaged(&|parts| parts.components[0].gamma_re = 2.0));
    // The gaps are an outlier twice, one beyond the end, one cut short and one that never ends.
    for gap in [vec![0], vec![0x80, 0x7f], vec![0x81], vec![0xff; 6]] {
        assert!(damaged(&|parts| parts.outlier_gaps.extend(&gap)), "{gap:?}");
    }
}

proptest! {
    #[test]
    fn every_state_comes_back_whatever_the_order(
        states in prop::collection::vec(any::<bool>(), 2..300),
        appended in prop::collection::vec(any::<bool>(), 0..100),
        order in 0..=ORDER_MAX,
        next_order in 0..=ORDER_MAX,
    ) {
        let all = [states.as_slice(), appended.as_slice()].concat();
        let samples = regular_samples(&all, MINUTE_NANOS);
        let mut model = trained(&samples[..states.len()], order);
        prop_assert_eq!(&model.reconstruct(), &states);
        for sample in &samples[states.len()..] {
            model.append(sample).unwrap();
        }
        let model = UniformSpectral::from_parts(model.to_parts()).unwrap();
        prop_assert_eq!(&model.reconstruct(), &all);
        for (step, &state) in all.iter().enumerate() {
            prop_assert_eq!(model.state(step as u32), Some(state));
        }
        prop_assert_eq!(model.state(all.len() as u32), None);
        let updated = model.with_order(next_order).unwrap();
        prop_assert_eq!(&updated.reconstruct(), &all);
        prop_assert_eq!(&updated, &trained(&samples, next_order));
        let wrong = updated.with_order(0).unwrap().estimation_error();
        let ones = all.iter().filter(|&&state| state).count() as f64 / all.len() as f64;
        prop_assert!((wrong - ones.min(1.0 - ones)).abs() < 1e-12);
    }
}

#[test]
fn gaps_of_any_size_are_kept() {
    let steps = [0, 1, 128, 255, 16_512, 3_000_000, u32::MAX - 1];
    let (mut bytes, mut last) = (Vec::new(), 0);
    for step in steps {
        gaps::push(&mut bytes, step - last);
        last = step;
    }
    assert_eq!(gaps::decode(&bytes, u32::MAX), Ok(steps.to_vec()));
    assert!(gaps::decode(&bytes, u32::MAX - 1).is_err());
}
