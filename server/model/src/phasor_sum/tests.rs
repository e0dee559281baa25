//! Tests the properties of `phasor_sum.rs`, against a naive oracle where there is one.

use proptest::prelude::*;

use super::*;
use crate::PeriodicityDefinition;
use crate::phasor::every_arch;

const DAY_NANOS: i64 = 86_400_000_000_000;

/// Σ e^(-jω_k t) by its definition, one `sin_cos` each, phases reduced in 128-bit integers.
fn oracle(periodicities: &Periodicities, times: &[i64]) -> Vec<f64> {
    let count = periodicities.len();
    let mut parts = vec![0.0; 2 * count];
    for k in 0..count {
        let (period, multiple) = match periodicities.definition() {
            PeriodicityDefinition::Harmonics { base_nanos, .. } => (*base_nanos, k as f64 + 1.0),
            PeriodicityDefinition::List { period_nanos } => (period_nanos[k], 1.0),
        };
        for &civil in times {
            let fraction = i128::from(civil).rem_euclid(i128::from(period)) as f64 / period as f64;
            let (sin, cos) = (std::f64::consts::TAU * multiple * fraction).sin_cos();
            parts[k] += cos;
            parts[count + k] -= sin;
        }
    }
    parts
}

#[track_caller]
fn check_same(found: &[f64], expected: &[f64], times: usize) {
    assert_eq!(found.len(), expected.len());
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        let error = (found - expected).abs();
        assert!(error <= 1e-9 * times.max(1) as f64, "entry {i}: {found}, expected {expected}, off by {error:e}");
    }
}

fn any_periodicities() -> impl Strategy<Value = Periodicities> {
    let harmonics = (3_000_000_000_000_i64..3_000_000_000_000_000_000, 1_u32..200)
        .prop_map(|(base_nanos, count)| Periodicities::harmonics(base_nanos, count).unwrap());
    let list = proptest::collection::hash_set(1_000_000_000_i64..100 * 365 * DAY_NANOS, 1..40)
        .prop_map(|periods| Periodicities::list(periods.into_iter().collect()).unwrap());
    prop_oneof![harmonics, list]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn sums_over_runs_are_those_over_their_times(
        periodicities in any_periodicities(),
        chunks in proptest::collection::vec(proptest::collection::vec((0..60 * DAY_NANOS, any::<bool>()), 0..60), 0..5),
    ) {
        let mut running = RunningSums::new(&periodicities);
        let mut cell = PhasorSum::zero(&periodicities);
        let (mut before, mut occupied) = (Vec::new(), Vec::new());
        for chunk in &chunks {
            let times: Vec<i64> = chunk.iter().map(|(civil, _)| *civil).collect();
            running.extend_chunk(&PhasorTable::new(&periodicities, &times));
            prop_assert_eq!((running.len(), running.is_empty()), (times.len(), times.is_empty()));
            // The run that is open at the start of a row of one value each.
            let mut at = 0;
            for run in chunk.chunk_by(|a, b| a.1 == b.1) {
                if run[0].1 {
                    cell.add_difference(running.row(at + run.len()), running.row(at));
                    occupied.extend(run.iter().map(|(civil, _)| *civil));
                }
                at += run.len();
            }
            for i in 0..=times.len() {
                check_same(running.row(i), &oracle(&periodicities, &before), before.len());
                before.extend(times.get(i));
            }
            prop_assert!(running.row(times.len() + 1).is_empty());
        }
        check_same(cell.as_slice(), &oracle(&periodicities, &occupied), before.len());
        let stored = PhasorSum::from_slice(&periodicities, cell.as_slice()).unwrap();
        prop_assert_eq!(&stored, &cell);
        running.reset();
        prop_assert!(running.is_empty() && running.row(0) == PhasorSum::zero(&periodicities).as_slice());
    }

    #[test]
    fn weighted_times_count_as_their_weights(
        periodicities in any_periodicities(),
        chunks in proptest::collection::vec(proptest::collection::vec((0..60 * DAY_NANOS, -4.0..4.0), 0..40), 0..4),
        missing in 0_usize..3,
    ) {
        let mut running = RunningSums::new(&periodicities);
        let mut expected = vec![0.0; 2 * periodicities.len()];
        let mut count = 0;
        for chunk in &chunks {
            let (times, mut weights): (Vec<i64>, Vec<f64>) = chunk.iter().copied().unzip();
            weights.truncate(times.len().saturating_sub(missing));
            running.extend_weighted(&PhasorTable::new(&periodicities, &times), &weights);
            check_same(running.row(0), &expected, count);
            for (i, civil) in times.iter().enumerate() {
                let weight = weights.get(i).copied().unwrap_or(0.0);
                let phasor = oracle(&periodicities, &[*civil]);
                expected.iter_mut().zip(phasor).for_each(|(sum, part)| *sum += weight * part);
                count += 4;
                check_same(running.row(i + 1), &expected, count);
            }
        }
    }

    #[test]
    fn rows_of_any_length_are_added_and_taken_away(
        count in 1_u32..40,
        plus in proptest::collection::vec(-9.0..9.0, 0..90),
        minus in proptest::collection::vec(-9.0..9.0, 0..90),
    ) {
        let periodicities = Periodicities::harmonics(7 * DAY_NANOS, count).unwrap();
        let width = 2 * count as usize;
        let entry = |row: &[f64], i: usize| row.get(i).copied().unwrap_or(0.0);
        let mut sum = PhasorSum::zero(&periodicities);
        sum.add_row(&plus);
        let twice = sum.clone();
        sum.add(&twice);
        sum.subtract_row(&minus);
        let expected: Vec<f64> = (0..width).map(|i| 2.0 * entry(&plus, i) - entry(&minus, i)).collect();
        check_same(sum.as_slice(), &expected, 1);
        let used = width.min(plus.len()).min(minus.len());
        let expected: Vec<f64> = (0..width).map(|i| if i < used { plus[i] - minus[i] } else { 0.0 }).collect();
        for arch in every_arch() {
            let mut sum = vec![0.0; width];
            arch.dispatch(AddDifference { sum: &mut sum, plus: &plus, minus: &minus });
            check_same(&sum, &expected, 1);
            arch.dispatch(AddRow::<false> { sum: &mut sum, row: &minus });
            arch.dispatch(AddRow::<true> { sum: &mut sum, row: &minus });
            check_same(&sum, &expected, 1);
        }
    }
}

