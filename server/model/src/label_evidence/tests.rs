//! Posteriors of labels against sums that are done by hand, and evidence that is refused.
//!
//! Invariant: the oracle is the formula without any care for scale.

use proptest::prelude::*;

use super::{InvalidEvidence, LABELS, LabelEvidence, LabelPlaces, PRIOR_MIN};

fn posterior(likelihoods: &[f64], temporal: &[f64], spatial: Option<&[f64]>) -> Result<Vec<f64>, InvalidEvidence> {
    LabelEvidence { likelihoods, temporal, spatial }.posterior()
}

/// The formula at the top of the file.
fn oracle(likelihoods: &[f64], temporal: &[f64], spatial: Option<&[f64]>) -> Vec<f64> {
    let floored = |values: &[f64], label: usize| if values[label] < PRIOR_MIN { PRIOR_MIN } else { values[label] };
    let product = |label: usize| {
        likelihoods[label] * floored(temporal, label) * spatial.map_or(1.0, |values| floored(values, label))
    };
    let sum: f64 = (0..likelihoods.len()).map(product).sum();
    (0..likelihoods.len()).map(|label| product(label) / sum).collect()
}

fn close(found: &[f64], expected: &[f64]) -> bool {
    found.len() == expected.len()
        && found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-12)
}

#[test]
fn likelihood_time_and_place_multiply() {
    // 0.6 · 0.5 : 0.4 · 0.25 = 3 : 1.
    let by_time = posterior(&[0.6, 0.4], &[0.5, 0.25], None).unwrap();
    assert!(close(&by_time, &[0.75, 0.25]), "{by_time:?}");
    // 3 · 0.1 : 1 · 0.9 = 1 : 3.
    let by_place = posterior(&[0.6, 0.4], &[0.5, 0.25], Some(&[0.1, 0.9])).unwrap();
    assert!(close(&by_place, &[0.25, 0.75]), "{by_place:?}");
}

#[test]
fn a_prior_of_0_does_not_exclude_a_label_but_a_likelihood_of_0_does() {
    let unusual = posterior(&[1.0, 1.0], &[0.0, 0.999], None).unwrap();
    assert!(close(&unusual, &[0.001, 0.999]), "{unusual:?}");
    let unusual_here = posterior(&[1.0, 1.0], &[0.5, 0.5], Some(&[0.0, 0.999])).unwrap();
    assert!(close(&unusual_here, &[0.001, 0.999]), "{unusual_here:?}");
    assert_eq!(posterior(&[1.0, 0.0], &[0.0, 1.0], None).unwrap(), [1.0, 0.0]);
}

#[test]
fn evidence_that_makes_no_sense_is_refused_by_name() {
    let refused = |likelihoods: &[f64], temporal: &[f64], spatial: Option<&[f64]>| {
        posterior(likelihoods, temporal, spatial).unwrap_err().to_string()
    };
    let even: &[f64] = &[0.5, 0.5];
    assert_eq!(refused(&[1.0], &[1.0], None), "1 labels, but there have to be 2 to 64");
    assert_eq!(refused(&[1.0; 65], &[1.0; 65], None), "65 labels, but there have to be 2 to 64");
    assert_eq!(refused(even, &[0.5], None), "the temporal prior has 1 values for 2 labels");
    assert_eq!(refused(even, even, Some(&[0.2; 3])), "the spatial prior has 3 values for 2 labels");
    let everywhere = "the likelihood of every label is 0, so that no label explains the observation";
    assert_eq!(refused(&[0.0, 0.0], even, None), everywhere);
    for wrong in [f64::NAN, f64::INFINITY, -0.1] {
        let likelihood = format!("the likelihood of label 1 is {wrong}, but has to be a finite number of at least 0");
        assert_eq!(refused(&[0.5, wrong], even, None), likelihood);
    }
    for wrong in [f64::NAN, -0.1, 1.1] {
        let temporal = format!("the temporal prior of label 0 is {wrong}, but has to be a probability, from 0 to 1");
        assert_eq!(refused(even, &[wrong, 0.5], None), temporal);
        let spatial = format!("the spatial prior of label 1 is {wrong}, but has to be a probability, from 0 to 1");
        assert_eq!(refused(even, even, Some(&[0.5, wrong])), spatial);
    }
}

