//! Experiments without a daemon: models, explorers, searches and routes compared on recordings and in simulations.
//!
//! The crate's own modules compare temporal models of `tidemap-model` by a [`Protocol`], as `tidemap-research
//! compare` does. [`explore`], [`search`], [`routes`], [`tasks`], [`habits`], [`field`], [`activity`] and [`flows`] are
//! others; protocols end in .yaml or .yml, so that a new kind never conflicts with a file's name.
//!
//! - `protocol.rs`: YAML to [`Protocol`], checked before data is read; each list of parameters spans parameter sets;
//! - `data.rs`: files to readings by state, in portions of states that fit into memory; one invalid row stops it;
//! - `tuning.rs`: rolling origin on training data; the parameter set with the lowest mean error is chosen;
//! - `score.rs`: the chosen sets on the test sets: errors by test set and by local day;
//! - `newest.rs`: predictions by lead time, from the newest reading at that time;
//! - `paired.rs`: models in pairs: studentised bootstrap over days within test sets, fixed seed, corrected by Holm;
//! - `report.rs`: results.csv, pairs.csv, folds.csv, predictions.csv; `picture.rs`: comparison.svg.
//!
//! [`ComparedSettings`] is a model kind with all its parameters: one parameter set. Models are trained state by state,
//! with one choice of parameters for all states; readings of all states have the same weight. Nothing is tested
//! with fewer than five days more than test sets.
//!
//! Invariant: parameters are tuned on training data only, a test set is predicted from earlier data only (unless it is
//! a file of the training data, whose errors stay apart), and the same files give the same results for any number of
//! threads: jobs are independent and summed in order.

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;
use tidemap_model::{Evaluation, models::CannotTrain};

pub mod activity;
mod compared;
mod data;
pub mod explore;
pub mod field;
pub mod flows;
pub mod habits;
pub mod localise;
mod newest;
mod nightly_map;
mod paired;
mod picture;
mod place_recording;
mod protocol;
mod readings_in_memory;
mod report;
pub mod routes;
mod score;
pub mod search;
mod seed_mean;
mod seed_runs;
mod tally;
pub mod tasks;
mod tuning;

#[cfg(test)]
mod tests;

pub use protocol::{Ahead, Protocol, ProtocolError, read};
pub use report::{summary, write};

pub use compared::{ComparableKind, ComparedModel, ComparedSettings};
use data::{Data, DataError, DataPortions};
pub use paired::{Difference, PairedModels};
use protocol::Predictions;
use score::{DayErrors, TestScore};
use tuning::{Fold, Trial};

/// Why an experiment fails.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum ExperimentError {
    /// The data is invalid.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The predictions do not fit into memory.
    #[error(
        "predictions: the data has more than {max} readings, so that the states are read in portions, and predictions \
         cannot be sorted by time: write predictions: off"
    )]
    Predictions { max: usize },
    /// The folds do not fit the training data.
    #[error("tuning: the training data: {0}")]
    Folds(String),
    /// A model cannot be trained.
    #[error("model {model} cannot be trained on state {state:?}: {refused}")]
    CannotTrain { model: String, state: String, refused: CannotTrain },
}

impl ExperimentError {
    fn cannot_train(label: &str, set: &ComparedSettings, state: &str, refused: CannotTrain) -> Self {
        let model = match set.shown() {
            "" => label.to_owned(),
            shown => format!("{label} ({shown})"),
        };
        Self::CannotTrain { model, state: state.to_owned(), refused }
    }
}

/// The result of a model at one lead time.
#[derive(Clone, Debug)]
pub struct ModelResult {
    /// The name of the model in results.
    pub label: String,
    /// The lead time; none if the models answer without a newest reading.
    pub ahead: Option<Ahead>,
    /// The parameters of the model, as chosen.
    pub parameters: String,
    /// Errors of the model on the test days.
    pub score: TestScore,
    /// The difference to the baseline; none for the baseline itself.
    pub difference: Option<Difference>,
}

impl ModelResult {
    /// The outcome of the test: `better`, `worse` or `no difference`; `baseline` for the baseline, none without a test.
    pub fn verdict(&self, significance: f64) -> Option<&'static str> {
        let Some(difference) = self.difference else { return Some("baseline") };
        let test = difference.test?;
        Some(match difference.mean {
            _ if test.p_value > significance => "no difference",
            mean if mean < 0.0 => "better",
            _ => "worse",
        })
    }
}

