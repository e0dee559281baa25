//! Tests warped hypertime of one state: the rhythms that it finds, and its robustness against any readings.

use proptest::prelude::*;

use super::*;
use crate::Sample;
use crate::civil::NANOS_PER_SEC;

const MINUTE: i64 = 60 * NANOS_PER_SEC;
const BOTH: [HypertimeMethod; 2] = [HypertimeMethod::Em, HypertimeMethod::Km];

fn minute(minute: i64) -> Moment {
    Moment { utc_nanos: minute * MINUTE, offset_secs: 0 }
}

/// A reading every half hour for the given number of days, of a function of the day and the hour.
fn days(count: i64, value: impl Fn(i64, f64) -> f64) -> Vec<Sample> {
    (0..count * 48)
        .map(|slot| Sample {
            utc_nanos: slot * 30 * MINUTE,
            offset_secs: 0,
            value: value(slot / 48, (slot % 48) as f64 / 2.0),
        })
        .collect()
}

fn options(method: HypertimeMethod, clusters: usize) -> HypertimeOptions {
    HypertimeOptions { method, clusters, seed: 0 }
}

fn of_week(divisor: u32) -> HypertimePeriod {
    HypertimePeriod { cycle_nanos: 7 * 1_440 * MINUTE, divisor }
}

fn on(condition: bool) -> f64 {
    f64::from(u8::from(condition))
}

#[test]
fn two_events_a_day_are_both_there() {
    let samples = days(10, |_, hour| on((8.0..10.0).contains(&hour) || (15.0..18.0).contains(&hour)));
    for method in BOTH {
        let model = Hypertime::train(Readings::new(&samples), &Periodicities::default(), &options(method, 4)).unwrap();
        let periods = model.periods_secs();
        assert!(periods.contains(&86_400.0), "{method:?}: {periods:?}");
        for (hour, expected) in [(9, 1.0), (16, 1.0), (3, 0.0), (12, 0.0), (23, 0.0)] {
            let p = model.predict(minute(20 * 1_440 + hour * 60));
            assert!((p - expected).abs() < 0.25, "{method:?}, {hour}:00: {p}");
        }
    }
}

#[test]
fn a_weekend_is_not_a_working_day() {
    let samples = days(28, |day, hour| on(day % 7 < 5 && (9.0..17.0).contains(&hour)));
    for method in BOTH {
        let model = Hypertime::train(Readings::new(&samples), &Periodicities::default(), &options(method, 3)).unwrap();
        let periods = model.periods_secs();
        assert!(periods.contains(&86_400.0), "{method:?}: {periods:?}");
        let (workday, weekend) =
            (model.predict(minute(37 * 1_440 + 13 * 60)), model.predict(minute(40 * 1_440 + 13 * 60)));
        assert!(workday > 0.8 && weekend < 0.3, "{method:?}: {workday}, {weekend}");
    }
}

#[test]
fn where_there_is_no_rhythm_there_is_no_period() {
    // The values are drawn by a linear congruence.
    let mut state = 1_u64;
    let mut draw = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1_u32 << 31)
    };
    let samples: Vec<Sample> =
        days(20, |_, _| 0.0).into_iter().map(|sample| Sample { value: on(draw() < 0.3), ..sample }).collect();
    for method in BOTH {
        let model = Hypertime::train(Readings::new(&samples), &Periodicities::default(), &options(method, 3)).unwrap();
        assert!(model.periods_secs().is_empty(), "{method:?}: {:?}", model.periods_secs());
        assert!((model.predict(minute(500)) - 0.3).abs() < 0.03);
    }
}

#[test]
fn the_mean_prediction_is_the_mean() {
    let samples = days(14, |_, hour| 0.2 + 0.6 * on((6.0..9.0).contains(&hour)));
    let mean = samples.iter().map(|sample| sample.value).sum::<f64>() / samples.len() as f64;
    for method in BOTH {
        let model = Hypertime::train(Readings::new(&samples), &Periodicities::default(), &options(method, 2)).unwrap();
        assert!(!model.periods_secs().is_empty());
        let predicted = samples.iter().map(|sample| model.predict(sample.moment())).sum::<f64>();
        assert!((predicted / samples.len() as f64 - mean).abs() < 1e-3, "{method:?}");
    }
}

#[test]
fn a_number_that_is_no_probability_follows_its_day() {
    let value = |_, hour: f64| 20.0 + 15.0 * (std::f64::consts::TAU * hour / 24.0).sin();
    let samples = days(12, value);
    for (method, clusters, tolerance) in [(HypertimeMethod::Em, 1, 0.5), (HypertimeMethod::Km, 30, 6.0)] {
        let model =
            Hypertime::train_continuous(Readings::new(&samples), &Periodicities::default(), &options(method, clusters))
                .unwrap();
        assert_eq!(model.periods_secs().first(), Some(&86_400.0));
        for hour in 0..24 {
            let (found, expected) = (model.predict(minute(30 * 1_440 + hour * 60)), value(0, hour as f64));
            assert!((found - expected).abs() < tolerance, "{method:?}, {hour}:00: {found}, expected {expected}");
        }
    }
}

