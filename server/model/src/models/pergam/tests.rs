//! Tests periodic Gaussian mixtures: the peaks that they find, and their robustness against any readings.

use proptest::prelude::*;

use super::*;
use crate::Sample;
use crate::civil::NANOS_PER_SEC;

const MINUTE: i64 = 60 * NANOS_PER_SEC;

fn minute(minute: i64) -> Moment {
    Moment { utc_nanos: minute * MINUTE, offset_secs: 0 }
}

/// One reading a minute for the given number of days; 1 if the predicate holds for the minute of the day.
fn days(count: i64, on: impl Fn(i64) -> bool) -> Vec<Sample> {
    let value = |minute: i64| f64::from(u8::from(on(minute % 1_440)));
    (0..count * 1_440).map(|m| Sample { utc_nanos: m * MINUTE, offset_secs: 0, value: value(m) }).collect()
}

fn train(samples: &[Sample], gaussians: usize) -> Pergam {
    Pergam::train(Readings::new(samples), &PergamOptions { gaussians, ..PergamOptions::default() }).unwrap()
}

fn sample(minute: i64, value: f64) -> Sample {
    Sample { utc_nanos: minute * MINUTE, offset_secs: 0, value }
}

#[test]
fn two_short_events_a_day_are_both_there() {
    let samples = days(7, |minute| (480..510).contains(&minute) || (1_140..1_200).contains(&minute));
    let model = train(&samples, 2);
    for (at, expected) in [(495, 1.0), (1_170, 1.0), (300, 0.0), (800, 0.0), (1_400, 0.0)] {
        let p = model.predict(minute(3 * 1_440 + at));
        assert!((p - expected).abs() < 0.1, "minute {at}: {p}");
    }
    let mut means: Vec<f64> = model.to_parts().gaussians.iter().map(|gaussian| gaussian.mean_secs / 60.0).collect();
    means.sort_by(f64::total_cmp);
    assert!((means[0] - 495.0).abs() < 2.0 && (means[1] - 1_170.0).abs() < 2.0, "{means:?}");
}

#[test]
fn an_event_across_midnight_is_one_event() {
    let model = train(&days(5, |minute| !(40..1_400).contains(&minute)), 1);
    let gaussian = model.to_parts().gaussians[0];
    let from_midnight = gaussian.mean_secs.min(86_400.0 - gaussian.mean_secs);
    assert!(from_midnight < 120.0, "{gaussian:?}");
    assert!(gaussian.deviation_secs < 40.0 * 60.0, "{gaussian:?}");
    assert!((model.predict(minute(1_439)) - model.predict(minute(1))).abs() < 0.05);
}

#[test]
fn phases_are_local() {
    let mut samples = days(5, |minute| (600..660).contains(&minute));
    for sample in &mut samples {
        sample.utc_nanos -= 3_600 * NANOS_PER_SEC;
        sample.offset_secs = 3_600;
    }
    let model = train(&samples, 1);
    let ten_thirty = Moment { utc_nanos: 34_200 * NANOS_PER_SEC, offset_secs: 3_600 };
    assert!(model.predict(ten_thirty) > 0.9);
    assert!(model.predict(Moment { offset_secs: 0, ..ten_thirty }) < 0.7);
}

#[test]
fn another_period_may_be_asked_for() {
    let samples = days(14, |_| true);
    let weekly: Vec<Sample> =
        samples.iter().map(|s| Sample { value: f64::from(u8::from(s.utc_nanos / DAY_NANOS % 7 == 2)), ..*s }).collect();
    let options = PergamOptions { gaussians: 1, period_nanos: 7 * DAY_NANOS, seed: 3 };
    let model = Pergam::train(Readings::new(&weekly), &options).unwrap();
    assert!(model.predict(minute(2 * 1_440 + 720)) > 0.9);
    assert!(model.predict(minute(5 * 1_440 + 720)) < 0.05);
    assert_eq!(model.period_secs(), 604_800.0);
}

#[test]
fn values_that_do_not_change_are_predicted() {
    for value in [0.0, 0.25, 1.0] {
        for count in [1, 2, 5_000] {
            let samples: Vec<Sample> = (0..count).map(|index| sample(index * 7, value)).collect();
            for gaussians in [1, 20] {
                let model = train(&samples, gaussians);
                for at in [0, 700, 1_439] {
                    let p = model.predict(minute(at));
                    assert!((p - value).abs() < 1e-6, "{count} of {value}, {gaussians} Gaussians, minute {at}: {p}");
                }
            }
        }
    }
}

