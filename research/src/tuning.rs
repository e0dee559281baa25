//! Tuning of parameters by rolling origin, on training data only.
//!
//! The last folds of the training data are predicted one after another, each by models trained on all data before it.
//! The parameter set with the lowest mean error over the folds is chosen; ties: the first (L. Tashman, "Out-of-sample
//! tests of forecasting accuracy", IJF 2000).
//! Invariant: tuning has no access to test sets; every parameter set is scored on the same readings.

use rayon::prelude::*;
use tidemap_model::{
    Evaluation, Sample, StateKind,
    models::TemporalModel as _,
    time::{format_duration, format_rfc3339},
};

use super::{
    ExperimentError,
    compared::ComparedSettings,
    data::{Data, DataPortions},
    protocol::{ModelEntry, Tuning},
};

/// A part of the training data that is predicted from the data before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fold {
    /// Readings up to and including this time are training data: nanoseconds UTC.
    pub from_nanos: i64,
    /// The last time of the fold.
    pub until_nanos: i64,
}

/// The scores of one parameter set.
#[derive(Clone, Debug)]
pub struct Trial<F> {
    /// Index of the model.
    pub model: usize,
    /// Index of the parameter set among the sets of the model.
    pub set: usize,
    /// The score of the set on each fold.
    pub folds: Vec<F>,
    /// The mean error over the folds.
    pub error: f64,
    /// Whether the set was chosen.
    pub is_chosen: bool,
}

/// Scores parameter sets, given by model and set, on every fold, and chooses one for each model.
pub(crate) fn tune<F: Clone + Send, E: Send>(
    sets: Vec<(usize, usize)>,
    folds: usize,
    score: impl Fn(usize, usize, usize) -> Result<F, E> + Sync,
    error: impl Fn(&F) -> f64,
) -> Result<Vec<Trial<F>>, E> {
    let scores = (0..sets.len() * folds)
        .into_par_iter()
        .map(|job| score(sets[job / folds].0, sets[job / folds].1, job % folds))
        .collect::<Result<Vec<F>, E>>()?;
    let trial = |((model, set), folds): ((usize, usize), &[F])| {
        let error = folds.iter().map(&error).sum::<f64>() / folds.len().max(1) as f64;
        Trial { model, set, folds: folds.to_vec(), error, is_chosen: false }
    };
    let mut trials: Vec<Trial<F>> = sets.into_iter().zip(scores.chunks(folds.max(1))).map(trial).collect();
    for of_model in trials.chunk_by_mut(|a, b| a.model == b.model) {
        if let Some(best) = of_model.iter_mut().min_by(|a, b| a.error.total_cmp(&b.error)) {
            best.is_chosen = true;
        }
    }
    Ok(trials)
}

/// The chosen parameter set of a model; the first if there was no tuning.
pub(crate) fn chosen<F>(trials: &[Trial<F>], model: usize) -> usize {
    trials.iter().find(|trial| trial.model == model && trial.is_chosen).map_or(0, |trial| trial.set)
}

/// All parameter sets of a model.
pub(crate) fn sets_of((model, entry): (usize, &ModelEntry)) -> impl Iterator<Item = (usize, usize)> + use<> {
    (0..entry.sets.len()).map(move |set| (model, set))
}

/// The folds, the last of which ends with the training data.
pub(crate) fn folds(data: &DataPortions<'_>, tuning: Tuning) -> Result<Vec<Fold>, ExperimentError> {
    let (first, last) = data.train_extent;
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
    Ok(folds)
}

/// Checks that each fold had readings; `errors` are the errors of one parameter set.
pub(crate) fn check_folds(folds: &[Fold], errors: &[Evaluation]) -> Result<(), ExperimentError> {
    for (number, (fold, errors)) in (1..).zip(folds.iter().zip(errors)) {
        if errors.observations == 0 {
            return Err(ExperimentError::Folds(format!(
                "fold {number}, from {} to {}, has no readings of a state with earlier readings: use longer folds, or fewer",
                format_rfc3339(fold.from_nanos),
                format_rfc3339(fold.until_nanos)
            )));
        }
    }
    Ok(())
}

/// The training data of a fold, and the readings to predict.
fn split(samples: &[Sample], fold: Fold) -> (&[Sample], &[Sample]) {
    let from = samples.partition_point(|sample| sample.utc_nanos <= fold.from_nanos);
    let until = samples.partition_point(|sample| sample.utc_nanos <= fold.until_nanos);
    (&samples[..from], &samples[from..until])
}

/// Adds the errors of one parameter set on one fold, all states of a portion together. States without training data are
/// left out.
pub(crate) fn add_fold_errors(
    errors: &mut Evaluation,
    data: &Data,
    (label, set): (&str, &ComparedSettings),
    fold: Fold,
    kind: StateKind,
) -> Result<(), ExperimentError> {
    for (state, samples) in data.states.iter().zip(&data.train) {
        let (train, test) = split(samples, fold);
        if train.is_empty() || test.is_empty() {
            continue;
        }
        let model =
            set.train(train, kind).map_err(|refused| ExperimentError::cannot_train(label, set, state, refused))?;
        for sample in test {
            errors.add(model.predict(sample.moment()), sample.value);
        }
    }
    Ok(())
}
