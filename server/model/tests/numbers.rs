//! Tests the predictions of continuous values and counts: simulated temperatures and numbers of people, day by day.
//!
//! Each state is read every half-hour and learned every night, as in the daemon; the hidden values of the next day are
//! then compared with the predictions. Invariant: everything is drawn from seeds, so that every run has the same days.

#![allow(clippy::unwrap_used)]

use std::f64::consts::TAU;

use proptest::prelude::*;
use tidemap_model::catalogue::{ModelKind, TRAINED_AT_NIGHT};
use tidemap_model::models::{Moment, Readings};
use tidemap_model::{EnabledModels, LocalDay, Periodicities, Sample, StateKind, StateModel, UpdateRules};

/// The first of September 2025, a Monday.
const FIRST_DAY: i64 = 20_332;
const STEP_NANOS: i64 = 600_000_000_000;
const STEPS: usize = 144;
const TRAINING_DAYS: usize = 84;

/// Reproducible draws (Marsaglia's xorshift).
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (TAU * self.uniform()).cos()
    }

    /// A Gamma variable of a whole shape and mean 1.
    fn gamma(&mut self, shape: u32) -> f64 {
        (0..shape).map(|_| -(1.0 - self.uniform()).ln()).sum::<f64>() / f64::from(shape)
    }

    fn poisson(&mut self, mean: f64) -> f64 {
        let (mut events, mut time) = (0, -(1.0 - self.uniform()).ln());
        while time < mean {
            events += 1;
            time -= (1.0 - self.uniform()).ln();
        }
        f64::from(events)
    }
}

/// Hidden values in steps of ten minutes.
struct World {
    kind: StateKind,
    values: Vec<f64>,
    /// The first step that is read; then every third.
    first: usize,
}

/// The temperature by season and hour, with weather that changes within two days.
fn temperature(days: usize, seed: u64) -> World {
    let mut random = Random(seed * 7919 + 17);
    let mut weather = 0.0;
    let values = (0..days * STEPS).map(|step| {
        weather = 0.995 * weather + 0.15 * random.normal();
        let (day, hour) = (step / STEPS, (step % STEPS) as f64 / 6.0);
        let season = 7.0 * (TAU * (day as f64 + 244.0 - 20.0) / 365.0).cos();
        11.0 - season - 3.0 * (TAU * (hour - 3.0) / 24.0).cos() + weather
    });
    World { kind: StateKind::Continuous, values: values.collect(), first: (seed % 3) as usize }
}

/// People who pass, in the morning, at noon and in the evening of workdays; some days are busier than others.
fn people(days: usize, seed: u64) -> World {
    let mut random = Random(seed * 104_729 + 29);
    let mut busy = 1.0;
    let values = (0..days * STEPS).map(|step| {
        let (day, hour) = (step / STEPS, (step % STEPS) as f64 / 6.0);
        if step % STEPS == 0 {
            busy = random.gamma(8);
        }
        let around = |middle: f64, width: f64| (-0.5 * ((hour - middle) / width).powi(2)).exp();
        let workday = 6.0 * around(9.0, 1.2) + 8.0 * around(12.5, 0.8) + 5.0 * around(17.0, 1.0);
        let usual = 0.3 + if day % 7 < 5 { workday } else { 1.5 * around(14.0, 3.0) };
        let moment = random.gamma(3);
        random.poisson(usual * busy * moment)
    });
    World { kind: StateKind::Count, values: values.collect(), first: (seed % 3) as usize }
}

fn nanos(step: usize) -> i64 {
    FIRST_DAY * 86_400_000_000_000 + step as i64 * STEP_NANOS
}

impl World {
    fn bins(&self, day: usize) -> Vec<Sample> {
        let sample =
            |step: usize| Sample { utc_nanos: nanos(step) + 37_000_000_000, offset_secs: 0, value: self.values[step] };
        (day * STEPS..(day + 1) * STEPS).filter(|step| step % 3 == self.first).map(sample).collect()
    }
}

/// Mean squared errors.
#[derive(Debug, Default)]
struct Errors {
    auto: f64,
    /// Errors of tables by hour of the week, by hour of weekdays or the weekend, and by hour of the week with a
    /// half-life of 21 days; of the value of the same hour a week before, and a day before.
    baselines: [f64; 5],
    /// Shares of hours whose mean lay within one and two standard deviations.
    held: [f64; 2],
}

