//! Tests the properties of `evaluate.rs`, against a naive oracle where there is one.

use proptest::prelude::*;

use super::*;
use crate::Component;

#[test]
fn nothing_to_evaluate_has_no_error() {
    let week = Periodicities::default();
    let evaluations = evaluate(&SpectralModel::default(), &week, &[], 99);
    assert_eq!(evaluations, vec![Evaluation::default(); ORDER_MAX + 1]);
    assert!(evaluations[0].mse().abs() < 1e-15 && evaluations[0].error_rate().abs() < 1e-15);
}

#[test]
fn one_half_counts_as_one() {
    let samples = [0.0, 0.4, 0.5, 1.0].map(|value| Sample { utc_nanos: 0, offset_secs: 0, value });
    let evaluation = evaluate(&SpectralModel::default(), &Periodicities::default(), &samples, 0)[0];
    assert_eq!((evaluation.observations, evaluation.wrong), (4, 2));
    assert!((evaluation.squared_error - 0.51).abs() < 1e-12);
    assert!((evaluation.mse() - 0.1275).abs() < 1e-12);
    assert!((evaluation.error_rate() - 0.5).abs() < 1e-12);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_order_is_scored_as_if_alone(
        gammas in proptest::collection::vec((0_u32..168, -0.3..0.3, -0.3..0.3), 0..=ORDER_MAX),
        observed in proptest::collection::vec((0..i64::MAX, 0.0..=1.0), 0..60),
        repeats in prop_oneof![Just(1_usize), Just(40)],
    ) {
        let week = Periodicities::default();
        let components = gammas
            .iter()
            .map(|&(periodicity, gamma_re, gamma_im)| Component { periodicity, gamma_re, gamma_im })
            .collect();
        let model = SpectralModel::from_parts(0.45, 3, components).unwrap();
        let samples: Vec<Sample> =
            observed.iter().map(|&(utc_nanos, value)| Sample { utc_nanos, offset_secs: -3600, value }).collect();
        let evaluations = evaluate(&model, &week, &samples.repeat(repeats), ORDER_MAX);
        prop_assert_eq!(evaluations.len(), ORDER_MAX + 1);
        for (order, found) in evaluations.iter().enumerate() {
            let (mut squared, mut wrong) = (0.0, 0);
            for sample in &samples {
                let p = model.predict(&week, order, sample.civil_nanos());
                squared += (p - sample.value).powi(2) * repeats as f64;
                wrong += u64::from((p >= 0.5) != (sample.value >= 0.5)) * repeats as u64;
            }
            prop_assert!((found.squared_error - squared).abs() < 1e-7, "{order}: {found:?} {squared}");
            prop_assert_eq!(found.wrong, wrong);
        }
    }
}

#[test]
fn a_label_costs_its_surprise_and_is_wrong_if_another_is_as_likely() {
    let mut sum = Evaluation::default();
    sum.add_label(&[0.5, 0.25, 0.25], 0);
    assert_eq!((sum.mse(), sum.error_rate(), sum.log_loss_bits()), (0.375, 0.0, 1.0));
    sum.add_label(&[0.25, 0.25, 0.5], 1);
    assert_eq!((sum.mse(), sum.error_rate(), sum.log_loss_bits()), (0.625, 0.5, 1.5));
    let mut certain = Evaluation::default();
    certain.add_label(&[1.0, 0.0], 1);
    assert_eq!((certain.mse(), certain.wrong), (2.0, 1));
    assert!((certain.log_loss_bits() - 1e6_f64.log2()).abs() < 1e-12);
}
