//! Tests on simulated rhythms and noise: when each rhythm is learned, and how often noise counts as a rhythm.
//!
//! Each state is updated day by day, as in the daemon. Invariant: everything is drawn from seeds.

#![allow(clippy::unwrap_used)]

use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};
use tidemap_model::models::TemporalModel as _;
use tidemap_model::{EnabledModels, Periodicities, Sample, StateKind, StateModel, UpdateRules};

const MINUTE_NANOS: i64 = 60_000_000_000;
const DAY_MINUTES: i64 = 1440;
const DAY_NANOS: i64 = DAY_MINUTES * MINUTE_NANOS;

fn year() -> Periodicities {
    Periodicities::harmonics(365 * DAY_NANOS, 1000).unwrap()
}

fn sample(minute: i64, value: bool) -> Sample {
    Sample { utc_nanos: minute * MINUTE_NANOS, offset_secs: 0, value: f64::from(u8::from(value)) }
}

/// A state that has learned these readings, in order of time, day by day.
fn learned(periodicities: &Periodicities, models: EnabledModels, samples: &[Sample]) -> StateModel {
    learned_by(StateModel::new(periodicities), periodicities, models, samples)
}

fn learned_by(
    mut state: StateModel,
    periodicities: &Periodicities,
    models: EnabledModels,
    samples: &[Sample],
) -> StateModel {
    for day in samples.chunk_by(|one, next| one.local_day() == next.local_day()) {
        let rules = UpdateRules { models, ..UpdateRules::default() };
        state.update(periodicities, rules, day.to_vec());
    }
    state
}

/// The share of readings that lie on the other side of 0.5 than the prediction of the model in force.
fn wrong(periodicities: &Periodicities, state: &StateModel, samples: &[Sample]) -> f64 {
    let chosen = state.chosen(periodicities);
    let predict = |sample: &Sample| match &chosen {
        Some(model) if model.covers(sample.moment()) => model.predict(sample.moment()),
        _ => state.spectral().predict(periodicities, state.order(), sample.civil_nanos()),
    };
    let count = samples.iter().filter(|sample| (predict(sample) >= 0.5) != (sample.value >= 0.5)).count();
    count as f64 / samples.len() as f64
}

#[test]
fn weekdays_open_and_weekends_shut_are_known_by_the_fourth_week() {
    let week = Periodicities::default();
    let mut weeks = Vec::new();
    for start in 0..14 {
        // The readings begin on each day of the week, at midnight and at noon.
        let minutes = (0..).map(|step| start * DAY_MINUTES / 2 + step * 30);
        let samples: Vec<Sample> =
            minutes.take(6 * 336).map(|minute| sample(minute, minute / DAY_MINUTES % 7 < 5)).collect();
        let known = (7..=42).find(|&days| learned(&week, EnabledModels::SPECTRAL, &samples[..days * 48]).order() >= 1);
        weeks.push(known.map_or(f64::INFINITY, |days| days as f64 / 7.0));
        let state = learned(&week, EnabledModels::SPECTRAL, &samples[..28 * 48]);
        assert!(state.order() >= 1, "start {start}: order {} of {}", state.order(), state.best_order());
    }
    println!("weeks until the order is 1 or more, by the start: {weeks:.1?}");
}

#[test]
fn a_yearly_state_is_known_after_two_years() {
    let year = year();
    for start in [0, 60, 120, 180, 240, 300] {
        // There are eight readings a day: 6,400 in all.
        let minutes = every(180, 800);
        let value = |minute: i64| (minute / DAY_MINUTES + start) % 365 < 182;
        let samples: Vec<Sample> = minutes.into_iter().map(|minute| sample(minute, value(minute))).collect();
        let state = learned(&year, EnabledModels::default(), &samples);
        let next: Vec<Sample> =
            (800..1165).map(|day| sample(day * DAY_MINUTES + 700, value(day * DAY_MINUTES))).collect();
        let (own, after) = (wrong(&year, &state, &samples), wrong(&year, &state, &next));
        println!(
            "from day {start}: order {}, {:.1} % wrong, {:.1} % in the next year, {:?}",
            state.order(),
            100.0 * own,
            100.0 * after,
            state.choice()
        );
        assert!(state.order() >= 1 && own <= 0.03, "from day {start}: {own}");
    }
}