#[test]
fn more_gaussians_than_phases_are_not_needed() {
    let mut samples = days(3, |_| false);
    for sample in samples.iter_mut().filter(|sample| [100, 900].contains(&(sample.utc_nanos / MINUTE % 1_440))) {
        sample.value = 1.0;
    }
    let model = train(&samples, 20);
    assert!(model.to_parts().gaussians.len() <= 2);
    assert!(model.predict(minute(100)) > 0.3 && model.predict(minute(500)) < 1e-6);
}

#[test]
fn what_cannot_be_trained_is_refused() {
    let samples = [sample(0, 1.0)];
    let with = |gaussians, period_nanos| {
        Pergam::train(Readings::new(&samples), &PergamOptions { gaussians, period_nanos, seed: 0 })
    };
    for gaussians in [0, 21, 1_000_000, usize::MAX] {
        assert!(matches!(with(gaussians, DAY_NANOS), Err(CannotTrain::Parameter { parameter: "gaussians", .. })));
    }
    for period in [i64::MIN, -1, 0, NANOS_PER_SEC - 1, i64::MAX] {
        assert!(matches!(with(3, period), Err(CannotTrain::Parameter { parameter: "period_secs", .. })), "{period}");
    }
    assert_eq!(Pergam::train(Readings::new(&[]), &PergamOptions::default()), Err(CannotTrain::NoReadings));
}

#[test]
fn broken_parts_are_refused() {
    let good = train(&days(2, |minute| minute < 300), 2).to_parts();
    assert!(Pergam::from_parts(&good).is_ok());
    let broken: [fn(&mut PergamParts); 6] = [
        |parts| parts.period_nanos = 0,
        |parts| parts.gaussians[0].weight = f64::NAN,
        |parts| parts.gaussians[0].weight = 1.5,
        |parts| parts.gaussians[0].mean_secs = -1.0,
        |parts| parts.gaussians[0].deviation_secs = 0.0,
        |parts| parts.gaussians = vec![parts.gaussians[0]; 21],
    ];
    for (index, damage) in broken.iter().enumerate() {
        let mut parts = good.clone();
        damage(&mut parts);
        assert!(Pergam::from_parts(&parts).is_err(), "{index}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_prediction_is_a_probability(
        readings in prop::collection::vec((-4e18..4e18, prop_oneof![Just(0.0), Just(1.0), 0.0..=1.0]), 1..30),
        gaussians in 1..=5_usize,
        period_secs in prop_oneof![Just(86_400_i64), 1..4_000_000_i64],
        half_life_secs in prop::option::of(1e-3..1e9),
        at in prop_oneof![Just(i64::MIN), Just(i64::MAX), any::<i64>()],
    ) {
        let mut samples: Vec<Sample> = readings
            .iter()
            .map(|&(nanos, value): &(f64, f64)| Sample { utc_nanos: nanos as i64, offset_secs: -3_600, value })
            .collect();
        samples.sort_by_key(|sample| sample.utc_nanos);
        let options = PergamOptions { gaussians, period_nanos: period_secs * NANOS_PER_SEC, seed: 1 };
        let model = Pergam::train(Readings { half_life_secs, ..Readings::new(&samples) }, &options).unwrap();
        prop_assert_eq!(&Pergam::from_parts(&model.to_parts()).unwrap(), &model);
        for moment in [samples[0].moment(), Moment { utc_nanos: at, offset_secs: 0 }] {
            let p = model.predict(moment);
            prop_assert!((0.0..=1.0).contains(&p), "{p}");
        }
    }

    #[test]
    fn a_wrapped_gaussian_is_a_density(mean in 0.0..1.0_f64, deviation in 0.001..1.0_f64) {
        let gaussian = WrappedGaussian { weight: 1.0, mean, deviation };
        let steps = 20_000;
        let sum: f64 = (0..steps).map(|step| gaussian.density(f64::from(step) / f64::from(steps))).sum();
        prop_assert!((sum / f64::from(steps) - 1.0).abs() < 1e-3);
    }
}
