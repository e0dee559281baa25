//! Scores of the tuned models on the test sets.
//!
//! Invariant: the model that predicts a reading is trained on neither its test set nor a later one, unless the test set
//! is a file of the training data, which has errors of its own and no days to compare; all models have the same days in
//! the same order.

use std::collections::BTreeMap;

use rayon::prelude::*;
use tidemap_model::{Evaluation, LocalDay, Sample, models::TemporalModel as _};

use super::{
    ExperimentError,
    compared::{ComparedModel, ComparedSettings},
    data::{Data, DataPortions, TestSet},
    newest::KnownReadings,
    protocol::{Ahead, Predictions, Protocol, Retrain},
};

/// Least probability of an observed value in log losses, so that one surprise does not outweigh all else.
pub(crate) const PROBABILITY_MIN: f64 = 1e-3;

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

/// The errors of a model on one test set.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SetErrors {
    /// Squared errors and wrong predictions.
    pub errors: Evaluation,
    /// Sum of -ln of the predicted probability of the observed value, for probabilities; each at least 0.001.
    pub log_loss_sum: f64,
    /// Whether the model has learned the set.
    pub is_learned: bool,
}

impl SetErrors {
    /// The mean log loss, in nats; 0 without observations.
    pub fn log_loss(&self) -> f64 {
        self.log_loss_sum / self.errors.observations.max(1) as f64
    }

    fn add(&mut self, predicted: f64, value: f64) {
        self.errors.add(predicted, value);
        self.log_loss_sum += log_loss(predicted, value);
    }
}

/// -ln of the predicted probability of an observed value, nats.
pub(crate) fn log_loss(predicted: f64, value: f64) -> f64 {
    let p = predicted.clamp(PROBABILITY_MIN, 1.0 - PROBABILITY_MIN);
    -(value * p.ln() + (1.0 - value) * (1.0 - p).ln())
}

/// The score of a model at one lead time.
#[derive(Clone, Debug)]
pub struct TestScore {
    /// Errors of each test set.
    pub sets: Vec<SetErrors>,
    /// Errors of each day of the test sets that were not learned, by test set, then by date.
    pub days: Vec<DayErrors>,
    /// The predictions: by test set, by state, in the order of the readings; empty if they are not written.
    pub predictions: Vec<Vec<Vec<f64>>>,
}

impl TestScore {
    /// Whether a test set was not learned.
    pub fn has_unseen(&self) -> bool {
        self.sets.iter().any(|set| !set.is_learned)
    }

    /// The mean over test sets of their mean squared errors: over the sets that were not learned, if there are any.
    pub fn mse(&self) -> f64 {
        self.mean(|set| set.errors.mse())
    }

    /// The mean of the test sets' shares of wrong predictions, over the same sets as [`TestScore::mse`].
    pub fn error_rate(&self) -> f64 {
        self.mean(|set| set.errors.error_rate())
    }

    /// The mean of the test sets' log losses in nats, over the same sets as [`TestScore::mse`].
    pub fn log_loss(&self) -> f64 {
        self.mean(SetErrors::log_loss)
    }

    fn mean(&self, error: impl Fn(&SetErrors) -> f64) -> f64 {
        let is_scored = |set: &&SetErrors| !set.is_learned || !self.has_unseen();
        let errors: Vec<f64> = self.sets.iter().filter(is_scored).map(error).collect();
        errors.iter().sum::<f64>() / errors.len().max(1) as f64
    }
}

/// The lead times of a protocol; a single `None` if it has none, and models answer as they were trained.
pub(crate) fn lags(protocol: &Protocol) -> Vec<Option<Ahead>> {
    match &protocol.ahead[..] {
        [] => vec![None],
        lags => lags.iter().copied().map(Some).collect(),
    }
}

