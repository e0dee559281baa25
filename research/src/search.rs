//! Searches replayed: how long a robot takes to find a person, by its learned data about where the person is when.
//!
//! The protocol is the one of "Waldo" (Krajník, Kulich, Mudrová, Ambrus, Duckett, "Where's Waldo at time t?", ICRA
//! 2015, section VII): the presence in each place is a binary state, observed every minute. Models learn the first days
//! and predict every later minute in which the person is at a node. The robot visits the nodes in the order of least
//! expected time from its start; the person stays in place, and is found when the robot first arrives there. The last
//! row of the results is an oracle that knows the person's position.
//!
//! - `protocol.rs`: YAML to [`SearchProtocol`]; `recorded_world.rs`: topology and recording to a node for every minute;
//! - `simulate.rs`: trains models, plans a search for every minute, and computes when the robot arrives at the person;
//! - `report.rs`: results.csv, folds.csv.
//!
//! Parameters are tuned on the mean time until the person is found in the folds, or on the log loss of the person's
//! place there, each predicted from the data before it.
//!
//! Invariant: no prediction uses its own minute or later ones, parameters are tuned on training days only, and the same
//! files give the same figures for any number of threads.

use std::{
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};

use rayon::prelude::*;
use tidemap_model::models::CannotTrain;
use tidemap_plan::search::SearchError;

mod protocol;
mod recorded_world;
mod report;
mod simulate;

#[cfg(test)]
mod tests;

pub use protocol::{SearchProtocol, TuningCriterion, read};
pub use report::{summary, write};

use crate::{
    place_recording::{DAY_MINUTES, RecordingError},
    tuning::{self, Trial},
};
use recorded_world::RecordedWorld;
use simulate::FindTimes;

/// Why searches cannot be replayed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum ReplayError {
    /// The recording is invalid.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The topological map is invalid.
    #[error("{0}")]
    Topology(String),
    /// All days are training data.
    #[error("{learned} days are training data, and the world has {found} whole days: nothing is left to search")]
    Days { learned: usize, found: usize },
    /// The person is never at a node.
    #[error("in minutes {from} to {until} nobody is at any node of the topology")]
    Nobody { from: usize, until: usize },
    /// A model cannot be trained.
    #[error("model {model} cannot be trained on place {place:?}: {refused}")]
    CannotTrain { model: String, place: String, refused: CannotTrain },
    /// A search cannot be planned.
    #[error("a search cannot be planned: {0}")]
    Search(#[from] SearchError),
}

/// The result of a model.
#[derive(Clone, Debug)]
pub struct SearchResult {
    /// The name of the model in results.
    pub label: String,
    /// The parameters of the model, as chosen.
    pub parameters: String,
    /// The times until the person was found.
    pub times: FindTimes,
}

/// The results of all models.
#[derive(Debug)]
pub struct SearchComparison {
    /// The models, in the order of the protocol, then the oracle.
    pub rows: Vec<SearchResult>,
    /// All parameter sets of models with more than one; their folds are mean times in seconds, or log losses.
    pub trials: Vec<Trial<f64>>,
}

/// The name of the oracle, which knows the person's position.
const OMNISCIENT: &str = "omniscient";

/// Searches with every model; `progress` receives the numbers of finished and of all jobs.
pub fn run(protocol: &SearchProtocol, progress: &(impl Fn(u64, u64) + Sync)) -> Result<SearchComparison, ReplayError> {
    let world = RecordedWorld::read(protocol)?;
    let (learned, minutes) = (protocol.train_minutes, world.minutes());
    if learned >= minutes {
        return Err(ReplayError::Days { learned: learned / DAY_MINUTES, found: minutes / DAY_MINUTES });
    }
    let folds = folds(protocol);
    let tuned = protocol.models.iter().enumerate().filter(|(_, model)| model.sets.len() > 1);
    let sets: Vec<(usize, usize)> = tuned.flat_map(tuning::sets_of).collect();
    let (done, total) = (AtomicU64::new(0), (sets.len() * folds.len() + protocol.models.len() + 1) as u64);
    let step = || progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
    let times = |model: usize, set: usize, learned: usize, minutes: Range<usize>| {
        let times = simulate::by_model(&world, &protocol.models[model], set, learned, minutes);
        step();
        times
    };
    let error = |model: usize, set: usize, fold: usize| match protocol.criterion {
        TuningCriterion::Seconds => Ok(times(model, set, folds[fold].start, folds[fold].clone())?.mean_secs()),
        TuningCriterion::LogLoss => {
            let loss = simulate::log_loss(&world, &protocol.models[model], set, folds[fold].clone());
            step();
            loss
        }
    };
    let trials = tuning::tune(sets, folds.len(), error, |&error| error)?;
    let mut rows = protocol
        .models
        .par_iter()
        .enumerate()
        .map(|(index, model)| {
            let set = tuning::chosen(&trials, index);
            let times = times(index, set, learned, learned..minutes)?;
            Ok(SearchResult { label: model.label.clone(), parameters: model.sets[set].shown().to_owned(), times })
        })
        .collect::<Result<Vec<SearchResult>, ReplayError>>()?;
    let times = simulate::by_truth(&world, learned..minutes)?;
    step();
    rows.push(SearchResult { label: OMNISCIENT.to_owned(), parameters: String::new(), times });
    Ok(SearchComparison { rows, trials })
}

/// The last training minutes in folds, each predicted from the minutes before it.
fn folds(protocol: &SearchProtocol) -> Vec<Range<usize>> {
    let (fold, until) = (protocol.fold_minutes, protocol.train_minutes);
    (0..protocol.folds).rev().map(|behind| until - (behind + 1) * fold..until - behind * fold).collect()
}
