//! Tests the predictions of an ensemble against observations, on simulated states: seasons, few bins, hours without any
//! observation, readings in bursts, rotations, noise.
//!
//! Every number is drawn from a fixed sequence, so a test that passes once passes always.

#![allow(clippy::unwrap_used)]

use tidemap_model::{
    EnabledModels, LocalDay, Periodicities, Predictive, Sample, StateModel, UpdateRules, catalogue::ModelKind,
    models::Moment,
};

const DAY_SECS: i64 = 86_400;
const HOUR_SECS: i64 = 3_600;
/// A Monday.
const FIRST_DAY: i64 = 20_332;

/// A fixed sequence of numbers in `[0,1)` (G. Steele et al., "Fast splittable pseudorandom number generators", 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn below(&mut self, bound: i64) -> i64 {
        (self.next() * bound as f64) as i64
    }
}

fn flag(is: bool) -> f64 {
    f64::from(u8::from(is))
}

fn rules() -> UpdateRules {
    UpdateRules { models: EnabledModels::default().with(ModelKind::Ensemble), ..UpdateRules::default() }
}

fn at(day: i64, secs: i64) -> Moment {
    Moment { utc_nanos: ((FIRST_DAY + day) * DAY_SECS + secs) * 1_000_000_000, offset_secs: 0 }
}

/// A state that has learned days of (seconds of the day, value), night by night.
fn learned(days: i64, mut day: impl FnMut(i64) -> Vec<(i64, f64)>) -> StateModel {
    let periodicities = Periodicities::default();
    let mut state = StateModel::new(&periodicities);
    for number in 0..days {
        let mut readings = day(number);
        readings.sort_by_key(|(secs, _)| *secs);
        let sample =
            |(secs, value): (i64, f64)| Sample { utc_nanos: at(number, secs).utc_nanos, offset_secs: 0, value };
        state.update(&periodicities, rules(), readings.into_iter().map(sample).collect());
    }
    state
}

fn predicted(state: &StateModel, moments: &[Moment]) -> Vec<Predictive> {
    state.predictive(&Periodicities::default(), moments).unwrap()
}

fn value(state: &StateModel, day: i64, secs: i64) -> f64 {
    predicted(state, &[at(day, secs)])[0].value()
}

#[test]
fn a_half_year_is_known_for_the_year_after_wherever_the_record_ends() {
    let mut wrong = Vec::new();
    for end in (640..=1000).step_by(90) {
        let open = |day: i64| flag(day.rem_euclid(365) < 182);
        let mut random = Random(end as u64);
        let state = learned(end, |day| (0..8).map(|_| (random.below(48) * 1800, open(day))).collect());
        let days = end..end + 365;
        let is_wrong = |day: &i64| (value(&state, *day, random.below(24) * HOUR_SECS) - open(*day)).abs() > 0.5;
        wrong.push(days.filter(is_wrong).count() as f64 / 3.65);
    }
    let mean = wrong.iter().sum::<f64>() / wrong.len() as f64;
    assert!(mean <= 3.0 && wrong.iter().all(|&wrong| wrong <= 9.0), "{wrong:?} %");
}

#[test]
fn twelve_monthly_bins_show_the_year() {
    let (mut error, mut of_mean) = (0.0, 0.0);
    for seed in 0..12 {
        let phase = 31 * seed;
        let open = |day: i64| flag((day + phase).rem_euclid(365) < 182);
        let bins: Vec<i64> = (0..12).map(|month| month * 3044 / 100).collect();
        let end = bins[11] + 1;
        let state =
            learned(end, |day| if bins.contains(&day) { vec![(12 * HOUR_SECS, open(day))] } else { Vec::new() });
        for day in end..end + 365 {
            error += (value(&state, day, 12 * HOUR_SECS) - open(day)).powi(2) / 365.0 / 12.0;
            of_mean += 0.25 / 365.0 / 12.0;
        }
    }
    assert!(error <= 0.08 && error < 0.4 * of_mean, "{error}, mean {of_mean}");
}

