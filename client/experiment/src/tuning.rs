//! Choosing parameters by rolling origin, on training data alone.
//!
//! The last folds of the training data are predicted one after another, each by models fitted to all that is before it; of
//! the candidates the one with the lowest mean error over the folds is taken (L. Tashman, "Out-of-sample tests of
//! forecasting accuracy", IJF 2000). Invariant: nothing here sees a test set; every candidate is scored on the same
//! readings.

use rayon::prelude::*;
use tidemap_map::time::{format_duration, format_rfc3339};
use tidemap_model::{Evaluation, Sample};

use super::{
    ExperimentError,
    data::Data,
    parameter_set::{ParameterSet, ValueKind},
    protocol::{ModelEntry, Tuning},
};

/// A stretch of the training data that is predicted from what is before it: after `from`, up to and with `until`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fold {
    /// Readings up to here are learned: UTC, nanoseconds since 1970.
    pub from_nanos: i64,
    /// The last time of the fold.
    pub until_nanos: i64,
}

/// How one candidate did.
#[derive(Clone, Debug)]
pub struct Trial {
    /// Index of the model.
    pub model: usize,
    /// Index of the candidate among the model's.
    pub candidate: usize,
    /// Its errors, fold by fold.
    pub folds: Vec<Evaluation>,
    /// Whether it was chosen.
    pub chosen: bool,
}

impl Trial {
    /// The mean over folds of the mean squared error.
    pub fn error(&self) -> f64 {
        self.folds.iter().map(Evaluation::mse).sum::<f64>() / self.folds.len().max(1) as f64
    }
}

/// The folds, which end with the training data.
pub fn folds(data: &Data, tuning: Tuning) -> Result<Vec<Fold>, ExperimentError> {
    let Some((first, last)) = data.train_extent() else {
        return Err(ExperimentError::Folds("there is none".to_owned()));
    };
    let starts_before = |folds_behind: usize| {
        let behind = i64::try_from(folds_behind).ok().and_then(|count| tuning.fold_nanos.checked_mul(count));
        behind.and_then(|behind| last.checked_sub(behind)).unwrap_or(i64::MIN)
    };
    let folds: Vec<Fold> = (0..tuning.folds)
        .rev()
        .map(|behind| Fold { from_nanos: starts_before(behind + 1), until_nanos: starts_before(behind) })
        .collect();
    let fold_length = format_duration(tuning.fold_nanos);
    if folds.first().is_none_or(|fold| fold.from_nanos < first) {
        return Err(ExperimentError::Folds(format!(
            "{} folds of {fold_length} need more than the training data has, {} to {}: use fewer or shorter folds",
            tuning.folds,
            format_rfc3339(first),
            format_rfc3339(last)
        )));
    }
    for (number, fold) in (1..).zip(&folds) {
        if !data.train.iter().any(|samples| !split(samples, *fold).1.is_empty() && !split(samples, *fold).0.is_empty())
        {
            return Err(ExperimentError::Folds(format!(
                "fold {number}, from {} to {}, has no readings of a state that was seen before: use longer folds, or fewer",
                format_rfc3339(fold.from_nanos),
                format_rfc3339(fold.until_nanos)
            )));
        }
    }
    Ok(folds)
}

/// What is learned, and what is predicted.
fn split(samples: &[Sample], fold: Fold) -> (&[Sample], &[Sample]) {
    let from = samples.partition_point(|sample| sample.utc_nanos <= fold.from_nanos);
    let until = samples.partition_point(|sample| sample.utc_nanos <= fold.until_nanos);
    (&samples[..from], &samples[from..until])
}

/// Scores every candidate on every fold, and chooses.
pub fn tune(
    data: &Data,
    models: &[ModelEntry],
    folds: &[Fold],
    kind: ValueKind,
    step: &(impl Fn() + Sync),
) -> Result<Vec<Trial>, ExperimentError> {
    let each_fold = |model: usize, candidate: usize| (0..folds.len()).map(move |fold| (model, candidate, fold));
    let each_candidate = |model: usize| (0..models[model].candidates.len()).map(move |candidate| (model, candidate));
    let all: Vec<(usize, usize)> = (0..models.len()).flat_map(each_candidate).collect();
    let jobs: Vec<(usize, usize, usize)> =
        all.iter().flat_map(|&(model, candidate)| each_fold(model, candidate)).collect();
    let errors = jobs
        .into_par_iter()
        .map(|(model, candidate, fold)| {
            let (label, tried) = (&models[model].label, &models[model].candidates[candidate]);
            let errors = fold_errors(data, label, tried, folds[fold], kind);
            step();
            errors
        })
        .collect::<Result<Vec<Evaluation>, ExperimentError>>()?;
    let mut trials: Vec<Trial> = all
        .into_iter()
        .zip(errors.chunks(folds.len().max(1)))
        .map(|((model, candidate), folds)| Trial { model, candidate, folds: folds.to_vec(), chosen: false })
        .collect();
    for of_model in trials.chunk_by_mut(|a, b| a.model == b.model) {
        // Of equal ones the first.
        if let Some(best) = of_model.iter_mut().min_by(|a, b| a.error().total_cmp(&b.error())) {
            best.chosen = true;
        }
    }
    Ok(trials)
}

/// The errors of one candidate on one fold, all states together. A state that was not seen before the fold is left out.
fn fold_errors(
    data: &Data,
    label: &str,
    candidate: &ParameterSet,
    fold: Fold,
    kind: ValueKind,
) -> Result<Evaluation, ExperimentError> {
    let mut errors = Evaluation::default();
    for (state, samples) in data.states.iter().zip(&data.train) {
        let (learned, ahead) = split(samples, fold);
        if learned.is_empty() || ahead.is_empty() {
            continue;
        }
        let model =
            candidate.fit(learned, kind).map_err(|refused| ExperimentError::fit(label, candidate, state, refused))?;
        for sample in ahead {
            errors.add(model.predict(sample.moment()), sample.value);
        }
    }
    Ok(errors)
}