#[test]
fn a_place_changes_the_labels_that_are_expected_once_something_was_observed_there() {
    const KITCHEN: usize = 0;
    const BEDROOM: usize = 1;
    let mut places = LabelPlaces::new(3, 3).unwrap();
    assert_eq!(places.prior(KITCHEN), None);
    for (label, place) in [(0, KITCHEN), (1, KITCHEN), (1, BEDROOM), (1, BEDROOM)] {
        places.add(label, place).unwrap();
    }
    // Two places have observations: (1 + 1) / (1 + 2), (1 + 1) / (3 + 2), and 1 / 2 for a label that was never
    // observed.
    assert_eq!(places.prior(KITCHEN), Some(vec![2.0 / 3.0, 0.4, 0.5]));
    assert_eq!(places.prior(BEDROOM), Some(vec![1.0 / 3.0, 0.6, 0.5]));
    assert_eq!((places.prior(2), places.prior(3)), (None, None));
}

#[test]
fn labels_and_places_that_do_not_exist_are_refused_and_not_counted() {
    let mut places = LabelPlaces::new(2, 1).unwrap();
    places.add(0, 0).unwrap();
    let before = places.clone();
    let refused = |error: Result<(), InvalidEvidence>| error.unwrap_err().to_string();
    assert_eq!(refused(places.add(2, 0)), "label 2 does not exist: there are 2, counted from 0");
    assert_eq!(refused(places.add(0, 1)), "place 1 does not exist: there are 1, counted from 0");
    assert_eq!(places, before);
    assert_eq!(LabelPlaces::new(1, 1), Err(InvalidEvidence::Labels { found: 1 }));
}

/// Likelihoods, a temporal and a spatial prior for the same number of labels.
fn evidence() -> impl Strategy<Value = (Vec<f64>, Vec<f64>, Option<Vec<f64>>)> {
    LABELS.prop_flat_map(|labels| {
        let values = || prop::collection::vec(prop_oneof![Just(0.0), 0.0..=1.0, 0.0..0.002], labels);
        let likelihoods = values().prop_map(|mut values| {
            values[0] += 0.01;
            values
        });
        (likelihoods, values(), prop::option::of(values()))
    })
}

proptest! {
    #[test]
    fn a_posterior_is_the_formula((likelihoods, temporal, spatial) in evidence()) {
        let found = posterior(&likelihoods, &temporal, spatial.as_deref()).unwrap();
        let expected = oracle(&likelihoods, &temporal, spatial.as_deref());
        prop_assert!(close(&found, &expected), "{found:?} {expected:?}");
        prop_assert!((found.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_priors_of_all_places_sum_to_1_for_each_label(
        observed in prop::collection::vec((0_usize..4, 0_usize..5), 1..100),
    ) {
        let mut places = LabelPlaces::new(4, 5).unwrap();
        for (label, place) in observed {
            places.add(label, place).unwrap();
        }
        let priors: Vec<Vec<f64>> = (0..5).filter_map(|place| places.prior(place)).collect();
        for label in 0..4 {
            let sum: f64 = priors.iter().map(|prior| prior[label]).sum();
            prop_assert!((sum - 1.0).abs() < 1e-12, "{priors:?}");
        }
    }

    #[test]
    fn the_scale_of_likelihoods_does_not_matter(
        (likelihoods, temporal, spatial) in evidence(),
        scale in prop_oneof![Just(1e-300), Just(1e300), 1e-3..1e3],
    ) {
        let scaled: Vec<f64> = likelihoods.iter().map(|likelihood| likelihood * scale).collect();
        let found = posterior(&scaled, &temporal, spatial.as_deref()).unwrap();
        let expected = oracle(&likelihoods, &temporal, spatial.as_deref());
        prop_assert!(close(&found, &expected), "{found:?} {expected:?}");
    }
}
