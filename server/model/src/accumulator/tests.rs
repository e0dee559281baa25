//! Tests the properties of `accumulator.rs`, against a naive oracle where there is one.

use proptest::prelude::*;

use super::*;
use crate::{PeriodicityDefinition, SpectralModel};

const DAY_NANOS: i64 = 86_400_000_000_000;

/// γ_k by its definition, one `sin_cos` each, phases reduced in 128-bit integers.
fn oracle_gammas(periodicities: &Periodicities, samples: &[Sample]) -> Vec<(f64, f64)> {
    let n = samples.len() as f64;
    let mean = samples.iter().map(|s| s.value).sum::<f64>() / n;
    (0..periodicities.len())
        .map(|k| {
            let (mut re, mut im) = (0.0, 0.0);
            for sample in samples {
                let (period, multiple) = match periodicities.definition() {
                    PeriodicityDefinition::Harmonics { base_nanos, .. } => (*base_nanos, k as f64 + 1.0),
                    PeriodicityDefinition::List { period_nanos } => (period_nanos[k], 1.0),
                };
                let fraction = i128::from(sample.civil_nanos()).rem_euclid(i128::from(period)) as f64 / period as f64;
                let (sin, cos) = (std::f64::consts::TAU * multiple * fraction).sin_cos();
                re += (sample.value - mean) * cos;
                im -= (sample.value - mean) * sin;
            }
            (re / n, im / n)
        })
        .collect()
}

fn gammas(accumulator: &Accumulator) -> Vec<(f64, f64)> {
    let (n, mean) = (accumulator.observations() as f64, accumulator.mean());
    let gamma = |&[a_re, a_im, b_re, b_im]: &[f64; 4]| ((a_re - mean * b_re) / n, (a_im - mean * b_im) / n);
    accumulator.spectrum().iter().map(gamma).collect()
}

#[track_caller]
fn check_same(found: &[(f64, f64)], expected: &[(f64, f64)]) {
    assert_eq!(found.len(), expected.len());
    for (k, (found, expected)) in found.iter().zip(expected).enumerate() {
        let error = (found.0 - expected.0).hypot(found.1 - expected.1);
        assert!(error <= 1e-9, "periodicity {k}: {found:?}, expected {expected:?}, off by {error:e}");
    }
}

fn any_periodicities() -> impl Strategy<Value = Periodicities> {
    let harmonics = (3_000_000_000_000_i64..3_000_000_000_000_000_000, prop_oneof![1_u32..300, Just(2048_u32)])
        .prop_map(|(base_nanos, count)| Periodicities::harmonics(base_nanos, count).unwrap());
    let list = proptest::collection::hash_set(1_000_000_000_i64..100 * 365 * DAY_NANOS, 1..200)
        .prop_map(|periods| Periodicities::list(periods.into_iter().collect()).unwrap());
    prop_oneof![harmonics, list]
}

fn any_value() -> impl Strategy<Value = f64> {
    prop_oneof![Just(0.0), Just(1.0), 0.0..=1.0]
}