#[test]
fn twelve_monthly_bins_find_a_year() {
    let days = [365, 182, 91, 30, 7, 1];
    let list = Periodicities::list(days.map(|days| days * DAY_NANOS).to_vec()).unwrap();
    let months = [0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334];
    let bins: Vec<Sample> = months
        .iter()
        .enumerate()
        .map(|(month, &day)| sample(day * DAY_MINUTES + 600, (3..9).contains(&month)))
        .collect();
    let state = learned(&list, EnabledModels::SPECTRAL, &bins);
    assert_eq!(state.spectral().components()[0].periodicity, 0, "{:?}", state.spectral());
    // No component is faster than monthly readings can resolve.
    assert!(state.spectral().components().iter().all(|component| component.periodicity <= 2), "{:?}", state.spectral());
    // Eleven readings are too few.
    let state = learned(&list, EnabledModels::SPECTRAL, &bins[..11]);
    assert!(state.spectral().components().iter().all(|component| component.periodicity != 0));
}

#[test]
fn readings_every_twelve_hours_find_the_week() {
    let week = Periodicities::default();
    let at = |step: i64| sample(step * 720 + 300, (step * 720 + 300) / DAY_MINUTES % 7 < 4);
    let samples: Vec<Sample> = (0..8 * 14).map(at).collect();
    let state = learned(&week, EnabledModels::SPECTRAL, &samples);
    let components = state.spectral().components();
    assert_eq!(components[0].periodicity, 0, "{components:?}");
    assert!(components.iter().all(|component| component.periodicity < 7), "{components:?}");
    assert!(state.order() >= 1);
    // Two weeks later, at hours that were never observed, at least three of four days are on the right side.
    let later: Vec<Sample> = (0..7 * 24)
        .map(|hour| {
            let minute = 10 * 7 * DAY_MINUTES + hour * 60;
            sample(minute, minute / DAY_MINUTES % 7 < 4)
        })
        .collect();
    assert!(wrong(&week, &state, &later) < 0.15, "{}", wrong(&week, &state, &later));
}

#[test]
fn a_square_wave_of_values_has_its_rhythm() {
    let week = Periodicities::default();
    let value = |minute: i64| if minute % DAY_MINUTES < 720 { 1.0 } else { -1.0 };
    let samples: Vec<Sample> =
        every(30, 28).into_iter().map(|minute| Sample { value: value(minute), ..sample(minute, true) }).collect();
    let state = learned_by(StateModel::of_kind(StateKind::Continuous), &week, EnabledModels::SPECTRAL, &samples);
    assert!(state.order() >= 1, "order {} of {}", state.order(), state.best_order());
    assert_eq!(state.spectral().components()[0].periodicity, 6, "{:?}", state.spectral());
}

/// A two-state chain that stays at 0 and at 1 for these mean times in minutes, at rising minutes.
fn chain(random: &mut SmallRng, means: [f64; 2], minutes: Vec<i64>) -> Vec<Sample> {
    let stay = |random: &mut SmallRng, mean: f64| -mean * (1.0 - random.random::<f64>()).ln();
    let mut is_high = random.random::<f64>() < means[1] / (means[0] + means[1]);
    let mut change = stay(random, means[usize::from(is_high)]);
    let value = |minute: i64| {
        while change <= minute as f64 {
            is_high = !is_high;
            change += stay(random, means[usize::from(is_high)]);
        }
        sample(minute, is_high)
    };
    minutes.into_iter().map(value).collect()
}

fn every(step: usize, days: i64) -> Vec<i64> {
    (0..days * DAY_MINUTES).step_by(step).collect()
}

fn random_times(random: &mut SmallRng, count: usize, days: i64) -> Vec<i64> {
    let mut minutes: Vec<i64> = (0..count).map(|_| random.random_range(0..days * DAY_MINUTES)).collect();
    minutes.sort_unstable();
    minutes.dedup();
    minutes
}

