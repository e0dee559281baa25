//! Tests with simulated truths and unusual input: a routine is found, without a routine the prediction is close to the
//! mean, and predictions always lie within the readings.

use proptest::prelude::*;
use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};

use super::*;
use crate::Sample;

const DAY_SECS: i64 = 86_400;
/// 2018-01-01, a Monday.
const MONDAY: i64 = 17_532;

/// A reading every five minutes of days `from..to`, by day and minute of the day.
fn simulated(from: i64, to: i64, mut value: impl FnMut(i64, i64) -> f64) -> Vec<Sample> {
    let times = (from..to).flat_map(|day| (0..1440).step_by(5).map(move |minute| (day, minute)));
    times
        .map(|(day, minute)| Sample {
            utc_nanos: ((MONDAY + day) * DAY_SECS + minute * 60) * NANOS_PER_SEC,
            offset_secs: 0,
            value: value(day, minute),
        })
        .collect()
}

fn trained(samples: &[Sample]) -> Calibrated {
    Calibrated::train(Readings::new(samples), CalibratedOptions::default()).unwrap()
}

fn at(day: i64, minute: i64) -> Moment {
    Moment { utc_nanos: ((MONDAY + day) * DAY_SECS + minute * 60) * NANOS_PER_SEC, offset_secs: 0 }
}

/// Squared error over days 70 to 84 with training on the 70 before, as a share of the squared error of the mean.
fn error_beside_the_mean(mut value: impl FnMut(i64, i64) -> f64) -> f64 {
    let (train, test) = (simulated(0, 70, &mut value), simulated(70, 84, &mut value));
    let mean = train.iter().map(|sample| sample.value).sum::<f64>() / train.len() as f64;
    let model = trained(&train);
    let of_model: f64 = test.iter().map(|sample| (model.predict(sample.moment()) - sample.value).powi(2)).sum();
    let of_mean: f64 = test.iter().map(|sample| (mean - sample.value).powi(2)).sum();
    let share = of_model / of_mean;
    println!("{share:.4} of the error of the mean");
    share
}

/// 1 within the minutes of the day, on most such days: a routine with rare exceptions.
fn event(random: &mut SmallRng, minute: i64, minutes: std::ops::Range<i64>) -> f64 {
    f64::from(u8::from(minutes.contains(&minute) != (random.random::<f64>() < 0.02)))
}

#[test]
fn a_short_daily_event_is_found() {
    let mut random = SmallRng::seed_from_u64(1);
    assert!(error_beside_the_mean(|_, minute| f64::from(u8::from((720..740).contains(&minute)))) < 0.2);
    assert!(error_beside_the_mean(|_, minute| event(&mut random, minute, 720..750)) < 0.6);
}

#[test]
fn two_events_a_day_are_found() {
    let mut random = SmallRng::seed_from_u64(2);
    let share = error_beside_the_mean(|_, minute| {
        event(&mut random, minute, 540..570).max(event(&mut random, minute, 1020..1080))
    });
    assert!(share < 0.5, "{share}");
}

#[test]
fn a_routine_of_weekdays_spares_the_weekend() {
    let mut random = SmallRng::seed_from_u64(3);
    let mut value = |day: i64, minute| if day % 7 < 5 { event(&mut random, minute, 540..1020) } else { 0.0 };
    assert!(error_beside_the_mean(&mut value) < 0.15);
    let model = trained(&simulated(0, 70, value));
    assert!(model.predict(at(70, 720)) > 0.9 && model.predict(at(75, 720)) < 0.05);
}