fn any_samples() -> impl Strategy<Value = Vec<Sample>> {
    let sample = |spread: i64| {
        (0..spread, -50_400..50_400_i32, any_value()).prop_map(|(utc_nanos, offset_secs, value)| Sample {
            utc_nanos,
            offset_secs,
            value,
        })
    };
    let clustered = proptest::collection::vec(sample(60 * DAY_NANOS), 1..150);
    prop_oneof![clustered, proptest::collection::vec(sample(i64::MAX), 1..150)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn gamma_matches_the_naive_sums(periodicities in any_periodicities(), samples in any_samples()) {
        let mut accumulator = Accumulator::new(&periodicities);
        accumulator.add(&periodicities, &samples);
        check_same(&gammas(&accumulator), &oracle_gammas(&periodicities, &samples));
    }

    #[test]
    fn order_and_batching_do_not_matter(
        periodicities in any_periodicities(),
        (samples, shuffled) in any_samples().prop_flat_map(|s| (Just(s.clone()), Just(s).prop_shuffle())),
        batch in 1_usize..40,
    ) {
        let mut at_once = Accumulator::new(&periodicities);
        at_once.add(&periodicities, &samples);
        let mut batched = Accumulator::new(&periodicities);
        for batch in shuffled.chunks(batch) {
            batched.add(&periodicities, batch);
        }
        check_same(&gammas(&batched), &gammas(&at_once));
        prop_assert_eq!(batched.observations(), samples.len() as u64);
        prop_assert_eq!(batched.first_nanos(), samples.iter().map(|s| s.utc_nanos).min());
        prop_assert_eq!(batched.last_nanos(), samples.iter().map(|s| s.utc_nanos).max());
        prop_assert!((batched.mean() - at_once.mean()).abs() < 1e-12);
        prop_assert!((batched.to_parts().sum_squares - at_once.to_parts().sum_squares).abs() < 1e-9);
    }

    #[test]
    fn parts_come_back_the_same(periodicities in any_periodicities(), samples in any_samples()) {
        let mut accumulator = Accumulator::new(&periodicities);
        accumulator.add(&periodicities, &samples);
        let again = Accumulator::from_parts(&periodicities, accumulator.to_parts()).unwrap();
        prop_assert_eq!(again, accumulator);
    }
}

#[test]
fn several_chunks_match_the_naive_sums_at_2048_harmonics() {
    let year = Periodicities::harmonics(365 * DAY_NANOS, 2048).unwrap();
    let samples: Vec<Sample> = (0..2 * CHUNK as i64 + 37)
        .map(|i| Sample {
            utc_nanos: i * 7_919_000_000_123 + i * i * 1_000_003,
            offset_secs: 3600,
            value: f64::from(u8::from(i % 7 < 3)),
        })
        .collect();
    let mut accumulator = Accumulator::new(&year);
    accumulator.add(&year, &samples);
    check_same(&gammas(&accumulator), &oracle_gammas(&year, &samples));
}

#[test]
fn boundary_times_are_exact() {
    // The times are 1970, 2038-01-19T03:14:07, 2106-02-07T06:28:15, the end of i64, and local times past both ends.
    let seconds = [0_i64, i64::from(i32::MAX), i64::from(u32::MAX), i64::MAX / 1_000_000_000];
    let mut samples: Vec<Sample> = seconds
        .iter()
        .flat_map(|&secs| [(secs, 0, 1.0), (secs.saturating_sub(1).max(0), 3600, 0.0), (secs, -50_400, 0.25)])
        .map(|(secs, offset_secs, value)| Sample { utc_nanos: secs * 1_000_000_000, offset_secs, value })
        .collect();
    samples.push(Sample { utc_nanos: i64::MAX, offset_secs: 50_400, value: 1.0 });
    samples.push(Sample { utc_nanos: 0, offset_secs: -50_400, value: 1.0 });
    let list = Periodicities::list(vec![1_000_000_000, DAY_NANOS, 7 * DAY_NANOS, 36_525 * DAY_NANOS]).unwrap();
    for periodicities in [Periodicities::default(), list] {
        let mut accumulator = Accumulator::new(&periodicities);
        accumulator.add(&periodicities, &samples);
        check_same(&gammas(&accumulator), &oracle_gammas(&periodicities, &samples));
        assert_eq!(accumulator.span_nanos(), i64::MAX as u64);
        assert_eq!(SpectralModel::train(&accumulator, &periodicities).observations(), 14);
    }
}

#[test]
fn empty_accumulator_knows_nothing_and_holds_no_spectrum() {
    let week = Periodicities::default();
    let mut accumulator = Accumulator::new(&week);
    accumulator.add(&week, &[]);
    assert_eq!(accumulator.observations(), 0);
    assert!((accumulator.mean() - 0.5).abs() < 1e-15);
    assert_eq!((accumulator.first_nanos(), accumulator.last_nanos()), (None, None));
    assert!(accumulator.to_parts().spectrum.is_empty());
    assert_eq!(Accumulator::from_parts(&week, accumulator.to_parts()), Ok(accumulator));
}

#[test]
fn damaged_parts_are_refused() {
    let week = Periodicities::default();
    let mut accumulator = Accumulator::new(&week);
    accumulator.add(&week, &[Sample { utc_nanos: 5, offset_secs: 0, value: 1.0 }]);
    let damaged = |damage: fn(&mut AccumulatorParts)| {
        let mut parts = accumulator.to_summed_parts(&week);
        damage(&mut parts);
        Accumulator::from_parts(&week, parts).unwrap_err()
    };
    let length = damaged(|parts| parts.spectrum.truncate(3));
    assert_eq!(length, InvalidParts::SpectrumLength { expected: 168, found: 3 });
    let times = damaged(|parts| parts.first_nanos = 6);
    assert_eq!(times, InvalidParts::TimesReversed { first_nanos: 6, last_nanos: 5 });
    assert!(matches!(damaged(|parts| parts.sum = f64::NAN), InvalidParts::OutOfRange { field: "sum", .. }));
    assert!(matches!(damaged(|parts| parts.spectrum[9][2] = 1.5), InvalidParts::OutOfRange { field: "spectrum", .. }));
    assert!(matches!(damaged(|parts| parts.sum_squares = -1.0), InvalidParts::OutOfRange { .. }));
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let list = Periodicities::list(vec![1_000_000_000, DAY_NANOS, 7 * DAY_NANOS]).unwrap();
    let samples: Vec<Sample> = (0..517_i64)
        .map(|i| Sample { utc_nanos: i * i * 1_234_567_891, offset_secs: 3600, value: f64::from(u8::from(i % 3 == 0)) })
        .collect();
    for length in (0..42).chain([127, 128, 129, 517]) {
        check_instruction_sets(&Periodicities::default(), &samples[..length]);
        check_instruction_sets(&list, &samples[..length]);
    }
}

fn check_instruction_sets(periodicities: &Periodicities, samples: &[Sample]) {
    let mut expected = Accumulator::new(periodicities);
    expected.add(periodicities, samples);
    let mut expected = expected.spectrum().to_vec();
    expected.resize(periodicities.len(), [0.0; 4]);
    let bits = |spectrum: &[[f64; 4]]| spectrum.iter().map(|numbers| numbers.map(f64::to_bits)).collect::<Vec<_>>();
    for arch in crate::phasor::every_arch() {
        let mut spectrum = vec![[0.0; 4]; periodicities.len()];
        let cycles = periodicities.cycles();
        arch.dispatch(OnLanes(fold::Fold { cycles, samples, spectrum: &mut spectrum }));
        assert_eq!(bits(&spectrum), bits(&expected), "{arch:?}, {} samples", samples.len());
    }
}

/// Batches of a few readings.
fn short_batches() -> impl Strategy<Value = Vec<Vec<Sample>>> {
    let sample = (0..60 * DAY_NANOS, -7200..7200, -5.0..5.0).prop_map(|(utc_nanos, offset_secs, value)| Sample {
        utc_nanos,
        offset_secs,
        value,
    });
    prop::collection::vec(prop::collection::vec(sample, 0..4), 0..50)
}

proptest! {
    #[test]
    fn a_short_record_gives_the_bits_of_its_sums(batches in short_batches()) {
        let week = Periodicities::default();
        let mut whole = Accumulator::of_kind(StateKind::Continuous);
        let mut packed = whole.clone();
        for batch in &batches {
            whole.add(&week, batch);
            packed.unpack(&week).unwrap();
            packed.add(&week, batch);
            packed.pack();
        }
        let stored = Accumulator::from_parts_of(StateKind::Continuous, &week, packed.to_parts()).unwrap();
        prop_assert_eq!(&stored, &whole);
        let bits = |accumulator: &Accumulator| -> Vec<u64> {
            accumulator.to_summed_parts(&week).spectrum.as_flattened().iter().map(|number| number.to_bits()).collect()
        };
        let expected: Vec<u64> = whole.spectrum().as_flattened().iter().map(|number| number.to_bits()).collect();
        prop_assert_eq!(bits(&packed), expected.clone());
        prop_assert_eq!(bits(&stored), expected);
        let is_short = batches.iter().filter(|batch| !batch.is_empty()).count() <= 32
            && batches.iter().map(Vec::len).sum::<usize>() <= 48;
        prop_assert_eq!(packed.cell().is_none(), is_short);
    }
}

#[test]
fn a_short_record_that_is_not_that_of_its_state_is_refused() {
    let week = Periodicities::default();
    let mut accumulator = Accumulator::new(&week);
    let sample = |utc_nanos| Sample { utc_nanos, offset_secs: 0, value: 1.0 };
    accumulator.add(&week, &[sample(5), sample(6)]);
    let damaged = |damage: fn(&mut ShortRecord)| {
        let mut parts = accumulator.to_parts();
        damage(parts.short.as_mut().unwrap());
        Accumulator::from_parts(&week, parts).is_err()
    };
    assert!(damaged(|short| short.readings.truncate(1)));
    assert!(damaged(|short| short.batches[0] = 1));
    assert!(damaged(|short| short.batches.push(0)));
    assert!(damaged(|short| short.readings[0].1 = 1.5));
    assert!(!damaged(|_| {}));
}
