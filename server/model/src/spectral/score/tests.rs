//! Tests the properties of `score.rs`, against one prediction at a time.

use proptest::prelude::*;

use super::*;
use crate::{Component, Periodicities};

/// Errors by their definition, at the times that count.
fn oracle(model: &SpectralModel, table: &PhasorTable, values: &[f64], weights: Option<&[f64]>) -> ScoreSums {
    let mut sums = ScoreSums::default();
    for (i, (&civil, &value)) in table.civil_nanos().iter().zip(values).enumerate() {
        if weights.is_some_and(|weights| weights.get(i).is_none_or(|&weight| weight == 0.0)) {
            continue;
        }
        for order in 0..=ORDER_MAX {
            let forecast = model.predict(table.periodicities(), order, civil);
            sums.squared[order] += (forecast - value) * (forecast - value);
            sums.wrong[order] += f64::from(u8::from((forecast >= 0.5) != (value >= 0.5)));
        }
    }
    sums
}

#[track_caller]
fn check_same(found: &ScoreSums, expected: &ScoreSums) {
    for order in 0..=ORDER_MAX {
        let (found_squared, expected_squared) = (found.squared[order], expected.squared[order]);
        assert!((found_squared - expected_squared).abs() < 1e-9, "order {order}: {found_squared} {expected_squared}");
        assert!((found.wrong[order] - expected.wrong[order]).abs() < 0.5, "order {order}: {found:?} {expected:?}");
    }
}

/// The readings whose weight is not 0.
fn readings(values: &[f64], weights: Option<&[f64]>) -> ReadingSums {
    let mut readings = ReadingSums::default();
    for (i, &value) in values.iter().enumerate().take(weights.map_or(usize::MAX, <[f64]>::len)) {
        readings.push(std::iter::once(value).filter(|_| weights.is_none_or(|weights| weights[i] != 0.0)));
    }
    readings
}

/// A model that leaves `[0,1]` at many times, and observations of two values.
fn example(components: u32, times: usize) -> (SpectralModel, PhasorTable, Vec<f64>, Vec<f64>) {
    let component = |k: u32| Component { periodicity: k * 11 % 168, gamma_re: 0.2, gamma_im: -0.07 * f64::from(k % 4) };
    let model = SpectralModel::from_parts(0.3, 100, (0..components).map(component).collect()).unwrap();
    let civil_nanos: Vec<i64> = (0..times as i64).map(|i| i * i * 987_654_321_012).collect();
    let values = (0..times).map(|i| f64::from(u8::from(i % 5 > 2))).collect();
    let weights = (0..times).map(|i| f64::from(u8::from(i % 7 > 1))).collect();
    (model, PhasorTable::new(&Periodicities::default(), &civil_nanos), values, weights)
}

#[test]
fn every_length_and_instruction_set_gives_the_errors_of_single_predictions() {
    for components in [0, 1, 7, 15] {
        for times in (0..70).chain([511, 512, 613]) {
            let (model, table, values, weights) = example(components, times);
            for weights in [None, Some(&weights[..])] {
                let expected = oracle(&model, &table, &values, weights);
                let readings = readings(&values, weights);
                let mut terms = [Term::default(); ORDER_MAX];
                let terms = model.terms(ORDER_MAX, &table, &mut terms).unwrap();
                for with_wrong in [false, true] {
                    let mut bits = None;
                    for arch in crate::phasor::every_arch() {
                        let mut sums = ScoreSums::default();
                        let ReadingSums { counts, sums: values, squares, high } = &readings;
                        let columns = Columns { counts, sums: values, squares, high };
                        let (mean, sums_of) = (model.mean(), &mut sums);
                        let kernel = ScoreKernel { mean, terms, columns, with_wrong, sums: sums_of };
                        arch.dispatch(OnLanes(kernel));
                        let found = (sums.squared.map(f64::to_bits), sums.wrong.map(f64::to_bits));
                        assert_eq!(*bits.get_or_insert(found), found, "{arch:?}");
                        if !with_wrong {
                            assert_eq!(sums.wrong, [0.0; ORDER_MAX + 1]);
                            sums.wrong = expected.wrong;
                        }
                        check_same(&sums, &expected);
                    }
                }
            }
        }
    }
}

