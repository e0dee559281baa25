//! Experiments: temporal models compared on recordings, by a protocol, without a daemon.
//!
//! A protocol names data, models, how their parameters are tuned, and the baseline. Each model is fitted to each state by
//! itself, with one choice of parameters for all states. Invariant: parameters are chosen on training data alone, a test
//! set is predicted by what came before it, and the same files give the same results, however many threads there are.

use std::sync::atomic::{AtomicU64, Ordering};

use tidemap_model::models::CannotFit;

mod data;
pub mod explore;
mod paired;
mod parameter_set;
mod picture;
mod place_recording;
mod protocol;
mod report;
pub mod routes;
mod score;
pub mod search;
mod tuning;

#[cfg(test)]
mod tests;

pub use protocol::{Protocol, ProtocolError, read};
pub use report::{summary, write};

use data::{Data, DataError};
use paired::Difference;
use parameter_set::ParameterSet;
use score::TestScore;
use tuning::{Fold, Trial};

/// Why an experiment could not be run.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// Its data.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Its folds do not fit the training data.
    #[error("tuning: the training data: {0}")]
    Folds(String),
    /// A model that cannot be fitted.
    #[error("model {model} cannot be fitted to state {state:?}: {refused}")]
    Fit {
        /// Which, with its parameters.
        model: String,
        /// To which state.
        state: String,
        /// Why.
        refused: CannotFit,
    },
}

impl ExperimentError {
    fn fit(label: &str, candidate: &ParameterSet, state: &str, refused: CannotFit) -> Self {
        let model = match candidate.shown() {
            "" => label.to_owned(),
            shown => format!("{label} ({shown})"),
        };
        Self::Fit { model, state: state.to_owned(), refused }
    }
}

/// A model as it was compared.
#[derive(Clone, Debug)]
pub struct ModelResult {
    /// What it is called.
    pub label: String,
    /// Its parameters, with those that were chosen.
    pub parameters: String,
    /// How it did.
    pub score: TestScore,
    /// To the baseline; none of the baseline itself.
    pub difference: Option<Difference>,
}

impl ModelResult {
    /// What the test says: `better`, `worse` or `no difference`; `baseline` of the baseline, none where nothing was tested.
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

/// What came of an experiment.
#[derive(Debug)]
pub struct Comparison {
    /// The models, in the order of the protocol.
    pub models: Vec<ModelResult>,
    /// The folds that parameters were chosen on.
    pub folds: Vec<Fold>,
    /// How every candidate did on them.
    pub trials: Vec<Trial>,
    /// The data.
    pub data: Data,
}

/// Runs an experiment; `progress` is told how many pieces of work are done, of how many.
pub fn run(protocol: &Protocol, progress: &(impl Fn(u64, u64) + Sync)) -> Result<Comparison, ExperimentError> {
    let data = Data::read(protocol)?;
    let folds = protocol.tuning.map(|tuning| tuning::folds(&data, tuning)).transpose()?.unwrap_or_default();
    let candidates: usize = protocol.models.iter().map(|model| model.candidates.len()).sum();
    let total = (candidates * folds.len() + protocol.models.len() * data.states.len()) as u64;
    let done = AtomicU64::new(0);
    let step = || progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);

    let trials = if folds.is_empty() {
        Vec::new()
    } else {
        tuning::tune(&data, &protocol.models, &folds, protocol.kind, &step)?
    };
    let chosen = |model: usize| trials.iter().find(|trial| trial.model == model && trial.chosen);
    let models: Vec<(&str, &ParameterSet)> = (0..)
        .zip(&protocol.models)
        .filter_map(|(index, model)| {
            // Without tuning there is one candidate.
            let candidate = model.candidates.get(chosen(index).map_or(0, |trial| trial.candidate))?;
            Some((model.label.as_str(), candidate))
        })
        .collect();
    let scores = score::score(&data, &models, protocol.refit, protocol.kind, &step)?;
    let baseline = scores.get(protocol.baseline).map_or_else(Vec::new, |score| score.days.clone());
    let compared = models.iter().zip(scores).enumerate().map(|(index, (&(label, candidate), score))| {
        let difference =
            (index != protocol.baseline).then(|| paired::difference(&score.days, &baseline, protocol.significance));
        ModelResult { label: label.to_owned(), parameters: candidate.shown().to_owned(), score, difference }
    });
    Ok(Comparison { models: compared.collect(), folds, trials, data })
}