#[test]
fn a_slow_drift_is_followed() {
    // The share of days with somebody present falls from 0.9 to 0.5 over twelve weeks.
    let share_of_days = |day: i64| 0.9 - 0.4 * day as f64 / 84.0;
    for seed in 0..4 {
        let mut random = SmallRng::seed_from_u64(seed);
        let days: Vec<bool> = (0..84).map(|day| random.random::<f64>() < share_of_days(day)).collect();
        let train =
            simulated(0, 70, |day, minute| f64::from(u8::from(days[day as usize] && (540..1020).contains(&minute))));
        let even = CalibratedOptions { memory_days: f64::INFINITY, ..CalibratedOptions::default() };
        let unfading = Calibrated::train(Readings::new(&train), even).unwrap();
        let mean = train.iter().map(|sample| sample.value).sum::<f64>() / train.len() as f64;
        let error = |predict: &dyn Fn(Moment) -> f64| -> f64 {
            let moments = (70..84).flat_map(|day| (0..144).map(move |slot| (day, slot * 10 + 5)));
            moments
                .map(|(day, minute)| {
                    let truth = if (540..1020).contains(&minute) { share_of_days(day) } else { 0.0 };
                    (predict(at(day, minute)) - truth).powi(2) + truth * (1.0 - truth)
                })
                .sum()
        };
        let model = trained(&train);
        let (fading, unfading) = (error(&|at| model.predict(at)), error(&|at| unfading.predict(at)));
        let of_mean = error(&|_| mean);
        println!("{:.3} of the expected error of the mean, {:.3} without fading", fading / of_mean, unfading / of_mean);
        assert!(fading < 0.75 * of_mean);
        assert!(fading < 1.01 * unfading);
    }
}

#[test]
fn a_change_of_routine_is_taken_up() {
    // From the seventh week on, mornings become afternoons.
    let value = |day: i64, minute: i64| {
        let hours = if day < 42 { 540..720 } else { 840..1020 };
        f64::from(u8::from(hours.contains(&minute)))
    };
    let model = trained(&simulated(0, 70, value));
    assert!(model.predict(at(70, 930)) > 0.5 && model.predict(at(70, 630)) < 0.5);
    assert!(error_beside_the_mean(value) < 0.6);
}

#[test]
fn noise_costs_hardly_more_than_its_mean() {
    // The expected squared error of p is the variance, 0.21, plus (p - 0.3)².
    let mut excess_shares = Vec::new();
    for (seed, hold_minutes) in (0..8).flat_map(|seed| [5, 60, 240].map(|hold| (seed, hold))) {
        let mut random = SmallRng::seed_from_u64(seed);
        let mut held = 0.0;
        let train = simulated(0, 70, |_, minute| {
            if minute % hold_minutes == 0 {
                held = f64::from(u8::from(random.random::<f64>() < 0.3));
            }
            held
        });
        let mean = train.iter().map(|sample| sample.value).sum::<f64>() / train.len() as f64;
        let model = trained(&train);
        let week = (0..SLOTS_PER_WEEK as i64).map(|slot| (model.predict(at(70, slot * 10)) - 0.3).powi(2));
        let excess = week.sum::<f64>() / SLOTS_PER_WEEK as f64;
        let share = (0.21 + excess) / (0.21 + (mean - 0.3).powi(2)) - 1.0;
        println!("{share:+.4} beside the expected error of the mean, noise held for {hold_minutes} min");
        assert!(share < 0.03, "{share:+}, held for {hold_minutes} min");
        excess_shares.push(share);
    }
    assert!(excess_shares.iter().sum::<f64>() / (excess_shares.len() as f64) < 0.01);
}

#[test]
fn what_never_changes_is_predicted_as_it_is() {
    for constant in [0.0, 0.3, 1.0] {
        let model = trained(&simulated(0, 14, |_, _| constant));
        assert_eq!((model.predict(at(14, 0)), model.predict(at(200, 733))), (constant, constant));
    }
}

#[test]
fn what_was_never_seen_is_taken_from_what_was() {
    // The state is observed on weekdays only, from nine to five, and is open from noon.
    let seen = simulated(0, 28, |_, minute| f64::from(u8::from(minute >= 720)));
    let seen: Vec<Sample> = seen
        .into_iter()
        .filter(|sample| {
            let secs = sample.utc_nanos / NANOS_PER_SEC - MONDAY * DAY_SECS;
            secs / DAY_SECS % 7 < 5 && (32_400..61_200).contains(&(secs % DAY_SECS))
        })
        .collect();
    let model = trained(&seen);
    // The weekend has the prediction of any day, the night that of the mean.
    assert!(model.predict(at(33, 600)) < 0.2 && model.predict(at(33, 900)) > 0.8);
    let mean = seen.iter().map(|sample| sample.value).sum::<f64>() / seen.len() as f64;
    assert!((model.predict(at(30, 120)) - mean).abs() < 0.05, "{} {mean}", model.predict(at(30, 120)));
}