#[test]
fn values_that_do_not_change_are_predicted() {
    for method in BOTH {
        for value in [0.0, 0.5, 1.0] {
            for count in [1, 2, 3, 2_000] {
                let samples: Vec<Sample> =
                    (0..count).map(|i| Sample { utc_nanos: i * 11 * MINUTE, offset_secs: 0, value }).collect();
                let readings = Readings::new(&samples);
                for model in [
                    Hypertime::train(readings, &Periodicities::default(), &options(method, 3)).unwrap(),
                    Hypertime::train_continuous(readings, &Periodicities::default(), &options(method, 3)).unwrap(),
                ] {
                    let p = model.predict(minute(77));
                    // A value of one half counts equally as 1 and 0, and may give a model that is constant up to
                    // rounding.
                    assert!((p - value).abs() < 1e-6, "{method:?}, {count} of {value}: {p}");
                }
            }
        }
    }
}

#[test]
fn two_readings_ten_years_apart_carry_little_information() {
    let at = |utc_nanos, value| Sample { utc_nanos, offset_secs: 0, value };
    let ten_years = 3_652 * 86_400 * NANOS_PER_SEC;
    for samples in [[at(0, 0.0), at(ten_years, 1.0)], [at(5, 0.0), at(5, 1.0)], [at(i64::MIN, 1.0), at(i64::MAX, 0.0)]]
    {
        for method in BOTH {
            let model =
                Hypertime::train(Readings::new(&samples), &Periodicities::default(), &options(method, 50)).unwrap();
            for moment in [minute(0), minute(123_456), samples[1].moment()] {
                let p = model.predict(moment);
                assert!((0.0..=1.0).contains(&p), "{p}");
            }
            assert!((model.predict(minute(5_000)) - 0.5).abs() < 0.4);
        }
    }
}

#[test]
fn what_cannot_be_trained_is_refused() {
    let samples = [Sample { utc_nanos: 0, offset_secs: 0, value: 1.0 }];
    for method in BOTH {
        for clusters in [0, 51, 1_000_000, usize::MAX] {
            for refused in [
                Hypertime::train(Readings::new(&samples), &Periodicities::default(), &options(method, clusters)),
                Hypertime::train_continuous(
                    Readings::new(&samples),
                    &Periodicities::default(),
                    &options(method, clusters),
                ),
            ] {
                assert!(matches!(refused, Err(CannotTrain::Parameter { parameter: "clusters", .. })), "{clusters}");
            }
        }
        assert_eq!(
            Hypertime::train(Readings::new(&[]), &Periodicities::default(), &options(method, 1)),
            Err(CannotTrain::NoReadings)
        );
        assert_eq!(
            Hypertime::train_continuous(Readings::new(&[]), &Periodicities::default(), &options(method, 1)),
            Err(CannotTrain::NoReadings)
        );
    }
}

#[test]
fn a_stored_model_predicts_the_same() {
    let samples = days(14, |day, hour| on((8.0..10.0).contains(&hour) && day % 7 != 6));
    for method in BOTH {
        for model in [
            Hypertime::train(Readings::new(&samples), &Periodicities::default(), &options(method, 3)).unwrap(),
            Hypertime::train_continuous(Readings::new(&samples), &Periodicities::default(), &options(method, 3))
                .unwrap(),
        ] {
            assert!(!model.periods_secs().is_empty());
            assert_eq!(Hypertime::from_parts(&model.to_parts()).unwrap(), model);
        }
    }
}

#[test]
fn broken_parts_are_refused() {
    let samples = days(14, |_, hour| on((8.0..10.0).contains(&hour)));
    let odds = BOTH.map(|method| {
        Hypertime::train(Readings::new(&samples), &Periodicities::default(), &options(method, 2)).unwrap().to_parts()
    });
    let odds = odds.map(|parts| match parts {
        HypertimeParts::Probability(parts) => parts,
        HypertimeParts::Continuous(_) => panic!("not a probability"),
    });
    let broken: [fn(&mut HypertimeOddsParts); 10] = [
        |parts| parts.mean = f64::NAN,
        |parts| parts.background = 0.0,
        |parts| parts.log_ones = f64::INFINITY,
        |parts| parts.gain = 0.0,
        |parts| parts.periods[0].divisor = 401,
        |parts| parts.periods[0].cycle_nanos = 0,
        |parts| parts.periods = vec![of_week(7), of_week(7)],
        |parts| parts.periods.push(of_week(3)),
        |parts| parts.ones[0].weight = 2.0,
        |parts| parts.zeros = vec![parts.zeros[0].clone(); 51],
    ];
    for good in &odds {
        assert!(Hypertime::from_parts(&HypertimeParts::Probability(good.clone())).is_ok());
        for (index, damage) in broken.iter().enumerate() {
            let mut parts = good.clone();
            damage(&mut parts);
            assert!(Hypertime::from_parts(&HypertimeParts::Probability(parts)).is_err(), "{:?}, {index}", good.method);
        }
    }
    let [mut em, mut km] = odds;
    em.ones[0].factor[0] = -1.0;
    assert!(Hypertime::from_parts(&HypertimeParts::Probability(em)).is_err());
    km.ones[0].concentrations[0] = -1.0;
    assert!(Hypertime::from_parts(&HypertimeParts::Probability(km)).is_err());
}

