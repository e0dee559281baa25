//! Compares the anomalies with the definition in words.

use proptest::prelude::*;

use super::*;

fn confidence(c: f64) -> Confidence {
    Confidence::new(c).expect("valid")
}

#[test]
fn a_confidence_is_above_one_half_and_at_most_one() {
    for wrong in [0.3, 0.5, 1.000_000_1, -1.0, f64::NAN, f64::INFINITY] {
        let error = Confidence::new(wrong).expect_err("no confidence");
        assert!(error.to_string().contains("above 0.5 and at most 1"), "{error}");
    }
    assert_eq!(confidence(1.0).get(), 1.0);
    assert_eq!(Confidence::default(), confidence(0.99));
}

#[test]
fn the_thresholds_are_included_on_both_sides() {
    // Binary fractions represent these numbers exactly.
    let c = confidence(0.75);
    for (value, probability, expected) in [
        (0.0, 0.75, true),
        (0.0, 0.749, false),
        (1.0, 0.25, true),
        (1.0, 0.251, false),
        (1.0, 1.0, false),
        (0.0, 0.0, false),
        // A value counts as the nearer of 0 and 1, and one half counts as 1.
        (0.49, 1.0, true),
        (0.5, 1.0, false),
        (0.5, 0.0, true),
    ] {
        assert_eq!(is_anomalous(value, probability, c), expected, "{value} where p = {probability}");
    }
    // Certainty can be contradicted, and only certainty.
    for (value, probability, expected) in [(0.0, 1.0, true), (1.0, 0.0, true), (0.0, 0.999, false), (1.0, 0.001, false)]
    {
        assert_eq!(is_anomalous(value, probability, confidence(1.0)), expected);
    }
}

#[test]
fn models_that_answer_from_the_newest_value_judge_nothing() {
    let select = |kind| ModelSelector { kind, ..ModelSelector::default() };
    for kind in [ModelKind::Auto, ModelKind::Mean, ModelKind::Spectral] {
        assert_eq!((can_judge(select(kind)), can_watch(select(kind))), (Ok(()), Ok(())));
        let blended = ModelSelector { blend: Blend::Persistence, ..select(kind) };
        assert_eq!((can_judge(blended), can_watch(blended)).0, Err(CannotJudge::Blended(Blend::Persistence)));
    }
    for kind in [ModelKind::Latest, ModelKind::Persistence] {
        assert_eq!(can_judge(select(kind)), Err(CannotJudge::Newest(kind)));
        assert_eq!(can_watch(select(kind)), Err(CannotJudge::Newest(kind)));
    }
    for kind in [ModelKind::Calibrated, ModelKind::PERGAM, ModelKind::Uniform] {
        assert_eq!((can_judge(select(kind)), can_watch(select(kind))), (Ok(()), Err(CannotJudge::NeedsTraining(kind))));
    }
}

fn is_at_a_threshold(p: f64, c: f64) -> bool {
    (p - c).abs() < 1e-12 || (p - (1.0 - c)).abs() < 1e-12
}

/// Probabilities that often are 0, 1 or one half.
fn probabilities() -> impl Strategy<Value = f64> {
    prop_oneof![Just(0.0), Just(0.5), Just(1.0), 0.0..=1.0]
}

proptest! {
    #[test]
    fn it_is_the_paper_word_for_word(value in prop_oneof![Just(0.0), Just(1.0)], p in probabilities(), c in 0.501..1.0) {
        // The definition is s_m < s'(c) or s_m > s'(1 - c), except for p at the threshold itself.
        prop_assume!(!is_at_a_threshold(p, c));
        let predicted = |threshold: f64| if p >= threshold { 1.0 } else { 0.0 };
        let paper = value < predicted(c) || value > predicted(1.0 - c);
        prop_assert_eq!(is_anomalous(value, p, confidence(c)), paper);
    }

    #[test]
    fn occupied_and_free_are_alike(free in any::<bool>(), p in probabilities(), c in 0.501..=1.0) {
        prop_assume!(!is_at_a_threshold(p, c));
        let value = f64::from(u8::from(free));
        prop_assert_eq!(is_anomalous(value, p, confidence(c)), is_anomalous(1.0 - value, 1.0 - p, confidence(c)));
    }

    #[test]
    fn more_confidence_finds_no_more_and_one_half_finds_nothing(
        value in 0.0..=1.0,
        p in probabilities(),
        (low, high) in (0.501..=1.0, 0.501..=1.0).prop_map(|(a, b): (f64, f64)| (a.min(b), a.max(b))),
    ) {
        if is_anomalous(value, p, confidence(high)) {
            prop_assert!(is_anomalous(value, p, confidence(low)));
            prop_assert!((value < 0.5) == (p > 0.5), "it is the other side of one half");
        }
        prop_assert!(!is_anomalous(value, 0.5, confidence(low)));
    }

    #[test]
    fn anomalies_are_those_readings_and_keep_their_order(
        judged in prop::collection::vec((0_i64..1000, probabilities(), probabilities()), 0..50),
        c in 0.501..=1.0,
    ) {
        let (readings, predicted): (Vec<Reading>, Vec<f64>) =
            judged.iter().map(|&(time, value, p)| ((time, value), p)).unzip();
        let found: Vec<Anomaly> = anomalies(&readings, &predicted, confidence(c)).collect();
        let mut naive = Vec::new();
        for &(utc_nanos, value, probability) in &judged {
            let predicts_one = probability >= c;
            let predicts_zero = probability <= 1.0 - c;
            if predicts_one && value < 0.5 || predicts_zero && value >= 0.5 {
                naive.push(Anomaly { utc_nanos, value, probability });
            }
        }
        prop_assert_eq!(found, naive);
    }
}
