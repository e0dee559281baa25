//! Tests the properties of `markov_chain.rs`, against a brute-force maximum and chains whose rates are known.

use proptest::prelude::*;
use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};

use super::*;
use crate::{Sample, StopSignal};

const HOUR: f64 = 3600.0;
const TEN_YEARS_SECS: i64 = 315_576_000;

fn sample(secs: f64, value: f64) -> Sample {
    Sample { utc_nanos: (secs * 1e9) as i64, offset_secs: 0, value }
}

fn at(secs: i64) -> Moment {
    Moment { utc_nanos: secs.saturating_mul(1_000_000_000), offset_secs: 0 }
}

fn trained(samples: &[Sample]) -> MarkovChain {
    MarkovChain::train(Readings::new(samples)).unwrap()
}

/// A state with these mean times at 0 and at 1, read at gaps drawn evenly from a range.
fn simulated(low_secs: f64, high_secs: f64, gap_secs: std::ops::Range<f64>, count: usize, seed: u64) -> Vec<Sample> {
    let mut random = SmallRng::seed_from_u64(seed);
    let (mut secs, mut value, mut change) = (0.0, 0.0, 0.0);
    let mut samples = Vec::new();
    while samples.len() < count {
        secs += random.random_range(gap_secs.clone());
        while change <= secs {
            value = 1.0 - value;
            let mean = if value > 0.5 { high_secs } else { low_secs };
            change -= mean * (1.0 - random.random::<f64>()).ln();
        }
        samples.push(sample(secs, value));
    }
    samples
}

#[test]
fn no_rates_of_a_grid_over_all_are_likelier_than_those_found() {
    for (seed, low, high, gaps) in [
        (1, 4.0 * HOUR, HOUR, 60.0..120.0),
        (2, HOUR, 20.0 * HOUR, 600.0..7200.0),
        (3, 300.0, 300.0, 1800.0..14_400.0),
        (4, 1e6, 1e3, 10.0..86_400.0),
    ] {
        for count in [2, 10, 300, 5000] {
            let mut transitions = Transitions::default();
            for pair in simulated(low, high, gaps.clone(), count, seed).windows(2) {
                let gap = pair[1].utc_nanos.abs_diff(pair[0].utc_nanos);
                transitions.add(gap, pair[0].value, pair[1].value, 1.0);
            }
            let (rate, share) = transitions.most_likely(StopSignal::NEVER);
            let found = transitions.slope([rate.ln(), (share / (1.0 - share)).ln()]).value;
            let grid = (-50..46).flat_map(|rate| (-40..=40).map(move |share| [f64::from(rate), f64::from(share)]));
            let best = grid.map(|at| transitions.slope(at.map(|at| 0.5 * at)).value).fold(f64::MIN, f64::max);
            assert!(found >= best, "{seed} {count}: {rate} {share}");
        }
    }
}

/// Log posterior of rates by the transition probabilities of RAS 2017 eq. 6, pair by pair.
fn log_posterior(samples: &[Sample], rise: f64, fall: f64) -> f64 {
    let share = rise / (rise + fall);
    let mut sum = 0.5 * rise.ln() - HOUR * rise + 0.5 * fall.ln() - HOUR * fall;
    for pair in samples.windows(2) {
        let gap_secs = (pair[1].utc_nanos - pair[0].utc_nanos) as f64 / 1e9;
        let one = share + (pair[0].value - share) * (-(rise + fall) * gap_secs).exp();
        sum += if pair[1].value > 0.5 { one.ln() } else { (1.0 - one).ln() };
    }
    sum
}

#[test]
fn known_rates_are_found_from_irregular_readings() {
    // The gaps range from far shorter than the dwell to longer than it: many changes are never observed.
    for gaps in [60.0..120.0, 60.0..7200.0, 1800.0..14_400.0] {
        let parts = trained(&simulated(4.0 * HOUR, HOUR, gaps.clone(), 20_000, 7)).to_parts();
        let (low_secs, high_secs) = (1.0 / parts.rise_per_sec, 1.0 / parts.fall_per_sec);
        assert!((low_secs / (4.0 * HOUR) - 1.0).abs() < 0.15, "{gaps:?}: {low_secs}");
        assert!((high_secs / HOUR - 1.0).abs() < 0.15, "{gaps:?}: {high_secs}");
    }
}

#[test]
fn it_predicts_forwards_from_the_newest_reading() {
    let samples = simulated(4.0 * HOUR, HOUR, 60.0..7200.0, 5000, 3);
    let mut chain = trained(&samples);
    let newest_secs = (samples[4999].utc_nanos / 1_000_000_000) + 10;
    chain.observe(newest_secs * 1_000_000_000, 1.0);
    assert!((chain.predict(at(newest_secs)) - 1.0).abs() < 1e-12);
    let parts = chain.to_parts();
    let rate = parts.rise_per_sec + parts.fall_per_sec;
    let expected = chain.stationary() + (1.0 - chain.stationary()) * (-rate * 1800.0).exp();
    assert!((chain.predict(at(newest_secs + 1800)) - expected).abs() < 1e-12);
    for far in [newest_secs - 1, newest_secs + TEN_YEARS_SECS, i64::MIN, i64::MAX] {
        assert!((chain.predict(at(far)) - chain.stationary()).abs() < 1e-12);
    }
    chain.observe(0, 0.0);
    chain.observe(i64::MAX, f64::NAN);
    assert_eq!(chain.to_parts(), parts);
}

