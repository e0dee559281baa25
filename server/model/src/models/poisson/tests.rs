//! Tests the properties of `poisson.rs`.

use proptest::prelude::*;
use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};

use super::*;
use crate::Sample;

const DAY_NANOS: i64 = 86_400 * 1_000_000_000;

fn sample(utc_nanos: i64, value: f64) -> Sample {
    Sample { utc_nanos, offset_secs: 0, value }
}

/// A Poisson count (Knuth, TAOCP 3.4.1).
fn drawn(random: &mut SmallRng, mean: f64) -> f64 {
    let (limit, mut product, mut count) = ((-mean).exp(), random.random::<f64>(), 0.0);
    while product > limit {
        product *= random.random::<f64>();
        count += 1.0;
    }
    count
}

/// Counts of every ten minutes with a mean count that depends on the hour of the day.
fn counts(days: i64, seed: u64, mean: impl Fn(f64) -> f64) -> Vec<Sample> {
    let mut random = SmallRng::seed_from_u64(seed);
    (0..days * 144)
        .map(|step| sample(step * COUNT_BIN_NANOS, drawn(&mut random, mean((step % 144) as f64 / 6.0))))
        .collect()
}

fn trained(samples: &[Sample]) -> PoissonSpectral {
    PoissonSpectral::train(Readings::new(samples), &Periodicities::default(), COUNT_BIN_NANOS).unwrap()
}

fn at(secs: i64) -> Moment {
    Moment { utc_nanos: secs * 1_000_000_000, offset_secs: 0 }
}

#[test]
fn a_daily_rhythm_of_counts_is_found() {
    let mean = |hour: f64| 3.0 + 2.5 * (std::f64::consts::TAU * (hour - 14.0) / 24.0).cos();
    let model = trained(&counts(28, 1, mean));
    assert!(model.order() >= 1);
    let error = |hour: i64| (model.predict(at(100 * 86_400 + hour * 3600)) - mean(hour as f64)).abs();
    let worst = (0..24).map(error).fold(0.0, f64::max);
    assert!(worst < 0.5, "{worst}");
}

#[test]
fn counts_without_a_rhythm_mostly_get_no_component() {
    let orders: Vec<usize> = (0..20).map(|seed| trained(&counts(14, seed, |_| 2.0)).order()).collect();
    let none = orders.iter().filter(|&&order| order == 0).count();
    assert!(none >= 19, "{orders:?}");
}

#[test]
fn a_count_that_was_always_0_has_a_small_positive_rate() {
    let rate = |days| trained(&counts(days, 1, |_| 0.0)).predict(at(0));
    assert!((rate(1) - 0.5 / 145.0).abs() < 1e-12);
    assert!(rate(28) > 0.0 && rate(28) < rate(1));
}

#[test]
fn the_rate_never_falls_to_0_at_night() {
    let model = trained(&counts(28, 3, |hour| if (12.0..13.0).contains(&hour) { 20.0 } else { 0.0 }));
    assert!(model.order() >= 2, "{}", model.order());
    for minute in 0..1440 {
        assert!(model.predict(at(minute * 60)) >= 0.5 / 29.0 - 1e-12);
    }
    assert!(model.predict(at(12 * 3600 + 1800)) > 8.0);
}

#[test]
fn readings_of_a_bin_add_up_and_unobserved_bins_are_not_0() {
    // There are two readings of 1 in the first bin of each hour, and none in the other five.
    let samples: Vec<Sample> =
        (0..48).map(|half| sample(half / 2 * 3600 * 1_000_000_000 + half % 2 * 1_000_000_000, 1.0)).collect();
    assert!((trained(&samples).predict(at(0)) - 48.5 / 25.0).abs() < 1e-12);
    let hourly =
        PoissonSpectral::train(Readings::new(&samples), &Periodicities::default(), 24 * 6 * COUNT_BIN_NANOS).unwrap();
    assert!((hourly.predict(at(0)) - 48.5 / 2.0).abs() < 1e-12);
}

#[test]
fn older_counts_fade() {
    let samples = [sample(0, 8.0), sample(DAY_NANOS, 2.0)];
    let readings = Readings { half_life_secs: Some(86_400.0), ..Readings::new(&samples) };
    let model = PoissonSpectral::train(readings, &Periodicities::default(), COUNT_BIN_NANOS).unwrap();
    assert!((model.predict(at(0)) - (0.5 + 0.5 * 8.0 + 2.0) / 2.5).abs() < 1e-12);
}

#[test]
fn nonsense_is_refused() {
    let week = Periodicities::default();
    let train = |samples: &[Sample], bin| PoissonSpectral::train(Readings::new(samples), &week, bin);
    assert_eq!(train(&[], COUNT_BIN_NANOS), Err(CannotTrain::NoReadings));
    for value in [-1.0, f64::NAN, f64::INFINITY, 1e13] {
        assert!(matches!(train(&[sample(0, value)], COUNT_BIN_NANOS), Err(CannotTrain::Parameter { .. })));
    }
    for bin in [0, -1, 999_999_999, i64::MAX] {
        assert!(matches!(train(&[sample(0, 1.0)], bin), Err(CannotTrain::Parameter { .. })));
    }
    let good = trained(&counts(28, 1, |hour| hour)).to_parts();
    assert!(!good.components.is_empty());
    let damaged = |change: &dyn Fn(&mut PoissonSpectralParts)| {
        let mut parts = good.clone();
        change(&mut parts);
        PoissonSpectral::from_parts(&week, parts).is_err()
    };
    assert!(!damaged(&|_| ()));
    assert!(damaged(&|parts| parts.bin_nanos = 0));
    assert!(damaged(&|parts| parts.mean = 0.0));
    assert!(damaged(&|parts| parts.floor = 0.0));
    assert!(damaged(&|parts| parts.floor = f64::NAN));
    assert!(damaged(&|parts| parts.components = vec![parts.components[0]; 16]));
    assert!(damaged(&|parts| parts.components[0].periodicity = 168));
    assert!(damaged(&|parts| parts.components[0].gamma_im = f64::NAN));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn rates_are_positive_and_survive_storage(
        rows in prop::collection::vec((any::<i64>(), 0.0..=1e12_f64), 1..60),
        half_life_secs in prop::option::of(prop::num::f64::ANY),
        when in any::<i64>(),
    ) {
        let mut samples: Vec<Sample> = rows.iter().map(|&(nanos, value)| sample(nanos, value)).collect();
        samples.sort_by_key(|sample| sample.utc_nanos);
        let week = Periodicities::default();
        let readings = Readings { half_life_secs, ..Readings::new(&samples) };
        let model = PoissonSpectral::train(readings, &week, COUNT_BIN_NANOS).unwrap();
        let predicted = model.predict(Moment { utc_nanos: when, offset_secs: 0 });
        prop_assert!(predicted > 0.0 && predicted.is_finite(), "{}", predicted);
        prop_assert_eq!(PoissonSpectral::from_parts(&week, model.to_parts()), Ok(model));
    }
}
