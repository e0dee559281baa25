//! A well specified model rarely reports an anomaly, and always reports the planted ones.

use tidemap_model::{OrderCriterion, Periodicities, Sample, SpectralModel, selector::ModelKind};

use super::*;

const HOUR_NANOS: i64 = 3_600_000_000_000;

/// Uniform numbers in (0, 1) by a linear congruential generator (D. E. Knuth's MMIX constants).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let (a, b) = (self.next(), self.next());
        (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    }

    fn poisson(&mut self, mean: f64) -> f64 {
        let (mut product, mut count) = (self.next(), 0.0);
        while product > (-mean).exp() {
            product *= self.next();
            count += 1.0;
        }
        count
    }
}

/// The true expected value: a rhythm of a day, 6 at night and 30 by day.
fn truth(utc_nanos: i64) -> f64 {
    18.0 - 12.0 * (std::f64::consts::TAU * utc_nanos as f64 / (24.0 * HOUR_NANOS as f64)).cos()
}

fn value(kind: StateKind, random: &mut Random, utc_nanos: i64) -> f64 {
    let expected = truth(utc_nanos);
    if kind == StateKind::Count { random.poisson(expected) } else { expected + 2.0 * random.normal() }
}

fn samples(kind: StateKind, random: &mut Random, slots: std::ops::Range<i64>) -> Vec<Sample> {
    let at = slots.map(|slot| slot * HOUR_NANOS / 6);
    at.map(|utc_nanos| Sample { utc_nanos, offset_secs: 0, value: value(kind, random, utc_nanos) }).collect()
}

fn learned(kind: StateKind, periodicities: &Periodicities, random: &mut Random, days: i64) -> StateModel {
    let mut model = StateModel::of_kind(kind);
    for day in 0..days {
        model.update(periodicities, OrderCriterion::SquaredError, samples(kind, random, 144 * day..144 * (day + 1)));
    }
    model
}

fn selector(kind: ModelKind) -> ModelSelector {
    ModelSelector { kind, ..ModelSelector::default() }
}

#[test]
fn about_one_in_a_hundred_at_a_confidence_of_99_percent_and_every_planted_one() {
    let periodicities = Periodicities::harmonics(24 * HOUR_NANOS, 24).expect("valid");
    for kind in [StateKind::Continuous, StateKind::Count] {
        let mut random = Random(7);
        let model = learned(kind, &periodicities, &mut random, 42);
        let expect = |sample: &Sample, order| {
            let spectral: &SpectralModel = model.spectral();
            spectral.predict_value(kind, &periodicities, order, sample.civil_nanos())
        };
        let order = model.order().max(1);
        let judge = |name: ModelSelector| ValueJudge::new(&model, name).expect("enough was learned");
        let spectral = judge(ModelSelector { order: Some(order), ..selector(ModelKind::Spectral) });
        let mean = judge(selector(ModelKind::Mean));
        let fresh = samples(kind, &mut random, 144 * 42..144 * 112);
        let share = |judge: &ValueJudge, order: usize, confidence: f64| {
            let tails = fresh.iter().map(|sample| judge.tail(sample.value, expect(sample, order), sample.moment()));
            tails.filter(|&tail| tail <= 1.0 - confidence).count() as f64 / fresh.len() as f64
        };
        println!(
            "{kind:?}: {} {} {}",
            share(&spectral, order, 0.99),
            share(&spectral, order, 0.9),
            share(&mean, 0, 0.99)
        );
        assert!(share(&spectral, order, 0.99) < 0.013, "{kind:?}: {}", share(&spectral, order, 0.99));
        // The interval is also not wider than necessary.
        assert!((0.05..0.12).contains(&share(&spectral, order, 0.9)), "{kind:?}: {}", share(&spectral, order, 0.9));
        assert!(share(&mean, 0, 0.99) < 0.013, "{kind:?}");
        // A value that is usual by day is planted at night; by the mean alone it is not unusual.
        for sample in fresh.iter().step_by(144) {
            let planted = spectral.tail(30.0, expect(sample, order), sample.moment());
            assert!(planted < 1e-6, "{kind:?}: {planted}");
            assert!(mean.tail(30.0, expect(sample, 0), sample.moment()) > 0.01);
        }
    }
}

#[test]
fn of_little_nothing_is_an_anomaly() {
    let periodicities = Periodicities::harmonics(24 * HOUR_NANOS, 24).expect("valid");
    let auto = ModelSelector::default();
    for kind in [StateKind::Continuous, StateKind::Count] {
        let mut model = StateModel::of_kind(kind);
        assert!(ValueJudge::new(&model, auto).is_none());
        model.update(&periodicities, OrderCriterion::SquaredError, samples(kind, &mut Random(1), 0..29));
        assert!(ValueJudge::new(&model, auto).is_none());
        model.update(&periodicities, OrderCriterion::SquaredError, samples(kind, &mut Random(1), 29..31));
        assert!(ValueJudge::new(&model, auto).is_some());
    }
    let door = StateModel::of_kind(StateKind::Probability);
    assert!(ValueJudge::new(&door, auto).is_none(), "of probabilities there is a contrary");
}

#[test]
fn a_state_that_never_varied_is_surprised_by_what_differs_alone() {
    let periodicities = Periodicities::default();
    for (kind, usual) in [(StateKind::Continuous, -3.25), (StateKind::Continuous, 0.0), (StateKind::Count, 0.0)] {
        let mut model = StateModel::of_kind(kind);
        let at = |slot: i64| Sample { utc_nanos: slot * HOUR_NANOS / 6, offset_secs: 0, value: usual };
        for day in 0..14 {
            let of_day = (144 * day..144 * (day + 1)).map(at).collect();
            model.update(&periodicities, OrderCriterion::SquaredError, of_day);
        }
        let judge = ValueJudge::new(&model, ModelSelector::default()).expect("enough");
        let expected = model.spectral().predict_value(kind, &periodicities, 0, 0);
        let moment = at(5000).moment();
        assert!(judge.tail(usual, expected, moment) > 0.5, "{kind:?} {usual}");
        assert!(judge.tail(usual + 1.0, expected, moment) < 0.01, "{kind:?} {usual}");
    }
}
