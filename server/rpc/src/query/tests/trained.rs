//! Tests of models that are trained on request: their readings, shared trainings, and errors.

use tidemap_model::{
    Sample,
    models::{Calibrated, CalibratedOptions, Histogram, HistogramCycle, HistogramSettings, Readings, TemporalModel},
    selector::{Blend, ModelKind, ModelSelector},
};
use tidemap_proto::convert::{query::selector_to_wire, time::timestamp};

use super::*;

const HOUR: i64 = 60 * MINUTE;
const HISTOGRAM: ModelKind = ModelKind::Histogram { cycle: HistogramCycle::Day, bins: 24 };
/// Models of probabilities that need readings.
const KINDS: [ModelKind; 7] = [
    ModelKind::Persistence,
    HISTOGRAM,
    ModelKind::Pergam { gaussians: 2, period_nanos: 24 * HOUR },
    ModelKind::Uniform,
    ModelKind::HypertimeEm { clusters: 1 },
    ModelKind::HypertimeKm { clusters: 1 },
    ModelKind::Calibrated,
];

/// A reading every hour from noon on: 1 for the first six hours of each twelve, but on every fifth day.
fn door(hours: std::ops::Range<i64>) -> Vec<(i64, f64)> {
    hours.map(|i| (NOON + i * HOUR, f64::from(u8::from(i % 12 < 6 && i / 24 % 5 != 4)))).collect()
}

fn wire(kind: ModelKind, persistence: bool) -> Option<v1::ModelSelector> {
    let blend = if persistence { Blend::Persistence } else { Blend::None };
    Some(selector_to_wire(ModelSelector { kind, order: None, blend }))
}

impl Bench {
    async fn ask(&self, kind: ModelKind, times: &[i64]) -> Result<Vec<f64>, Status> {
        let replies = self.predict(&["door"], times, wire(kind, false)).await?;
        assert!(replies.iter().all(|reply| reply.order == 0 || kind == ModelKind::Uniform), "{kind}");
        Ok(replies.into_iter().flat_map(|reply| reply.probabilities).collect())
    }
}

