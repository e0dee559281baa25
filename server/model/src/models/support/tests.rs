//! Tests the properties of `support.rs`, over many seeds: noise supports nothing, a routine is found.

use proptest::prelude::*;
use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};

use super::*;
use crate::models::HourTable;
use crate::{Accumulator, Component, ORDER_MAX, OrderCriterion, Persistence, Sample, StateModel};

const MINUTE_NANOS: i64 = 60_000_000_000;
const SEEDS: u64 = 40;

/// A state at some minutes, with a value drawn by minute.
fn observed(minutes: impl Iterator<Item = i64>, mut value: impl FnMut(i64) -> bool) -> Vec<Sample> {
    minutes
        .map(|minute| Sample {
            utc_nanos: minute * MINUTE_NANOS,
            offset_secs: 0,
            value: f64::from(u8::from(value(minute))),
        })
        .collect()
}

/// A chain that stays at 0 and at 1 for these mean times, at rising minutes.
fn chain(random: &mut SmallRng, low_minutes: f64, high_minutes: f64) -> impl FnMut(i64) -> bool {
    let (mut is_high, mut change) = (false, 0.0);
    move |minute| {
        while change <= minute as f64 {
            is_high = !is_high;
            let mean = if is_high { high_minutes } else { low_minutes };
            change -= mean * (1.0 - random.random::<f64>()).ln();
        }
        is_high
    }
}

struct Judged {
    supported: usize,
    effective: f64,
    model: SpectralModel,
}

fn judged(samples: &[Sample]) -> Judged {
    let week = Periodicities::default();
    let mut accumulator = Accumulator::new(&week);
    accumulator.add(&week, samples);
    let (mut persistence, mut hours) = (Persistence::default(), HourTable::default());
    samples.iter().for_each(|sample| persistence.observe(sample.utc_nanos, sample.value));
    let changes = samples.windows(2).map(|pair| (pair[1].value - pair[0].value).abs()).sum();
    hours.add(samples);
    let sums = DependenceSums {
        pairs: persistence.to_parts().pairs,
        change_rate_sum: persistence.to_parts().change_rate_sum,
        span_secs: accumulator.span_nanos() as f64 / 1e9,
        mean: accumulator.mean(),
        observed_hours: hours.observed_hours(),
        changes,
    };
    let effective = effective_observations(&sums);
    let model = SpectralModel::train(&accumulator, &week);
    Judged { supported: supported_order(&model, &week, &sums), effective, model }
}

/// The number of seeds in which nothing is supported.
fn unsupported(name: &str, samples: impl Fn(&mut SmallRng) -> Vec<Sample>) {
    let orders: Vec<usize> =
        (0..SEEDS).map(|seed| judged(&samples(&mut SmallRng::seed_from_u64(seed))).supported).collect();
    let none = orders.iter().filter(|&&order| order == 0).count();
    println!("{name}: nothing supported in {none} of {SEEDS}");
    assert!(none as f64 >= 0.95 * SEEDS as f64, "{name}: {orders:?}");
}

const FOUR_WEEKS_MINUTES: i64 = 28 * 1440;

#[test]
fn independent_noise_supports_nothing() {
    unsupported("independent, every 10 minutes", |random| {
        observed((0..FOUR_WEEKS_MINUTES).step_by(10), |_| random.random::<f64>() < 0.3)
    });
    unsupported("independent, at random times", |random| {
        let mut minutes: Vec<i64> = (0..800).map(|_| random.random_range(0..FOUR_WEEKS_MINUTES)).collect();
        minutes.sort_unstable();
        observed(minutes.into_iter(), |_| random.random::<f64>() < 0.5)
    });
}

#[test]
fn a_slow_chain_supports_nothing() {
    unsupported("2 h dwell, every 10 minutes", |random| {
        observed((0..FOUR_WEEKS_MINUTES).step_by(10), chain(random, 120.0, 120.0))
    });
    unsupported("2 h and 30 min dwell, every 5 minutes", |random| {
        observed((0..FOUR_WEEKS_MINUTES).step_by(5), chain(random, 120.0, 30.0))
    });
    unsupported("12 h dwell, every hour for ten weeks", |random| {
        observed((0..10 * 7 * 1440).step_by(60), chain(random, 720.0, 720.0))
    });
    unsupported("2 h dwell, at random times, one an hour", |random| {
        let mut minutes: Vec<i64> = (0..28 * 24).map(|_| random.random_range(0..FOUR_WEEKS_MINUTES)).collect();
        minutes.sort_unstable();
        minutes.dedup();
        observed(minutes.into_iter(), chain(random, 120.0, 120.0))
    });
    unsupported("2 h dwell, an hour of minutes every seven hours", |random| {
        observed((0..FOUR_WEEKS_MINUTES).filter(|minute| minute % 420 < 60), chain(random, 120.0, 120.0))
    });
}