#[test]
fn readings_once_a_second_teach_no_more_certainty_than_once_in_ten_minutes() {
    // The office is occupied by day with 80 %, for some 40 minutes at a time; one visit of an hour a day, at another
    // hour each.
    let office = |random: &mut Random, days: i64| -> Vec<f64> {
        let mut is_in = false;
        let minute = |minute: i64| {
            let (day, hour) = (minute / 1440, minute % 1440 / 60);
            let p = if day % 7 < 5 && (9..17).contains(&hour) { 0.8 } else { 0.02 };
            if random.next() < 1.0 / 40.0 || (minute % 60 == 0 && (hour == 9 || hour == 17)) {
                is_in = random.next() < p;
            }
            flag(is_in)
        };
        (0..days * 1440).map(minute).collect()
    };
    let mut losses = [0.0; 2];
    let seeds = 6;
    for seed in 0..seeds {
        let states = office(&mut Random(seed * 77 + 5), 35);
        for (every, loss) in [1, 600].into_iter().zip(&mut losses) {
            let mut random = Random(seed * 13 + 1);
            let state = learned(28, |day| {
                let hour = random.below(24);
                let reading = |secs: i64| {
                    let secs = hour * HOUR_SECS + secs;
                    (secs, states[(day * 1440 + secs / 60) as usize])
                };
                (0..HOUR_SECS).step_by(every).map(reading).collect()
            });
            let moments: Vec<Moment> = (28 * 144..34 * 144).map(|step| at(0, step * 600)).collect();
            for (moment, predicted) in moments.iter().zip(predicted(&state, &moments)) {
                let minute = (moment.utc_nanos / 60_000_000_000 - FIRST_DAY * 1440) as usize;
                let p = predicted.value();
                *loss -=
                    if states[minute] > 0.5 { p.ln() } else { (1.0 - p).ln() } / moments.len() as f64 / seeds as f64;
            }
        }
    }
    assert!(losses[0] <= losses[1] + 0.02 && losses[1] < 0.45, "{losses:?}");
}

#[test]
fn hours_that_nobody_bined_at_stay_unknown() {
    let visits = [(8, 0.0), (12, 1.0), (16, 0.0)];
    let state = learned(42, |_| visits.iter().map(|&(hour, value)| (hour * HOUR_SECS + 600, value)).collect());
    for ahead in [0, 3, 30] {
        let day = 42 + ahead;
        for hour in [4, 20] {
            let unseen = predicted(&state, &[at(day, hour * HOUR_SECS)])[0];
            assert!((unseen.value() - 1.0 / 3.0).abs() < 0.1, "{hour} h, {ahead} days ahead: {unseen:?}");
            assert!(unseen.entropy_bits() >= 0.85, "{unseen:?}");
            assert!(unseen.interval(0.9).interval.width() > 0.8 && unseen.learning_bits() > 0.2, "{unseen:?}");
        }
    }
    assert!(value(&state, 42, 8 * HOUR_SECS) < 0.05 && value(&state, 42, 12 * HOUR_SECS) > 0.95);
    // A robot that works from 8 to 18 has no data about Sunday at three.
    let state = learned(21, |day| {
        let open = |hour: i64| flag(day % 7 < 5 && (9..13).contains(&hour));
        (8..18).map(|hour| (hour * HOUR_SECS, open(hour))).collect()
    });
    let sunday = predicted(&state, &[at(27, 3 * HOUR_SECS)])[0];
    assert!(sunday.entropy_bits() > 0.3 && sunday.learning_bits() > 0.15, "{sunday:?}");
}

#[test]
fn noise_is_predicted_as_well_as_by_its_mean() {
    for gap in [1, 7, 30] {
        for bins in [6, 12, 24] {
            let (mut own, mut of_mean) = (0.0, 0.0);
            for seed in 0..40 {
                let mut random = Random(seed * 101 + bins as u64 * 7 + gap as u64);
                let end = gap * (bins - 1) + 1;
                let mut values = Vec::new();
                let state = learned(end, |day| {
                    if day % gap != 0 {
                        return Vec::new();
                    }
                    values.push(flag(random.next() < 0.3));
                    vec![(random.below(48) * 1800, values[values.len() - 1])]
                });
                let mean = values.iter().sum::<f64>() / values.len() as f64;
                for hour in 0..24 {
                    own += 0.21 + (value(&state, end, hour * HOUR_SECS) - 0.3).powi(2);
                    of_mean += 0.21 + (mean - 0.3_f64).powi(2);
                }
            }
            assert!(own <= 1.015 * of_mean, "{bins} looks, {gap} days apart: {own}, mean {of_mean}");
        }
    }
}

#[test]
fn a_rotation_of_shifts_is_found_without_being_named() {
    let on = |day: i64| [1, 1, 0, 0, 1, 1, 1, 0, 0, 1, 1, 0, 0, 0][day.rem_euclid(14) as usize] == 1;
    let truth = |day: i64, hour: i64| flag(on(day) && (7..19).contains(&hour));
    let day = |day: i64| (0..24).map(|hour| (hour * HOUR_SECS, truth(day, hour))).collect();
    let mut error = 0.0;
    for end in 70..84 {
        let state = learned(end, day);
        error += (0..24).map(|hour| (value(&state, end, hour * HOUR_SECS) - truth(end, hour)).powi(2)).sum::<f64>();
    }
    assert!(error / 14.0 / 24.0 < 0.02, "{}", error / 14.0 / 24.0);
}