#[test]
fn a_state_that_never_changed_is_nearly_sure_not_to() {
    let days: Vec<f64> = (0..7 * 1440).map(|minute| f64::from(minute) * 60.0).collect();
    for value in [0.0, 1.0] {
        let samples: Vec<Sample> = days.iter().map(|&secs| sample(secs, value)).collect();
        let chain = trained(&samples);
        assert!((chain.stationary() - value).abs() < 0.02, "{}", chain.stationary());
        assert!(chain.stationary() > 0.0 && chain.stationary() < 1.0);
        // After a week without change, the next hour will most likely bring none.
        assert!((chain.predict(at(7 * 86_400 + 3600)) - value).abs() < 0.01);
    }
}

#[test]
fn one_reading_and_equal_times_leave_the_prior() {
    for samples in [vec![sample(5.0, 1.0)], vec![sample(5.0, 0.0), sample(5.0, 1.0)]] {
        let chain = trained(&samples);
        assert!((chain.stationary() - 0.5).abs() < 1e-6);
        assert!((chain.memory_secs() - HOUR).abs() < 1.0, "{}", chain.memory_secs());
    }
}

#[test]
fn ten_years_of_silence_change_no_rate() {
    let mut samples = simulated(4.0 * HOUR, HOUR, 60.0..7200.0, 5000, 5);
    let before = trained(&samples).to_parts();
    let secs = samples[4999].utc_nanos as f64 / 1e9 + TEN_YEARS_SECS as f64;
    samples.push(sample(secs, 0.0));
    let after = trained(&samples).to_parts();
    assert!((after.rise_per_sec / before.rise_per_sec - 1.0).abs() < 0.01);
    assert!((after.fall_per_sec / before.fall_per_sec - 1.0).abs() < 0.01);
}

#[test]
fn an_unsure_but_steady_state_does_not_seem_to_change() {
    let steady: Vec<Sample> = (0..1440).map(|minute| sample(f64::from(minute) * 60.0, 0.5)).collect();
    assert!(trained(&steady).memory_secs() > 6.0 * HOUR);
    let restless: Vec<Sample> =
        (0..1440).map(|minute| sample(f64::from(minute) * 60.0, f64::from(minute % 2))).collect();
    assert!(trained(&restless).memory_secs() < 60.0);
}

#[test]
fn nonsense_is_refused() {
    assert_eq!(MarkovChain::train(Readings::new(&[])), Err(CannotTrain::NoReadings));
    for value in [f64::NAN, -0.1, 1.1] {
        assert!(matches!(MarkovChain::train(Readings::new(&[sample(0.0, value)])), Err(CannotTrain::Parameter { .. })));
    }
    let good = MarkovChainParts { rise_per_sec: 1e-4, fall_per_sec: 1e-4, last_nanos: 0, last_value: 1.0 };
    assert!(MarkovChain::from_parts(good).is_ok());
    for rate in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(MarkovChain::from_parts(MarkovChainParts { rise_per_sec: rate, ..good }).is_err());
        assert!(MarkovChain::from_parts(MarkovChainParts { fall_per_sec: rate, ..good }).is_err());
    }
    assert!(MarkovChain::from_parts(MarkovChainParts { last_value: 1.5, ..good }).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn no_rates_near_those_found_are_likelier(
        seed in any::<u64>(),
        low_hours in 0.1..20.0_f64,
        high_hours in 0.1..20.0_f64,
        longest_gap in 100.0..50_000.0_f64,
    ) {
        let samples = simulated(low_hours * HOUR, high_hours * HOUR, 30.0..longest_gap, 200, seed);
        let parts = trained(&samples).to_parts();
        let found = log_posterior(&samples, parts.rise_per_sec, parts.fall_per_sec);
        for (rise, fall) in [(1.03, 1.0), (1.0, 1.03), (0.97, 1.0), (1.0, 0.97), (1.03, 1.03), (0.5, 0.5), (3.0, 3.0), (0.5, 2.0)] {
            let other = log_posterior(&samples, parts.rise_per_sec * rise, parts.fall_per_sec * fall);
            // Gaps are rounded, so the maximum is not met to the last digit.
            prop_assert!(other <= found + 1e-3, "{rise} {fall}: {other} > {found}");
        }
        prop_assert_eq!(MarkovChain::from_parts(parts).unwrap().to_parts(), parts);
    }

    #[test]
    fn answers_are_probabilities(
        readings in prop::collection::vec((any::<i64>(), 0.0..=1.0_f64), 1..40),
        half_life in prop::option::of(prop::num::f64::ANY),
        when in any::<i64>(),
    ) {
        let mut samples: Vec<Sample> =
            readings.iter().map(|&(utc_nanos, value)| Sample { utc_nanos, offset_secs: 0, value }).collect();
        samples.sort_by_key(|sample| sample.utc_nanos);
        let chain = MarkovChain::train(Readings { half_life_secs: half_life, ..Readings::new(&samples) }).unwrap();
        let p = chain.predict(Moment { utc_nanos: when, offset_secs: 0 });
        prop_assert!((0.0..=1.0).contains(&p), "{}", p);
    }
}