/// Learns night by night, and compares some days with the predictions made `ahead` days before them.
fn run(world: &World, models: EnabledModels, days: std::ops::Range<usize>, ahead: usize) -> Errors {
    let periodicities = Periodicities::default();
    let rules = UpdateRules { models, ..UpdateRules::default() };
    let mut state = StateModel::of_kind(world.kind);
    let mut seen: Vec<Sample> = Vec::new();
    let mut errors = Errors::default();
    let mut tables = [[[0.0; 2]; 168]; 3];
    let (mut predictions, mut hours) = (0.0, 0.0);
    for day in 0..days.end {
        let requested = day + ahead - 1;
        if days.contains(&requested) && day > 0 {
            let steps = requested * STEPS..(requested + 1) * STEPS;
            let samples: Vec<Sample> = steps
                .clone()
                .map(|step| Sample { utc_nanos: nanos(step), offset_secs: 0, value: world.values[step] })
                .collect();
            let predicted = state.predict_in_force(&periodicities, &samples);
            for (step, predicted) in steps.clone().zip(&predicted) {
                let value = world.values[step];
                let hour = step / 6 % 168;
                let kind = hour % 24 + if hour < 120 { 0 } else { 24 };
                let table = |table: usize, cell: usize| tables[table][cell][0] / f64::max(tables[table][cell][1], 1e-9);
                let before = |steps: usize| {
                    let bin = step.checked_sub(steps).unwrap_or(step % STEPS);
                    world.values[bin - bin % 3 + world.first]
                };
                let baselines = [
                    table(0, hour),
                    table(1, kind),
                    table(2, hour),
                    before(7 * STEPS * ahead.div_ceil(7)),
                    before(STEPS * ahead),
                ];
                errors.auto += (predicted - value).powi(2);
                errors
                    .baselines
                    .iter_mut()
                    .zip(baselines)
                    .for_each(|(sum, predicted)| *sum += (predicted - value).powi(2));
                predictions += 1.0;
            }
            for first in steps.step_by(6) {
                let mean = |values: &[f64]| values.iter().sum::<f64>() / 6.0;
                let error = mean(&world.values[first..first + 6]) - mean(&predicted[first % STEPS..first % STEPS + 6]);
                let middle = Moment { utc_nanos: nanos(first + 3), offset_secs: 0 };
                let known = state.ensemble().and_then(|ensemble| ensemble.of_number());
                let deviation = known.map_or(0.0, |known| known.variance(middle).sqrt());
                for (held, reach) in errors.held.iter_mut().zip([1.0, 2.0]) {
                    *held += f64::from(u8::from(error.abs() <= reach * deviation));
                }
                hours += 1.0;
            }
        }
        let bins = world.bins(day);
        tables[2].iter_mut().flatten().for_each(|sum| *sum *= 0.5_f64.powf(1.0 / 21.0));
        for bin in &bins {
            let hour = (bin.utc_nanos - nanos(0)) / 3_600_000_000_000 % 168;
            let kind = hour % 24 + if hour < 120 { 0 } else { 24 };
            for (table, cell) in [(0, hour), (1, kind), (2, hour)] {
                let cell = &mut tables[table][cell as usize];
                (cell[0], cell[1]) = (cell[0] + bin.value, cell[1] + 1.0);
            }
        }
        state.update(&periodicities, rules, bins.clone());
        seen.extend(bins);
        let window = seen.len().saturating_sub(TRAINING_DAYS * STEPS / 3);
        for kind in TRAINED_AT_NIGHT {
            if models.has(kind) && state.is_training_due(kind) {
                let model = kind.train(Readings::new(&seen[window..]), world.kind, &periodicities).unwrap();
                state = state.with_trained(model, LocalDay((FIRST_DAY + day as i64) as i32));
            }
        }
    }
    errors.auto /= predictions;
    errors.baselines.iter_mut().for_each(|sum| *sum /= predictions);
    errors.held.iter_mut().for_each(|sum| *sum /= hours);
    errors
}

/// A machine that runs in shifts of two or three days, 14 days in all; the value is the power that it draws by day.
fn shifts(days: usize, seed: u64) -> World {
    const IS_ON: [bool; 14] =
        [true, true, false, false, true, true, true, false, false, true, true, false, false, false];
    let mut random = Random(seed * 31 + 5);
    let values = (0..days * STEPS).map(|step| {
        let on = IS_ON[step / STEPS % 14] && (42..114).contains(&(step % STEPS));
        (if on { 100.0 } else { 5.0 }) + 3.0 * random.normal()
    });
    World { kind: StateKind::Continuous, values: values.collect(), first: 0 }
}