/// The predictions of a model that was trained on these readings alone.
fn expected(bench: &Bench, readings: &[(i64, f64)], times: &[i64]) -> [Vec<f64>; 2] {
    let view = bench.handle.view();
    let mut make = view.sample_maker();
    let samples: Vec<Sample> = readings.iter().map(|&(nanos, value)| make(nanos, value)).collect();
    let readings = Readings::new(&samples);
    let histogram = Histogram::train(readings, &HistogramSettings::new(HistogramCycle::Day, 24)).expect("readings");
    let calibrated = Calibrated::train(readings, CalibratedOptions::default()).expect("readings");
    let models: [&dyn TemporalModel; 2] = [&histogram, &calibrated];
    models.map(|model| view.moments(times).into_iter().map(|moment| model.predict(moment)).collect())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_model_is_trained_on_what_updates_have_folded_in_wherever_that_is() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bench = Bench::new(dir.path(), Retention::Forever, None).await;
    let times: Vec<i64> = (0..30).map(|i| NOON + 2000 * HOUR + i * 37 * MINUTE).collect();
    let mut robot = bench.robot("r").await;
    let mut before = Vec::new();
    for part in 0..3 {
        let hours = part * 200..(part + 1) * 200;
        let known = door(0..hours.start);
        robot.observe(&bench, &door(hours.clone())).await;
        if part > 0 {
            // Pending observations make no difference.
            let models = [bench.ask(HISTOGRAM, &times).await, bench.ask(ModelKind::Calibrated, &times).await];
            let found = models.map(|found| found.expect("an answer"));
            assert_eq!(found, expected(&bench, &known, &times), "after {} hours", hours.start);
            before = found.to_vec();
        }
        // The request comes just before, during or just after the update learns the rest: the answer is one or the
        // other, never a mixture.
        let (found, ()) = tokio::join!(bench.ask(HISTOGRAM, &times), bench.update());
        let after = expected(&bench, &door(0..hours.end), &times);
        let found = found.expect("an answer");
        let unlearned = part == 0 && found.iter().all(|&p| p == 0.5);
        assert!(unlearned || before.first() == Some(&found) || found == after[0], "{found:?}");
        assert_ne!(before, after.to_vec());
        if part == 1 {
            // The readings come from files from now on, and the predictions are equal to the last bit.
            bench = bench.again(dir.path()).await;
            robot = bench.robot("r2").await;
            let models = [bench.ask(HISTOGRAM, &times).await, bench.ask(ModelKind::Calibrated, &times).await];
            assert_eq!(models.map(|found| found.expect("an answer")), after);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_kind_answers_and_as_often_as_it_is_asked() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = Bench::new(dir.path(), Retention::Forever, None).await;
    bench.robot("r").await.observe(&bench, &door(0..500)).await;
    bench.update().await;
    let times: Vec<i64> = (0..50).map(|i| NOON + 499 * HOUR + i * 37 * MINUTE).collect();
    for kind in KINDS {
        let (one, two, three) = tokio::join!(bench.ask(kind, &times), bench.ask(kind, &times), bench.ask(kind, &times));
        let one = one.expect("an answer");
        assert_eq!((two.expect("an answer"), three.expect("an answer")), (one.clone(), one.clone()), "{kind}");
        assert!(one.iter().all(|p| (0.0..=1.0).contains(p)), "{kind}: {one:?}");
        assert!(one.iter().any(|p| *p != one[0]), "{kind} predicts the same at all times");
        // T-RO eq. 13: with persistence it is the last value at the time of the last observation.
        let blended = bench.predict(&["door"], &times, wire(kind, true)).await.expect("an answer");
        assert_eq!(blended[0].probabilities[0], door(499..500)[0].1, "{kind}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn persistence_starts_from_the_newest_value_and_learns_nothing_from_it() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = Bench::new(dir.path(), Retention::Forever, None).await;
    let mut robot = bench.robot("r").await;
    robot.observe(&bench, &door(0..500)).await;
    bench.update().await;
    let late = NOON + 100_000 * HOUR;
    let newest = NOON + 600 * HOUR;
    let before = bench.ask(ModelKind::Persistence, &[newest, late]).await.expect("an answer");
    robot.observe(&bench, &[(newest, 1.0)]).await;
    let after = bench.ask(ModelKind::Persistence, &[newest, late]).await.expect("an answer");
    assert_eq!(after[0], 1.0);
    assert!(before[0] < 0.9, "{before:?}");
    assert_eq!(after[1], before[1]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_state_of_which_nothing_was_learned_answers_as_with_every_model() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = Bench::new(dir.path(), Retention::Forever, None).await;
    bench.robot("r").await.observe(&bench, &door(0..5)).await;
    for kind in KINDS {
        assert_eq!(bench.ask(kind, &[NOON, NOON + HOUR]).await.expect("an answer"), [0.5, 0.5], "{kind}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_model_cannot_be_trained_on_is_reported() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = Bench::new(dir.path(), Retention::None, Some(Retention::Forever)).await;
    bench.robot("r").await.observe(&bench, &door(0..5)).await;
    bench.robot("s").await.show(&bench, &minutes(5)).await;
    for updated in [false, true] {
        if updated {
            bench.update().await;
        }
        for kind in KINDS {
            let words = [&*kind.to_string(), "\"door\"", "\"office\"", "keeps none", "retention \"none\""];
            check_refused(bench.ask(kind, &[NOON]).await, Code::FailedPrecondition, &words);
            let words = [&*kind.to_string(), "cells", "auto, mean, latest or spectral"];
            let model = wire(kind, false);
            let time = Some(timestamp(NOON));
            let of_grid = bench.grid(v1::PredictGridRequest { time, model, ..Default::default() }).await;
            check_refused(of_grid, Code::InvalidArgument, &words);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_model_has_its_limits() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bench = Bench::new(dir.path(), Retention::Forever, None).await;
    bench.robot("r").await.observe(&bench, &door(0..100)).await;
    bench.update().await;
    check_refused(bench.ask(ModelKind::Poisson, &[NOON]).await, Code::FailedPrecondition, &["poisson", "counts"]);
    let with = |readings| {
        let limits = QueryLimits { predictions: 10_000, batch: 4096, trained_models: 100, training_readings: readings };
        Queries::new(bench.queries.catalog.clone(), limits, shares())
    };
    let (few, enough) = (with(99), with(100));
    bench.queries = few;
    let words = ["histogram:24", "100 observations", "max_training_readings", "99"];
    check_refused(bench.ask(HISTOGRAM, &[NOON]).await, Code::ResourceExhausted, &words);
    bench.queries = enough;
    assert!(bench.ask(HISTOGRAM, &[NOON]).await.is_ok());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_model_is_trained_on_what_is_still_kept() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bench = Bench::new(dir.path(), Retention::Duration(100 * HOUR), None).await;
    bench.robot("r").await.observe(&bench, &door(0..100)).await;
    bench.update().await;
    bench = bench.again(dir.path()).await;
    bench.robot("r2").await.observe(&bench, &door(1000..1050)).await;
    bench.update().await;
    bench = bench.again(dir.path()).await;
    let times = [NOON + 2000 * HOUR, NOON + 2007 * HOUR];
    let found = bench.ask(HISTOGRAM, &times).await.expect("an answer");
    assert_eq!(found, expected(&bench, &door(1000..1050), &times)[0]);
    assert_ne!(found, expected(&bench, &[door(0..100), door(1000..1050)].concat(), &times)[0]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cell_has_the_models_of_a_state_that_does_the_same() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bench = Bench::new(dir.path(), Retention::Forever, Some(Retention::Forever)).await;
    let door: Vec<(i64, f64)> = (0..240).map(|i| (NOON + i * MINUTE, (i / 60 % 2) as f64)).collect();
    bench.robot("r").await.observe(&bench, &door).await;
    bench.robot("s").await.show(&bench, &minutes(240)).await;
    let times: Vec<i64> = (0..50).map(|i| NOON + 240 * MINUTE + i * 7 * MINUTE).collect();
    let names = ["door", "cell/2/0/0"];
    for kind in KINDS {
        let unlearned = bench.predict(&names, &times, wire(kind, false)).await.expect("an answer");
        assert!(unlearned.iter().all(|run| run.probabilities == [0.5; 50]), "{kind}");
    }
    bench.update().await;
    // The readings come from memory, then from files.
    for restarted in [false, true] {
        if restarted {
            bench = bench.again(dir.path()).await;
        }
        for kind in KINDS {
            for persistence in [false, true] {
                let runs = bench.predict(&names, &times, wire(kind, persistence)).await.expect("an answer");
                // The error of a cell's persistence is that of its 32 bits.
                let far = if persistence { 1e-4 } else { 0.0 };
                let apart = runs[0].probabilities.iter().zip(&runs[1].probabilities).map(|(a, b)| (a - b).abs());
                assert!(apart.fold(0.0, f64::max) <= far, "{kind} {persistence}: {runs:?}");
            }
        }
        let wall = bench.predict(&["cell/1/0/0"], &times, wire(HISTOGRAM, false)).await.expect("an answer");
        assert!(wall[0].probabilities.iter().all(|&p| p > 0.9), "{wall:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cell_whose_readings_are_not_kept_has_no_trained_model() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = Bench::new(dir.path(), Retention::Forever, Some(Retention::None)).await;
    bench.robot("s").await.show(&bench, &minutes(5)).await;
    bench.update().await;
    for kind in KINDS {
        let words = [&*kind.to_string(), "\"cell/1/0/0\"", "keeps none", "grid retention \"none\""];
        let found = bench.predict(&["cell/1/0/0"], &[NOON], wire(kind, false)).await;
        check_refused(found, Code::FailedPrecondition, &words);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn replies_come_by_state_and_then_by_time() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = Bench::new(dir.path(), Retention::Forever, None).await;
    bench.robot("r").await.observe(&bench, &door(0..100)).await;
    bench.update().await;
    let times: Vec<i64> = (0..5000).map(|i| NOON + i * MINUTE).collect();
    for kind in [ModelKind::Auto, HISTOGRAM] {
        let replies = bench.predict(&["door", "door"], &times, wire(kind, false)).await.expect("an answer");
        let runs: Vec<_> =
            replies.iter().map(|run| (run.state_index, run.first_time_index, run.probabilities.len())).collect();
        assert_eq!(runs, [(0, 0, 4096), (0, 4096, 904), (1, 0, 4096), (1, 4096, 904)], "{kind}");
        assert_eq!(replies[0].probabilities, replies[2].probabilities);
        let last = bench.predict(&["door"], &times[4999..], wire(kind, false)).await.expect("an answer");
        assert_eq!(last[0].probabilities[0], replies[3].probabilities[903], "{kind}");
    }
}
