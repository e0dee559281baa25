//! Trainings that are stopped early, of every model whose training takes long.

use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;
use crate::{EarlyStop, Periodicities, StopSignal};

const HOUR_NANOS: i64 = 3_600 * NANOS_PER_SEC;

/// A reading an hour, high in working hours.
fn readings(count: i64) -> Vec<Sample> {
    let value = |hour: i64| f64::from(u8::from((8..18).contains(&(hour % 24)) && hour / 24 % 7 < 5));
    (0..count).map(|hour| Sample { utc_nanos: hour * HOUR_NANOS, offset_secs: 0, value: value(hour) }).collect()
}

/// Stops a training after several numbers of checks of the signal: each time it ends soon after, without a model.
fn is_stopped(name: &str, most_after: usize, train: impl Fn(StopSignal<'_>) -> Result<(), CannotTrain>) {
    let asked = AtomicUsize::new(0);
    let train_until = |after: usize| {
        asked.store(0, Ordering::Relaxed);
        let is_set = || asked.fetch_add(1, Ordering::Relaxed) >= after;
        train(StopSignal::new(&is_set))
    };
    assert_eq!(train_until(usize::MAX), Ok(()), "{name}");
    let questions = asked.load(Ordering::Relaxed);
    assert!(questions > 3, "{name}: {questions} questions");
    for after in [0, 1, questions / 3, questions / 2, questions - 1] {
        assert_eq!(train_until(after), Err(CannotTrain::Stop(EarlyStop)), "{name} after {after} of {questions}");
        let further = asked.load(Ordering::Relaxed) - after;
        assert!(further <= most_after, "{name}: {further} further questions after {after} of {questions}");
    }
}

fn until<'a>(samples: &'a [Sample], stop: StopSignal<'a>) -> Readings<'a> {
    Readings { stop, ..Readings::new(samples) }
}

#[test]
fn a_training_with_a_stop_signal_ends_soon_and_gives_no_model() {
    let samples = readings(21 * 24);
    for method in [HypertimeMethod::Em, HypertimeMethod::Km] {
        let options = HypertimeOptions { method, clusters: 3, seed: 0 };
        // The attempt under way ends: for each of its models there is one more round of clusters and a step.
        is_stopped("probability", 30, |stop| {
            Hypertime::train(until(&samples, stop), &Periodicities::default(), &options).map(drop)
        });
        is_stopped("value", 30, |stop| {
            Hypertime::train_continuous(until(&samples, stop), &Periodicities::default(), &options).map(drop)
        });
    }
    is_stopped("pergam", 8, |stop| Pergam::train(until(&samples, stop), &PergamOptions::default()).map(drop));
    is_stopped("persistence", 2, |stop| MarkovChain::train(until(&samples, stop)).map(drop));
    let periodicities = Periodicities::default();
    is_stopped("poisson", 6, |stop| CountRate::train(until(&samples, stop), &periodicities).map(drop));
    let many = readings(20_000);
    is_stopped("uniform", 1, |stop| UniformSpectral::train(until(&many, stop), 5).map(drop));
}