/// Mean errors over two seeds, with the usual models, and without the ensemble.
fn both(world: fn(usize, u64) -> World, days: std::ops::Range<usize>, ahead: usize) -> [Errors; 2] {
    let usual = EnabledModels::default();
    [usual, usual.without_ensemble()].map(|models| {
        let mut mean = Errors::default();
        for seed in 0..2 {
            let errors = run(&world(days.end, seed), models, days.clone(), ahead);
            mean.auto += 0.5 * errors.auto;
            mean.baselines.iter_mut().zip(errors.baselines).for_each(|(sum, more)| *sum += 0.5 * more);
            mean.held.iter_mut().zip(errors.held).for_each(|(sum, more)| *sum += 0.5 * more);
        }
        mean
    })
}

impl Errors {
    fn best_baseline(&self) -> f64 {
        self.baselines.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

#[test]
fn a_temperature_is_predicted_better_than_by_yesterday() {
    let [auto, single] = both(temperature, 91..153, 1);
    assert!(auto.auto <= 1.6 && auto.auto < 0.7 * auto.best_baseline() && auto.auto < single.auto, "{auto:?}");
    // The shares are about those of a normal distribution.
    let [one, two] = auto.held;
    assert!((0.6..0.85).contains(&one) && two > 0.93, "{auto:?}");
}

#[test]
fn people_are_predicted_as_well_as_by_the_best_table() {
    let [auto, single] = both(people, 42..105, 1);
    assert!(auto.auto < 1.01 * auto.best_baseline() && auto.auto < 1.01 * single.auto, "{auto:?} {single:?}");
    assert!(auto.held[1] > 0.95, "{auto:?}");
}

#[test]
fn two_weeks_are_enough_to_be_as_good_as_the_best_table() {
    for world in [temperature, people] {
        let [auto, single] = both(world, 2..14, 1);
        assert!(auto.auto < 1.06 * auto.best_baseline() && auto.auto < 1.05 * single.auto, "{auto:?} {single:?}");
    }
}

#[test]
fn far_ahead_it_claims_less() {
    let mut last = 0.0;
    for ahead in [1, 2, 7, 28] {
        let [auto, single] = both(temperature, 91..153, ahead);
        assert!(auto.auto < single.auto && auto.auto > last, "{ahead} days ahead: {auto:?} {single:?}");
        assert!(auto.held[0] > 0.6 && auto.held[1] > 0.9, "{ahead} days ahead: {auto:?}");
        last = auto.auto;
    }
    // The lead time is a quarter of a year, across a season that was not observed.
    let [auto, single] = both(temperature, 200..240, 91);
    assert!(auto.auto < single.auto && auto.held[1] > 0.9, "{auto:?} {single:?}");
}

#[test]
fn shifts_are_known_up_to_a_week_ahead() {
    for ahead in [1, 2, 7] {
        let [auto, _] = both(shifts, 70..112, ahead);
        // The noise is 9; the best table has more than 1,000.
        assert!(auto.auto < 50.0, "{ahead} days ahead: {auto:?}");
    }
}

/// Half-hour bins that are pure noise, one a day.
fn noise(bins: usize, at_any_hour: bool, seed: u64) -> Vec<Sample> {
    let mut random = Random(seed * 7919 + bins as u64 * 31);
    let bin = |day: usize| {
        let step = if at_any_hour { (random.uniform() * STEPS as f64) as usize } else { 60 };
        Sample { utc_nanos: nanos(day * STEPS + step), offset_secs: 0, value: random.normal() }
    };
    (0..bins).map(bin).collect()
}

#[test]
fn noise_is_hardly_worse_than_its_mean() {
    let periodicities = Periodicities::default();
    for (bins, at_any_hour) in [(6, false), (6, true), (12, false), (12, true), (24, true), (60, false), (60, true)] {
        let (mut own, mut of_mean) = (0.0, 0.0);
        for seed in 1..41 {
            let seen = noise(bins, at_any_hour, seed);
            let mut state = StateModel::of_kind(StateKind::Continuous);
            for bin in &seen {
                state.update(&periodicities, UpdateRules::default(), vec![*bin]);
            }
            let requested: Vec<Sample> = (0..STEPS)
                .map(|step| Sample { utc_nanos: nanos(bins * STEPS + step), offset_secs: 0, value: 0.0 })
                .collect();
            let predicted = state.predict_in_force(&periodicities, &requested);
            own += predicted.iter().map(|predicted| 1.0 + predicted * predicted).sum::<f64>() / STEPS as f64;
            of_mean += 1.0 + (seen.iter().map(|bin| bin.value).sum::<f64>() / bins as f64).powi(2);
        }
        assert!(own <= 1.06 * of_mean, "{bins} bins, at any hour: {at_any_hour}: {own}, mean {of_mean}");
    }
}

/// Learns the half-hour bins of a temperature on some of its days, in another unit.
fn learned(world: &World, days: std::ops::Range<usize>, batch: usize, unit: impl Fn(f64) -> f64) -> StateModel {
    let models = EnabledModels::SPECTRAL.with_histograms(true).with(ModelKind::Ensemble);
    let rules = UpdateRules { models, ..UpdateRules::default() };
    let mut state = StateModel::of_kind(StateKind::Continuous);
    // On every eleventh day there is no reading.
    let days: Vec<usize> = days.filter(|day| day % 11 != 3).collect();
    for batch in days.chunks(batch) {
        let bins = batch.iter().flat_map(|&day| world.bins(day));
        let bins = bins.map(|bin| Sample { value: unit(bin.value), ..bin });
        state.update(&Periodicities::default(), rules, bins.collect());
    }
    state
}

#[test]
fn a_record_in_one_update_is_learned_as_night_by_night() {
    let world = temperature(70, 3);
    let by = |batch| learned(&world, 0..70, batch, |value| value);
    let nightly = by(1);
    assert!(nightly.ensemble().and_then(|known| known.of_number()).is_some());
    assert!(nightly.ensemble() == by(9).ensemble() && nightly.ensemble() == by(70).ensemble());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Compares days with and without readings, the next days and days with a long lead time: the results do not depend
    /// on the unit.
    #[test]
    fn the_unit_does_not_matter(seed in 0_u64..50, days in 1_usize..60, power in -6_i32..7, shift in -50.0..50.0_f64) {
        let world = temperature(60, seed);
        let scale = 10.0_f64.powi(power);
        let plain = learned(&world, 0..days, 1, |value| value);
        let other = learned(&world, 0..days, 1, |value| scale * (value + shift));
        let moments: Vec<Moment> = [0, 1, 2, 8, 30, 100, 400]
            .iter()
            .flat_map(|ahead| (0..4).map(move |part| nanos((days + ahead) * STEPS + part * 36)))
            .map(|utc_nanos| Moment { utc_nanos, offset_secs: 0 })
            .collect();
        let samples: Vec<Sample> =
            moments.iter().map(|at| Sample { utc_nanos: at.utc_nanos, offset_secs: 0, value: 0.0 }).collect();
        let predicted = |state: &StateModel| state.predict_in_force(&Periodicities::default(), &samples);
        let width = |state: &StateModel, at: Moment| {
            state.ensemble().unwrap().of_number().unwrap().variance(at).sqrt()
        };
        for ((one, two), &at) in predicted(&plain).into_iter().zip(predicted(&other)).zip(&moments) {
            prop_assert!((scale * (one + shift) - two).abs() < 1e-5 * scale, "{one} {two}");
            let (one, two) = (width(&plain, at), width(&other, at));
            prop_assert!(one.is_finite() && (scale * one - two).abs() <= 1e-5 * scale * one.max(1.0), "{one} {two}");
        }
    }

    /// For any observations, predictions and widths are finite.
    #[test]
    fn any_values_are_taken(
        values in prop::collection::vec((0_i64..200, -1e12..1e12_f64), 1..60),
        power in prop::sample::select(vec![0, -200, -320]),
    ) {
        let samples: Vec<Sample> = values
            .iter()
            .map(|&(hour, value)| Sample {
                utc_nanos: hour * 3_600_000_000_000,
                offset_secs: 0,
                value: value * 10.0_f64.powi(power),
            })
            .collect();
        let mut state = StateModel::of_kind(StateKind::Continuous);
        let (early, late) = samples.split_at(samples.len() / 2);
        for part in [early, late] {
            state.update(&Periodicities::default(), UpdateRules::default(), part.to_vec());
        }
        let ensemble = state.ensemble().unwrap().of_number().unwrap();
        for predicted in state.predict_in_force(&Periodicities::default(), &samples) {
            prop_assert!(predicted.is_finite());
        }
        prop_assert!(samples.iter().all(|sample| ensemble.variance(sample.moment()).is_finite()));
    }
}