#[test]
fn one_day_is_no_routine() {
    let model = trained(&simulated(0, 1, |_, minute| f64::from(u8::from(minute >= 720))));
    for minute in [0, 300, 1000, 1400] {
        assert!((model.predict(at(1, minute)) - 0.5).abs() < 0.1);
    }
}

#[test]
fn looking_twice_is_not_seeing_more() {
    let once = simulated(0, 21, |day, minute| f64::from(u8::from((day + minute / 180) % 3 == 0)));
    let twice: Vec<Sample> = once.iter().flat_map(|&sample| [sample, sample]).collect();
    let (once, twice) = (trained(&once), trained(&twice));
    for (a, b) in once.parts.profile.iter().zip(&twice.parts.profile) {
        assert!((a - b).abs() < 1e-9);
    }
    assert_eq!(twice.observations(), 2 * once.observations());
}

#[test]
fn between_no_caution_and_all_caution_lie_the_histogram_and_the_mean() {
    let mut random = SmallRng::seed_from_u64(5);
    let samples = simulated(0, 28, |day, minute| {
        random.random::<f64>() * if minute < 720 { 0.3 } else { (1 + day % 7) as f64 / 7.0 }
    });
    let with = |caution| {
        let options = CalibratedOptions {
            smoothing_secs: 0.0,
            broad_smoothing_secs: 0.0,
            memory_days: f64::INFINITY,
            caution,
            day_of_week_caution: caution,
        };
        Calibrated::train(Readings::new(&samples), options).unwrap()
    };
    let (bold, timid) = (with(1e-12), with(f64::INFINITY));
    let mean = samples.iter().map(|sample| sample.value).sum::<f64>() / samples.len() as f64;
    for slot in 0..SLOTS_PER_WEEK {
        let of_slot: Vec<f64> = samples
            .iter()
            .filter(|sample| {
                let slots = (sample.utc_nanos / NANOS_PER_SEC - MONDAY * DAY_SECS) / 600;
                slots as usize % SLOTS_PER_WEEK == slot
            })
            .map(|sample| sample.value)
            .collect();
        let of_slot = of_slot.iter().sum::<f64>() / of_slot.len() as f64;
        let middle = at(0, slot as i64 * 10 + 5);
        assert!((bold.predict(middle) - of_slot).abs() < 1e-6, "slot {slot}");
        assert!((timid.predict(middle) - mean).abs() < 1e-9, "slot {slot}");
    }
}

#[test]
fn the_profile_is_straight_between_the_middles_of_slots() {
    let profile = (0..SLOTS_PER_WEEK).map(|slot| slot as f64).collect();
    let parts = CalibratedParts { observations: 1, lowest: 0.0, highest: 1007.0, profile };
    let model = Calibrated::from_parts(parts).unwrap();
    assert_eq!(model.predict(at(0, 5)), 0.0);
    assert_eq!(model.predict(at(0, 15)), 1.0);
    assert_eq!(model.predict(at(0, 10)), 0.5);
    // The interpolation wraps from the end of Sunday back to Monday.
    assert_eq!(model.predict(at(6, 1435)), 1007.0);
    assert_eq!(model.predict(at(7, 0)), 503.5);
    // An hour east of UTC the same moment is an hour later in the week.
    assert_eq!(model.predict(Moment { offset_secs: 3600, ..at(0, 5) }), 6.0);
}

#[test]
fn no_readings_and_options_outside_their_range_are_refused() {
    let train = |samples: &[Sample], options| Calibrated::train(Readings::new(samples), options);
    let default = CalibratedOptions::default();
    assert_eq!(train(&[], default), Err(CannotTrain::NoReadings));
    let one = Sample { utc_nanos: 0, offset_secs: 0, value: 0.7 };
    assert_eq!(train(&[Sample { value: f64::NAN, ..one }], default), Err(CannotTrain::NoReadings));
    for bad in [
        CalibratedOptions { smoothing_secs: -1.0, ..default },
        CalibratedOptions { broad_smoothing_secs: f64::NAN, ..default },
        CalibratedOptions { memory_days: 0.0, ..default },
        CalibratedOptions { caution: f64::NAN, ..default },
        CalibratedOptions { day_of_week_caution: -2.0, ..default },
    ] {
        assert!(matches!(train(&[one], bad), Err(CannotTrain::Parameter { .. })), "{bad:?}");
    }
    assert_eq!(train(&[one], default).unwrap().predict(at(0, 0)), 0.7);
}