fn white(random: &mut SmallRng, mean: f64, minutes: Vec<i64>) -> Vec<Sample> {
    minutes.into_iter().map(|minute| sample(minute, random.random::<f64>() < mean)).collect()
}

/// Visits at random times, each with some readings of the same value.
fn visits(random: &mut SmallRng, days: i64) -> Vec<Sample> {
    let (mut samples, mut at) = (Vec::new(), 0);
    while at < days * DAY_MINUTES {
        at += random.random_range(60..1500);
        let value = random.random::<f64>() < 0.4;
        samples.extend((0..random.random_range(3..30)).map(|step| sample(at + 2 * step, value)));
        at += 61;
    }
    samples
}

type Noise = (&'static str, fn(&mut SmallRng) -> Vec<Sample>);

const NOISES: [Noise; 15] = [
    ("white 0.02, half-hours, 8 weeks", |random| white(random, 0.02, every(30, 56))),
    ("white 0.1, half-hours, 8 weeks", |random| white(random, 0.1, every(30, 56))),
    ("white 0.5, half-hours, 4 weeks", |random| white(random, 0.5, every(30, 28))),
    ("white 0.9, hours, 8 weeks", |random| white(random, 0.9, every(60, 56))),
    ("chain 2 h, half-hours, 4 weeks", |random| chain(random, [120.0; 2], every(30, 28))),
    ("chain 12 h, half-hours, 8 weeks", |random| chain(random, [720.0; 2], every(30, 56))),
    ("chain 2 d, half-hours, 4 weeks", |random| chain(random, [2880.0; 2], every(30, 28))),
    ("chain 2 d, half-hours, 8 weeks", |random| chain(random, [2880.0; 2], every(30, 56))),
    ("chain 5 d and 2 d, half-hours, 8 weeks", |random| chain(random, [7200.0, 2880.0], every(30, 56))),
    ("chain 10 d, half-hours, 8 weeks", |random| chain(random, [14_400.0; 2], every(30, 56))),
    ("white 0.3, 800 random times, 4 weeks", |random| {
        let minutes = random_times(random, 800, 28);
        white(random, 0.3, minutes)
    }),
    ("chain 2 h, 1000 random times, 6 weeks", |random| {
        let minutes = random_times(random, 1000, 42);
        chain(random, [120.0; 2], minutes)
    }),
    ("chain 6 h, 800 random times, 4 weeks", |random| {
        let minutes = random_times(random, 800, 28);
        chain(random, [360.0; 2], minutes)
    }),
    ("chain 2 d, an hour of readings every seven, 8 weeks", |random| {
        chain(random, [2880.0; 2], every(5, 56).into_iter().filter(|minute| minute % 420 < 60).collect())
    }),
    ("visits, 8 weeks", |random| visits(random, 56)),
];

/// For each kind of noise, the number of states for which a rhythm is used.
fn false_rhythms(states: u64) -> Vec<(&'static str, u64)> {
    let week = Periodicities::default();
    let count = |(name, noise): Noise| {
        let is_false = |&seed: &u64| {
            let samples = noise(&mut SmallRng::seed_from_u64(seed));
            learned(&week, EnabledModels::SPECTRAL, &samples).order() >= 1
        };
        let threads = 2;
        let part = |thread: u64| (thread..states).step_by(threads as usize).filter(is_false).count() as u64;
        let found = std::thread::scope(|scope| {
            let parts: Vec<_> = (0..threads).map(|thread| scope.spawn(move || part(thread))).collect();
            parts.into_iter().map(|part| part.join().unwrap()).sum()
        });
        println!("{name}: a rhythm in {found} of {states}");
        (name, found)
    };
    NOISES.into_iter().map(count).collect()
}

#[test]
fn noise_of_any_kind_has_hardly_ever_a_rhythm() {
    let found = false_rhythms(60);
    let all: u64 = found.iter().map(|(_, found)| found).sum();
    assert!(all <= 60 * NOISES.len() as u64 / 100, "{found:?}");
}

#[test]
#[ignore = "takes minutes"]
fn noise_of_any_kind_has_a_rhythm_in_at_most_one_of_a_hundred_states() {
    for (name, found) in false_rhythms(10_000) {
        assert!(found <= 100, "{name}: {found}");
    }
}