#[test]
fn strange_but_valid_parts_have_an_answer() {
    let cluster = HypertimeCluster {
        weight: 0.0,
        centre: vec![1e9; 10],
        factor: (0..10).flat_map(|i| (0..=i).map(move |j| if i == j { 1e-3 } else { -1e9 })).collect(),
        directions_rad: Vec::new(),
        concentrations: Vec::new(),
    };
    let parts = HypertimeParts::Probability(HypertimeOddsParts {
        method: HypertimeMethod::Em,
        periods: [1, 2, 3, 4, 84].map(of_week).to_vec(),
        mean: 0.5,
        background: 1e-300,
        log_ones: 600.0,
        log_zeros: 600.0,
        gain: 1e10,
        ones: vec![cluster.clone(); 50],
        zeros: vec![cluster],
    });
    let p = Hypertime::from_parts(&parts).unwrap().predict(minute(1));
    assert!((0.0..=1.0).contains(&p), "{p}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn every_prediction_is_sound(
        readings in prop::collection::vec((0..40_000_i64, prop_oneof![Just(0.0), Just(1.0), 0.0..=1.0]), 1..40),
        scale in prop_oneof![Just(1.0), Just(1e-300), Just(1e300), Just(-1e12)],
        km in any::<bool>(),
        clusters in 1..=3_usize,
        half_life_secs in prop::option::of(1e-3..1e9),
        at in prop_oneof![Just(i64::MIN), Just(i64::MAX), any::<i64>()],
    ) {
        let mut samples: Vec<Sample> = readings
            .iter()
            .map(|&(minute, value): &(i64, f64)| Sample { utc_nanos: minute * MINUTE, offset_secs: 7_200, value })
            .collect();
        samples.sort_by_key(|sample| sample.utc_nanos);
        let options = options(if km { HypertimeMethod::Km } else { HypertimeMethod::Em }, clusters);
        let moments = [samples[0].moment(), Moment { utc_nanos: at, offset_secs: 0 }];

        let model = Hypertime::train(Readings { half_life_secs, ..Readings::new(&samples) }, &Periodicities::default(), &options).unwrap();
        prop_assert_eq!(&Hypertime::from_parts(&model.to_parts()).unwrap(), &model);
        for moment in moments {
            let p = model.predict(moment);
            prop_assert!((0.0..=1.0).contains(&p), "{}", p);
        }

        for sample in &mut samples {
            sample.value *= scale;
        }
        let (low, high) = samples
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), s| (low.min(s.value), high.max(s.value)));
        let model = Hypertime::train_continuous(Readings { half_life_secs, ..Readings::new(&samples) }, &Periodicities::default(), &options).unwrap();
        prop_assert_eq!(&Hypertime::from_parts(&model.to_parts()).unwrap(), &model);
        for moment in moments {
            let value = model.predict(moment);
            prop_assert!((low..=high).contains(&value), "{}", value);
            let distribution = model.distribution(moment).unwrap();
            prop_assert!(distribution.variance()[0].is_finite());
            for width in [0.0, 1.0, 1e300] {
                let density = distribution.density(&[value], &[width]).unwrap();
                prop_assert!(density.is_finite() && density >= 0.0, "{}", density);
            }
        }
    }
}

/// Open in summer, and shut in winter, but for the nights: readings every three hours over 800 days.
fn summers() -> Vec<Sample> {
    let year = 365.2425;
    (0..6_400)
        .map(|slot| {
            let (day, hour) = (slot as f64 / 8.0, slot % 8 * 3);
            let summer = (std::f64::consts::TAU * (day - 105.0) / year).sin() > 0.0;
            Sample { utc_nanos: slot * 180 * MINUTE, offset_secs: 0, value: on(summer && (6..21).contains(&hour)) }
        })
        .collect()
}

#[test]
fn a_year_is_found_where_the_map_has_it_and_where_the_readings_hold_it() {
    let samples = summers();
    let (train, test) = samples.split_at(5_200);
    let of_a_year = Periodicities::harmonics(365 * 86_400 * NANOS_PER_SEC, 1_000).expect("in range");
    for periodicities in [of_a_year, Periodicities::default()] {
        for method in BOTH {
            let model = Hypertime::train(Readings::new(train), &periodicities, &options(method, 3)).unwrap();
            let periods = model.periods_secs();
            let has = |secs: f64| periods.iter().any(|period| (period / secs - 1.0).abs() < 0.01);
            assert!(has(31_556_952.0) && has(86_400.0), "{method:?}: {periods:?}");
            let squared = test.iter().map(|sample| (model.predict(sample.moment()) - sample.value).powi(2));
            let error = squared.sum::<f64>() / test.len() as f64;
            assert!(error < 0.08, "{method:?}, {periods:?}: {error}");
            assert_eq!(Hypertime::from_parts(&model.to_parts()).as_ref(), Ok(&model));
        }
    }
}