#[test]
fn sums_are_added_to_and_short_slices_end_the_scoring() {
    let (model, table, values, weights) = example(15, 100);
    let mut sums = ScoreSums::default();
    model.score_run_values(&table, &values[..40], &mut sums, true);
    model.score_readings(&table, &readings(&values, Some(&weights[..33])), &mut sums, true);
    model.score_run_values(&table, &[], &mut sums, true);
    let (first, second) =
        (oracle(&model, &table, &values[..40], None), oracle(&model, &table, &values, Some(&weights[..33])));
    let mut expected = first;
    for order in 0..=ORDER_MAX {
        expected.squared[order] += second.squared[order];
        expected.wrong[order] += second.wrong[order];
    }
    check_same(&sums, &expected);
}

#[test]
fn a_prediction_of_exactly_one_half_counts_as_one() {
    let table = PhasorTable::new(&Periodicities::default(), &[1, 2, 3]);
    let mut sums = ScoreSums::default();
    SpectralModel::default().score_run_values(&table, &[0.0, 0.5, 1.0], &mut sums, true);
    assert_eq!(sums.wrong, [1.0; ORDER_MAX + 1]);
}

#[test]
fn readings_of_a_time_cost_as_much_together_as_one_by_one() {
    let (model, table, values, _) = example(15, 60);
    let (mut together, mut single) = (ReadingSums::default(), ScoreSums::default());
    let readings = |time: usize| (0..time % 5).map(move |reading| [0.0, 0.5, 0.3, 1.0][reading]);
    for time in 0..values.len() {
        together.push(readings(time));
        let table = PhasorTable::new(table.periodicities(), &table.civil_nanos()[time..=time]);
        for value in readings(time) {
            let of_one = oracle(&model, &table, &[value], None);
            for order in 0..=ORDER_MAX {
                single.squared[order] += of_one.squared[order];
                single.wrong[order] += of_one.wrong[order];
            }
        }
    }
    let mut sums = ScoreSums::default();
    model.score_readings(&table, &together, &mut sums, true);
    check_same(&sums, &single);
}

#[test]
fn a_perfect_prediction_has_no_error_below_zero() {
    let table = PhasorTable::new(&Periodicities::default(), &[1, 2, 3]);
    let model = SpectralModel::from_parts(0.1, 9, Vec::new()).unwrap();
    let (mut readings, mut sums) = (ReadingSums::default(), ScoreSums::default());
    (0..3).for_each(|_| readings.push([0.1; 13].into_iter()));
    model.score_readings(&table, &readings, &mut sums, true);
    assert!((0.0..1e-12).contains(&sums.squared[0]), "{:?}", sums.squared);
    assert_eq!(sums.wrong[0], 0.0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn errors_are_those_of_single_predictions(
        mean in 0.0..=1.0,
        parts in proptest::collection::vec((0_u32..200, -0.3..0.3, -0.3..0.3), 0..=ORDER_MAX),
        observed in proptest::collection::vec((0..=i64::MAX, 0.0..=1.0, any::<bool>()), 0..150),
        weighted in any::<bool>(),
        chosen in proptest::collection::vec(0_u32..200, 0..4),
    ) {
        let week = Periodicities::default();
        let component = |&(periodicity, gamma_re, gamma_im): &(u32, f64, f64)| Component { periodicity, gamma_re, gamma_im };
        let model = SpectralModel::from_parts(mean, 9, parts.iter().map(component).collect()).unwrap();
        let times: Vec<i64> = observed.iter().map(|row| row.0).collect();
        let values: Vec<f64> = observed.iter().map(|row| row.1).collect();
        let weights: Vec<f64> = observed.iter().map(|row| f64::from(u8::from(row.2))).collect();
        let weights = weighted.then_some(&weights[..]);
        // One table holds all periodicities, and one does not hold those that the model needs.
        for table in [PhasorTable::new(&week, &times), PhasorTable::only(&week, &times, &chosen)] {
            let mut sums = ScoreSums::default();
            model.score_readings(&table, &readings(&values, weights), &mut sums, true);
            check_same(&sums, &oracle(&model, &table, &values, weights));
        }
    }
}