#[test]
fn a_daily_routine_with_noise_is_supported() {
    for seed in 0..SEEDS {
        let mut random = SmallRng::seed_from_u64(seed);
        let samples = observed((0..14 * 1440).step_by(10), |minute| {
            (540..1020).contains(&(minute % 1440)) != (random.random::<f64>() < 0.2)
        });
        let Judged { supported, effective, model } = judged(&samples);
        assert!(supported >= 1, "seed {seed}: {effective}");
        assert_eq!(model.components()[0].periodicity, 6, "seed {seed}");
    }
}

#[test]
fn the_effective_number_is_known_for_chains() {
    let effective = |dwell: f64, step: usize| {
        let mut random = SmallRng::seed_from_u64(9);
        let minutes = (0..8 * FOUR_WEEKS_MINUTES).step_by(step);
        judged(&observed(minutes, chain(&mut random, dwell, dwell))).effective
    };
    for (dwell, step) in [(120.0, 10_usize), (120.0, 60), (30.0, 60)] {
        let kept: f64 = (-2.0 / dwell * step as f64).exp();
        let expected = (8 * FOUR_WEEKS_MINUTES) as f64 / step as f64 * (1.0 - kept) / (1.0 + kept);
        let found = effective(dwell, step);
        assert!((found / expected - 1.0).abs() < 0.1, "dwell {dwell}, step {step}: {found}, expected {expected}");
    }
    // Readings at random times, an hour apart on average, of a value that forgets in an hour: half is kept from one to
    // the next.
    let mut random = SmallRng::seed_from_u64(9);
    let mut minutes: Vec<i64> =
        (0..8 * FOUR_WEEKS_MINUTES / 60).map(|_| random.random_range(0..8 * FOUR_WEEKS_MINUTES)).collect();
    minutes.sort_unstable();
    minutes.dedup();
    let expected = minutes.len() as f64 / 3.0;
    let found = judged(&observed(minutes.into_iter(), chain(&mut random, 120.0, 120.0))).effective;
    assert!((found / expected - 1.0).abs() < 0.1, "at random times: {found}, expected {expected}");
}

#[test]
fn nothing_is_known_from_nothing() {
    let none =
        DependenceSums { pairs: 0, change_rate_sum: 0.0, span_secs: 0.0, mean: 0.5, observed_hours: 0.0, changes: 0.0 };
    assert!((effective_observations(&none) - 1.0).abs() < 1e-12);
    let constant = DependenceSums { pairs: 1000, span_secs: 1e6, mean: 1.0, ..none };
    assert!((effective_observations(&constant) - 1.0).abs() < 1e-12);
    let week = Periodicities::default();
    let many = DependenceSums { pairs: 1000, change_rate_sum: 1e3, span_secs: 1e3, changes: 1e3, ..none };
    assert_eq!(supported_order(&SpectralModel::default(), &week, &many), 0);
    let strong = Component { periodicity: 6, gamma_re: 0.2, gamma_im: 0.0 };
    let model = SpectralModel::from_parts(0.5, 1000, vec![strong]).unwrap();
    assert_eq!(supported_order(&model, &week, &many), 1);
    for sums in [
        DependenceSums { pairs: 5, ..many },
        DependenceSums { pairs: 0, ..many },
        DependenceSums { change_rate_sum: f64::NAN, ..many },
        DependenceSums { span_secs: f64::NAN, ..many },
        DependenceSums { change_rate_sum: 0.0, ..many },
    ] {
        assert_eq!(supported_order(&model, &week, &sums), 0, "{sums:?}");
    }
}

#[test]
fn a_rhythms_own_slowness_is_no_evidence_against_it() {
    // The door is open for twelve hours a day without exception, so there are only two changes a day.
    let found = |days: i64| judged(&observed((0..days * 1440).step_by(10), |minute| minute % 1440 < 720));
    let Judged { supported, effective, .. } = found(14);
    assert!(supported >= 1, "{effective:.1}");
    // One day is too little.
    assert_eq!(found(1).supported, 0);
}