#[test]
fn damaged_parts_are_refused() {
    let parts = trained(&simulated(0, 7, |day, _| day as f64 / 7.0)).to_parts();
    assert_eq!(Calibrated::from_parts(parts.clone()).unwrap().to_parts(), parts);
    let damaged: [fn(&mut CalibratedParts); 6] = [
        |parts| parts.profile.truncate(7),
        |parts| parts.profile[3] = f64::NAN,
        |parts| parts.profile[3] = 2.0,
        |parts| parts.observations = 0,
        |parts| parts.lowest = f64::NEG_INFINITY,
        |parts| parts.highest = -1.0,
    ];
    for damage in damaged {
        let mut parts = parts.clone();
        damage(&mut parts);
        assert!(Calibrated::from_parts(parts).is_err());
    }
}

/// Readings of any kind: tens of years apart or at one time, of any finite value.
fn any_samples() -> impl Strategy<Value = Vec<Sample>> {
    let value = prop_oneof![0.0..=1.0, Just(0.0), Just(1.0), Just(f64::MAX), Just(f64::MIN), -1e-300..1e-300];
    let gap = prop_oneof![Just(0_i64), 0..HOUR, 0..400 * 24 * HOUR, Just(i64::MAX / 4)];
    proptest::collection::vec((gap, -50_400..=50_400, value), 1..60).prop_map(|readings| {
        let mut utc_nanos = 0_i64;
        readings
            .into_iter()
            .map(|(gap, offset_secs, value)| {
                utc_nanos = utc_nanos.saturating_add(gap);
                Sample { utc_nanos, offset_secs, value }
            })
            .collect()
    })
}

const HOUR: i64 = 3600 * NANOS_PER_SEC;

proptest! {
    #[test]
    fn predictions_lie_among_the_readings(
        samples in any_samples(),
        half_life_secs in prop_oneof![Just(None), Just(Some(1e-9)), (1.0..1e9).prop_map(Some)],
        utc_nanos in any::<i64>(),
    ) {
        let readings = Readings { half_life_secs, ..Readings::new(&samples) };
        let model = Calibrated::train(readings, CalibratedOptions::default()).unwrap();
        let values = samples.iter().map(|sample| sample.value);
        let (lowest, highest) = (values.clone().fold(f64::MAX, f64::min), values.fold(f64::MIN, f64::max));
        let p = model.predict(Moment { utc_nanos, offset_secs: 3600 });
        prop_assert!((lowest..=highest).contains(&p), "{} not in {}..={}", p, lowest, highest);
        prop_assert_eq!(Calibrated::from_parts(model.to_parts()), Ok(model));
    }

    #[test]
    fn other_units_give_the_same_profile(seed in any::<u64>(), scale in 0.001_f64..1000.0, start in -1000.0_f64..1000.0) {
        let mut random = SmallRng::seed_from_u64(seed);
        let plain = simulated(0, 15, |_, minute| event(&mut random, minute, 600..800));
        let moved: Vec<Sample> =
            plain.iter().map(|&sample| Sample { value: start + scale * sample.value, ..sample }).collect();
        let (plain, moved) = (trained(&plain), trained(&moved));
        for (a, b) in plain.parts.profile.iter().zip(&moved.parts.profile) {
            prop_assert!((start + scale * a - b).abs() < 1e-9 * (start.abs() + scale));
        }
    }

    #[test]
    fn whole_weeks_earlier_or_later_make_no_difference(seed in any::<u64>(), weeks in 0..500_i64, minute in 0..10_080_i64) {
        let mut random = SmallRng::seed_from_u64(seed);
        let now = simulated(0, 15, |_, minute| event(&mut random, minute, 600..800));
        let moved: Vec<Sample> = now
            .iter()
            .map(|&sample| Sample { utc_nanos: sample.utc_nanos + weeks * 168 * HOUR, ..sample })
            .collect();
        let (now, moved) = (trained(&now), trained(&moved));
        prop_assert_eq!(now.predict(at(0, minute)), moved.predict(at(7 * weeks, minute)));
    }
}