#[test]
fn a_day_of_scans_stays_exact() {
    let week = Periodicities::default();
    let times: Vec<i64> = (0..17_200_i64).map(|i| 20_000 * DAY_NANOS + i * 5_023_255_813 + i * i % 997).collect();
    let mut running = RunningSums::new(&week);
    for chunk in times.chunks(512) {
        running.extend_chunk(&PhasorTable::new(&week, chunk));
    }
    check_same(running.row(running.len()), &oracle(&week, &times), times.len());
}

#[test]
fn what_a_table_does_not_hold_stays() {
    let week = Periodicities::default();
    let mut running = RunningSums::new(&week);
    running.extend_chunk(&PhasorTable::new(&week, &[1, 2, 3]));
    let before = running.row(3).to_vec();
    running.extend_chunk(&PhasorTable::only(&week, &[4, 5], &[2]));
    for (k, (found, before)) in running.row(2)[..168].iter().zip(&before).enumerate() {
        assert_eq!((found - before).abs() > 1.0, k == 2);
    }
}

#[test]
fn damaged_parts_are_refused() {
    let pair = Periodicities::harmonics(DAY_NANOS, 2).unwrap();
    assert!(PhasorSum::from_slice(&pair, &[0.0, 1.0, -2.0, 1e9]).is_ok());
    let short = PhasorSum::from_slice(&pair, &[0.0; 3]);
    assert_eq!(short, Err(InvalidParts::SpectrumLength { expected: 4, found: 3 }));
    for damaged in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert!(PhasorSum::from_slice(&pair, &[0.0, damaged, 0.0, 0.0]).is_err());
    }
}

#[test]
fn memory_is_counted() {
    let week = Periodicities::default();
    assert_eq!(PhasorSum::zero(&week).bytes(), 16 + 2 * 168 * 8);
    let mut running = RunningSums::new(&week);
    let before = running.bytes();
    running.extend_chunk(&PhasorTable::new(&week, &[0; 100]));
    assert!(running.bytes() >= before + 100 * 2 * 168 * 8);
}

#[test]
fn rows_are_added_with_equal_bits_on_every_instruction_set() {
    let row =
        |from: usize, count: usize| -> Vec<f64> { (from..from + count).map(|i| (i as f64).sin() / 3.0).collect() };
    for count in 0..42 {
        let (plus, minus, before) = (row(0, count), row(100, count), row(200, count));
        let difference =
            before.iter().zip(plus.iter().zip(&minus)).map(|(before, (plus, minus))| before + (plus - minus));
        let difference: Vec<u64> = difference.map(f64::to_bits).collect();
        let of_both = before.iter().zip(plus.iter().zip(&minus)).map(|(before, (plus, minus))| before + plus - minus);
        let of_both: Vec<u64> = of_both.map(f64::to_bits).collect();
        let bits = |sum: &[f64]| sum.iter().map(|number| number.to_bits()).collect::<Vec<_>>();
        for arch in every_arch() {
            let mut sum = before.clone();
            arch.dispatch(AddDifference { sum: &mut sum, plus: &plus, minus: &minus });
            assert_eq!(bits(&sum), difference, "{arch:?}, {count} numbers");
            let mut sum = before.clone();
            arch.dispatch(AddRow::<false> { sum: &mut sum, row: &plus });
            arch.dispatch(AddRow::<true> { sum: &mut sum, row: &minus });
            assert_eq!(bits(&sum), of_both, "{arch:?}, {count} numbers");
        }
    }
}