#[test]
fn gains_are_seen_day_by_day() {
    let week = Periodicities::default();
    let gains = |routine: bool, seed: u64| {
        let mut random = SmallRng::seed_from_u64(seed);
        let samples = observed((0..6 * 7 * 1440).step_by(20), |minute| {
            (routine && (540..1020).contains(&(minute % 1440))) != (random.random::<f64>() < 0.2)
        });
        let (mut state, mut gains) = (StateModel::new(&week), OrderGains::default());
        for day in samples.chunk_by(|a, b| a.local_day() == b.local_day()) {
            let best = state.best_order();
            let outcome = state.update(&week, OrderCriterion::SquaredError, day.to_vec());
            gains.record(best, &outcome.squared_errors, outcome.scored);
        }
        assert_eq!(OrderGains::from_parts(gains.to_parts()), Ok(gains));
        gains.is_significant()
    };
    assert_eq!((0..20).filter(|&seed| gains(false, seed)).count(), 0);
    assert_eq!((0..20).filter(|&seed| gains(true, seed)).count(), 20);
}

#[test]
fn gains_need_days_and_sound_numbers() {
    let mut errors = [0.1; ORDER_MAX + 1];
    errors[0] = 0.2;
    let mut gains = OrderGains::default();
    for _ in 0..6 {
        gains.record(3, &errors, 1);
    }
    gains.record(3, &errors, 0);
    gains.record(0, &errors, 1);
    gains.record(3, &[f64::NAN; ORDER_MAX + 1], 1);
    assert!(!gains.is_significant() && gains.to_parts().days < 6.5);
    gains.record(3, &errors, 1);
    assert!(gains.is_significant());
    let mut faded = gains;
    faded.fade(0.5);
    assert!(!faded.is_significant());
    let parts = gains.to_parts();
    assert!(OrderGains::from_parts(OrderGainsParts { sum: f64::NAN, ..parts }).is_err());
    assert!(OrderGains::from_parts(OrderGainsParts { squares: -1.0, ..parts }).is_err());
    assert!(OrderGains::from_parts(OrderGainsParts { days: -1.0, ..parts }).is_err());
}

#[test]
fn gains_at_a_lead_time_of_a_day_do_not_count_for_months() {
    assert!(OrderGains::apply_to(&Periodicities::default()));
    assert!(!OrderGains::apply_to(&Periodicities::harmonics(365 * 1440 * MINUTE_NANOS, 1000).unwrap()));
}

proptest! {
    #[test]
    fn answers_are_sound_and_grow_with_the_evidence(
        pairs in any::<u64>(),
        change_rate_sum in prop::num::f64::POSITIVE,
        span_secs in prop::num::f64::POSITIVE,
        mean in 0.0..=1.0_f64,
        observed_hours in prop::num::f64::ANY,
        changes in prop::num::f64::ANY,
        gammas in prop::collection::vec(-0.3..0.3_f64, 0..=ORDER_MAX),
    ) {
        let sums = DependenceSums { pairs, change_rate_sum, span_secs, mean, observed_hours, changes };
        let effective = effective_observations(&sums);
        prop_assert!((1.0..=pairs as f64 + 1.0).contains(&effective), "{}", effective);
        let component = |(k, &gamma_re): (usize, &f64)| Component { periodicity: k as u32, gamma_re, gamma_im: 0.0 };
        let model = SpectralModel::from_parts(mean, 1, gammas.iter().enumerate().map(component).collect()).unwrap();
        let week = Periodicities::default();
        let mut least = 0;
        for factor in [1, 10, 100, 10_000] {
            // The data has more readings of this kind, over a longer time.
            let pairs = (pairs % 1_000_000).saturating_mul(factor);
            let rate = (change_rate_sum % 1e9) * factor as f64;
            let span_secs = (span_secs % 1e9) * factor as f64;
            let changes = (changes % 1e9).abs() * factor as f64;
            let more = DependenceSums { pairs, change_rate_sum: rate, span_secs, observed_hours: 0.0, changes, ..sums };
            let supported = supported_order(&model, &week, &more);
            prop_assert!(supported >= least && supported <= gammas.len());
            least = supported;
        }
    }
}