/// The results of an experiment.
#[derive(Debug)]
pub struct Comparison {
    /// The results by lead time, then the models, both in the order of the protocol.
    pub models: Vec<ModelResult>,
    /// The folds on which parameters were tuned.
    pub folds: Vec<Fold>,
    /// The scores of every parameter set on the folds.
    pub trials: Vec<Trial<Evaluation>>,
    /// Every pair of models at the same lead time, by lead time, then in the order of the protocol.
    pub pairs: Vec<PairedModels>,
    /// The data; if it was read in several portions, the names of the states without their readings.
    pub data: Data,
}

/// Maximum number of readings that are held at once, 240 MB.
const READINGS_MAX: usize = 10_000_000;

/// Runs an experiment; `progress` receives the numbers of finished and of all jobs.
pub fn run(protocol: &Protocol, progress: &(impl Fn(u64, u64) + Sync)) -> Result<Comparison, ExperimentError> {
    run_in_portions(protocol, READINGS_MAX, progress)
}

/// Does the same as [`run`], but holds at most `readings_max` readings at once.
fn run_in_portions(
    protocol: &Protocol,
    readings_max: usize,
    progress: &(impl Fn(u64, u64) + Sync),
) -> Result<Comparison, ExperimentError> {
    let data = DataPortions::read(protocol, readings_max)?;
    if data.len() > 1 && protocol.predictions != Predictions::Off {
        return Err(ExperimentError::Predictions { max: readings_max });
    }
    let (models, kind) = (&protocol.models, protocol.kind);
    let folds = protocol.tuning.map(|tuning| tuning::folds(&data, tuning)).transpose()?.unwrap_or_default();
    // Without folds each model has a single parameter set.
    let sets = models.iter().enumerate().flat_map(tuning::sets_of).filter(|_| !folds.is_empty());
    let sets: Vec<(usize, usize)> = sets.collect();
    let trials_of_portion = sets.len() * folds.len();
    let total = (trials_of_portion * data.len() + models.len() * data.all.states.len()) as u64;
    let done = AtomicU64::new(0);
    let step = || progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);

    let mut errors = vec![Evaluation::default(); trials_of_portion];
    for portion in data.portions().take(if folds.is_empty() { 0 } else { usize::MAX }) {
        let portion = portion?;
        errors.par_iter_mut().enumerate().try_for_each(|(job, errors)| {
            let ((model, set), fold) = (sets[job / folds.len()], folds[job % folds.len()]);
            let entry = &models[model];
            tuning::add_fold_errors(errors, &portion, (&entry.label, &entry.sets[set]), fold, kind)?;
            step();
            Ok::<(), ExperimentError>(())
        })?;
    }
    tuning::check_folds(&folds, &errors)?;
    let trial = |model: usize, set: usize, fold: usize| {
        let place = sets.iter().position(|&known| known == (model, set)).unwrap_or_default();
        Ok::<Evaluation, ExperimentError>(errors[place * folds.len() + fold])
    };
    let trials = tuning::tune(sets.clone(), folds.len(), trial, Evaluation::mse)?;
    let models: Vec<(&str, &ComparedSettings)> = models
        .iter()
        .enumerate()
        .map(|(index, model)| (model.label.as_str(), &model.sets[tuning::chosen(&trials, index)]))
        .collect();
    let scores = score::score(&data, &models, protocol, &step)?;
    let (models, pairs) = compared(protocol, &models, scores);
    Ok(Comparison { models, folds, trials, pairs, data: data.all })
}

/// Compares scores, which come by lead time, then by model, at each lead time.
fn compared(
    protocol: &Protocol,
    models: &[(&str, &ComparedSettings)],
    scores: Vec<TestScore>,
) -> (Vec<ModelResult>, Vec<PairedModels>) {
    let (mut differences, mut pairs) = (Vec::with_capacity(scores.len()), Vec::new());
    for scores in scores.chunks(models.len().max(1)) {
        let days: Vec<&[DayErrors]> = scores.iter().map(|score| score.days.as_slice()).collect();
        let first = differences.len();
        let pair = |pair: PairedModels| PairedModels { model: first + pair.model, other: first + pair.other, ..pair };
        pairs.extend(paired::all_pairs(&days, protocol.significance).into_iter().map(pair));
        differences.extend(days.iter().enumerate().map(|(index, own)| {
            let baseline = days.get(protocol.baseline).filter(|_| index != protocol.baseline)?;
            Some(paired::difference(own, baseline, protocol.significance))
        }));
    }
    let lags = score::lags(protocol).into_iter();
    let rows = lags.flat_map(|ahead| models.iter().map(move |&(label, set)| (ahead, label, set)));
    let results = rows.zip(scores.into_iter().zip(differences)).map(|((ahead, label, set), (score, difference))| {
        ModelResult { label: label.to_owned(), ahead, parameters: set.shown().to_owned(), score, difference }
    });
    (results.collect(), pairs)
}
