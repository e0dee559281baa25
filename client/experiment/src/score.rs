//! Scores of the tuned models on the test sets.
//!
//! Invariant: the model that predicts a reading is trained on neither its test set nor a later one; all models have the
//! same days in the same order.

use std::collections::BTreeMap;

use rayon::prelude::*;
use tidemap_model::{Evaluation, LocalDay, Sample, StateKind};

use super::{
    ExperimentError,
    compared::ComparedSettings,
    data::{Data, DataPortions},
    protocol::Retrain,
};

/// The errors of one local day of a test set, all states together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DayErrors {
    /// Index of the test set.
    pub set: usize,
    /// The local day.
    pub day: LocalDay,
    /// The errors of its readings.
    pub errors: Evaluation,
}

/// The score of a model.
#[derive(Clone, Debug)]
pub struct TestScore {
    /// Errors of each test set.
    pub sets: Vec<Evaluation>,
    /// Errors of each day, by test set, then by date.
    pub days: Vec<DayErrors>,
    /// The predictions: by test set, by state, in the order of the readings; empty if there are several portions.
    pub predictions: Vec<Vec<Vec<f64>>>,
}

impl TestScore {
    /// The mean over test sets of their mean squared errors.
    pub fn mse(&self) -> f64 {
        mean(self.sets.iter().map(Evaluation::mse))
    }

    /// The mean over test sets of their shares of wrong predictions.
    pub fn error_rate(&self) -> f64 {
        mean(self.sets.iter().map(Evaluation::error_rate))
    }
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    values.sum::<f64>() / count
}

/// Trains each model and predicts all test sets, portion by portion.
pub(crate) fn score(
    portions: &DataPortions<'_>,
    models: &[(&str, &ComparedSettings)],
    retrain: Retrain,
    kind: StateKind,
    step: &(impl Fn() + Sync),
) -> Result<Vec<TestScore>, ExperimentError> {
    let mut tallies: Vec<Tally> = models.iter().map(|_| Tally::new(portions.all.tests.len())).collect();
    for data in portions.portions() {
        let data = data?;
        let jobs: Vec<(usize, usize)> =
            (0..models.len()).flat_map(|model| (0..data.states.len()).map(move |state| (model, state))).collect();
        let predictions = jobs
            .into_par_iter()
            .map(|(model, state)| {
                let (label, set) = models[model];
                let predictions = predict(&data, state, set, retrain, kind)
                    .map_err(|refused| ExperimentError::cannot_train(label, set, &data.states[state], refused));
                step();
                predictions
            })
            .collect::<Result<Vec<Vec<Vec<f64>>>, ExperimentError>>()?;
        for (tally, of_model) in tallies.iter_mut().zip(predictions.chunks(data.states.len())) {
            tally.add(&data, of_model, portions.len() == 1);
        }
    }
    Ok(tallies.into_iter().map(Tally::score).collect())
}

/// Predictions of one state, by test set.
fn predict(
    data: &Data,
    state: usize,
    set: &ComparedSettings,
    retrain: Retrain,
    kind: StateKind,
) -> Result<Vec<Vec<f64>>, tidemap_model::models::CannotTrain> {
    let mut known: Vec<Sample> = data.train[state].clone();
    let mut model = set.train(&known, kind)?;
    let mut predictions = Vec::with_capacity(data.tests.len());
    for (index, test) in data.tests.iter().enumerate() {
        let samples = &test.samples[state];
        predictions.push(samples.iter().map(|sample| model.predict(sample.moment())).collect());
        if retrain == Retrain::Each && index + 1 < data.tests.len() && !samples.is_empty() {
            known.extend_from_slice(samples);
            model = set.train(&known, kind)?;
        }
    }
    Ok(predictions)
}

/// The errors of one model so far, by test set.
#[derive(Debug)]
struct Tally {
    sets: Vec<Evaluation>,
    days: Vec<BTreeMap<LocalDay, Evaluation>>,
    predictions: Vec<Vec<Vec<f64>>>,
}

impl Tally {
    fn new(sets: usize) -> Self {
        Self { sets: vec![Evaluation::default(); sets], days: vec![BTreeMap::new(); sets], predictions: Vec::new() }
    }

    /// Adds a portion; `predictions` are by state, then by test set.
    fn add(&mut self, data: &Data, predictions: &[Vec<Vec<f64>>], keeps_predictions: bool) {
        for (set, test) in data.tests.iter().enumerate() {
            for (samples, predicted) in test.samples.iter().zip(predictions) {
                for (sample, &predicted) in samples.iter().zip(&predicted[set]) {
                    self.sets[set].add(predicted, sample.value);
                    self.days[set].entry(sample.local_day()).or_default().add(predicted, sample.value);
                }
            }
            if keeps_predictions {
                self.predictions.push(predictions.iter().map(|of_state| of_state[set].clone()).collect());
            }
        }
    }

    fn score(self) -> TestScore {
        let of_set = |(set, days): (usize, BTreeMap<LocalDay, Evaluation>)| {
            days.into_iter().map(move |(day, errors)| DayErrors { set, day, errors })
        };
        let days = self.days.into_iter().enumerate().flat_map(of_set).collect();
        TestScore { sets: self.sets, days, predictions: self.predictions }
    }
}