#[test]
fn a_few_daily_bins_make_no_swings() {
    for days in [3, 5, 7, 21] {
        for seed in 0..48 {
            let mut random = Random(seed * 7 + 3);
            let state = learned(days, |_| vec![(9 * HOUR_SECS, flag(random.next() < 0.5))]);
            let moments: Vec<Moment> = (0..48).map(|slot| at(days, slot * 1800)).collect();
            let values: Vec<f64> = predicted(&state, &moments).iter().map(|predicted| predicted.value()).collect();
            let (lowest, highest) = values.iter().fold((1.0_f64, 0.0_f64), |(l, h), &v| (l.min(v), h.max(v)));
            assert!(highest - lowest <= 0.5, "{days} days: {lowest} to {highest}");
        }
    }
}

#[test]
fn one_odd_day_leaves_the_other_hours_sure() {
    // The door is open from 8 to 18 h; on the last day it was the other way round.
    let state =
        learned(57, |day| (0..48).map(|slot| (slot * 1800, flag((16..36).contains(&slot) != (day == 56)))).collect());
    let (open, shut) = (value(&state, 57, 12 * HOUR_SECS), value(&state, 57, 2 * HOUR_SECS));
    assert!(open > 0.75 && shut < 0.2, "{open} {shut}");
}

/// A door that is open on weekdays from 9 to 17 h, and holds another value for some hours; read every ten minutes.
fn door_with_exception(days: i64, exception: std::ops::Range<i64>, held: f64) -> StateModel {
    learned(days, |day| {
        let value = |hour: i64| {
            if exception.contains(&(day * 24 + hour)) { held } else { flag(day % 7 < 5 && (9..17).contains(&hour)) }
        };
        (0..144).map(|step| (step * 600, value(step / 6))).collect()
    })
}

#[test]
fn a_long_exception_does_not_turn_the_next_days_around() {
    for weeks in [4, 8, 12, 16] {
        for (from_day, hours, held) in [(4, 80, 1.0), (1, 56, 1.0), (0, 104, 1.0), (4, 80, 0.0), (0, 56, 0.0)] {
            let from = (weeks * 7 + from_day) * 24 + 9;
            let end = (from + hours) / 24 + 1;
            let state = door_with_exception(end, from..from + hours, held);
            for day in (end..end + 6).filter(|day| day % 7 < 5) {
                let [night, noon] = [3, 12].map(|hour| value(&state, day, hour * HOUR_SECS));
                let case = format!("{weeks} weeks, {hours} h at {held}, {} days later: {night} {noon}", day - end);
                assert!(night < noon, "{case}");
                // The door was left open from Friday to Monday.
                assert!((from_day, held) != (4, 1.0) || (night < 0.3 && noon > 0.7), "{case}");
            }
        }
    }
}

#[test]
fn a_record_in_one_update_is_learned_as_night_by_night() {
    // The run has no models that are trained on readings, whose training has its own days.
    let periodicities = Periodicities::default();
    let models = EnabledModels::SPECTRAL.with_histograms(true).with(ModelKind::Ensemble);
    let rules = UpdateRules { models, ..UpdateRules::default() };
    let mut random = Random(9);
    let samples: Vec<Sample> = (0..60 * 48)
        .map(|slot| {
            let open = slot / 48 % 7 < 5 && (18..34).contains(&(slot % 48)) && random.next() < 0.9;
            Sample { utc_nanos: at(0, slot * 1800 + 60).utc_nanos, offset_secs: 0, value: flag(open) }
        })
        .collect();
    let by = |days: i64| {
        let mut state = StateModel::new(&periodicities);
        for part in
            samples.chunk_by(|one, next| i64::from(one.local_day().0) / days == i64::from(next.local_day().0) / days)
        {
            state.update(&periodicities, rules, part.to_vec());
        }
        state
    };
    let (nightly, weekly, at_once) = (by(1), by(7), by(1_000_000));
    assert_eq!(nightly.ensemble(), weekly.ensemble());
    assert_eq!(nightly.ensemble(), at_once.ensemble());
    assert_eq!(nightly.ensemble().unwrap().last_day(), Some(LocalDay(FIRST_DAY as i32 + 59)));
}