/// Trains each model and predicts all test sets, portion by portion. The scores come by lead time, then by model.
pub(crate) fn score(
    portions: &DataPortions<'_>,
    models: &[(&str, &ComparedSettings)],
    protocol: &Protocol,
    step: &(impl Fn() + Sync),
) -> Result<Vec<TestScore>, ExperimentError> {
    let lags = lags(protocol);
    let keeps_predictions = portions.len() == 1 && protocol.predictions != Predictions::Off;
    let mut tallies: Vec<Tally> = (0..lags.len() * models.len()).map(|_| Tally::new(&portions.all.tests)).collect();
    for data in portions.portions() {
        let data = data?;
        let jobs: Vec<(usize, usize)> =
            (0..models.len()).flat_map(|model| (0..data.states.len()).map(move |state| (model, state))).collect();
        let predictions = jobs
            .into_par_iter()
            .map(|(model, state)| {
                let (label, set) = models[model];
                let predictions = predict(&data, state, set, protocol, &lags)
                    .map_err(|refused| ExperimentError::cannot_train(label, set, &data.states[state], refused));
                step();
                predictions
            })
            .collect::<Result<Vec<Vec<PredictedSets>>, ExperimentError>>()?;
        for (model, of_model) in predictions.chunks(data.states.len().max(1)).enumerate() {
            for lag in 0..lags.len() {
                let of_lag: Vec<&PredictedSets> = of_model.iter().map(|of_state| &of_state[lag]).collect();
                tallies[lag * models.len() + model].add(&data, &of_lag, keeps_predictions);
            }
        }
    }
    Ok(tallies.into_iter().map(Tally::score).collect())
}

/// Predictions of one state, by test set.
type PredictedSets = Vec<Vec<f64>>;

/// Predictions of one state, by lead time.
fn predict(
    data: &Data,
    state: usize,
    set: &ComparedSettings,
    protocol: &Protocol,
    lags: &[Option<Ahead>],
) -> Result<Vec<PredictedSets>, tidemap_model::models::CannotTrain> {
    let mut trained: Vec<Sample> = data.train[state].clone();
    let mut model: ComparedModel = set.train(&trained, protocol.kind)?;
    let unseen = || data.tests.iter().filter(|test| !test.is_learned);
    let known = lags.iter().any(Option::is_some).then(|| {
        let readings = unseen().map(|test| test.samples[state].as_slice());
        KnownReadings::new(&data.train[state], readings, protocol.kind)
    });
    let mut predictions: Vec<PredictedSets> = vec![Vec::with_capacity(data.tests.len()); lags.len()];
    for (index, test) in data.tests.iter().enumerate() {
        let samples = &test.samples[state];
        let plain: Vec<f64> = samples.iter().map(|sample| model.predict(sample.moment())).collect();
        for (lag, predictions) in lags.iter().zip(&mut predictions) {
            predictions.push(match (lag, &known) {
                (Some(ahead), Some(known)) => known.predict((set, &model), samples, &plain, *ahead),
                _ => plain.clone(),
            });
        }
        let is_learned_later = !test.is_learned && index + 1 < data.tests.len() && !samples.is_empty();
        if protocol.retrain == Retrain::Each && is_learned_later {
            trained.extend_from_slice(samples);
            model = set.train(&trained, protocol.kind)?;
        }
    }
    Ok(predictions)
}

/// The errors of one model at one lead time so far, by test set.
#[derive(Debug)]
struct Tally {
    sets: Vec<SetErrors>,
    days: Vec<BTreeMap<LocalDay, Evaluation>>,
    predictions: Vec<Vec<Vec<f64>>>,
}

impl Tally {
    fn new(tests: &[TestSet]) -> Self {
        let set = |test: &TestSet| SetErrors { is_learned: test.is_learned, ..SetErrors::default() };
        Self {
            sets: tests.iter().map(set).collect(),
            days: vec![BTreeMap::new(); tests.len()],
            predictions: Vec::new(),
        }
    }

    /// Adds a portion; `predictions` are by state, then by test set.
    fn add(&mut self, data: &Data, predictions: &[&PredictedSets], keeps_predictions: bool) {
        for (set, test) in data.tests.iter().enumerate() {
            for (samples, predicted) in test.samples.iter().zip(predictions) {
                for (sample, &predicted) in samples.iter().zip(&predicted[set]) {
                    self.sets[set].add(predicted, sample.value);
                    if !test.is_learned {
                        self.days[set].entry(sample.local_day()).or_default().add(predicted, sample.value);
                    }
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
