//! Searches replayed: how long a robot looks for a person, by what it has learned of where she is when.
//!
//! The protocol is that of "Waldo" (Krajník, Kulich, Mudrová, Ambrus, Duckett, "Where's Waldo at time t?", ICRA 2015, section
//! VII): the presence in each place is a binary state, read every minute; models learn the first days, and are asked at every
//! minute of the others with somebody there. The robot walks the order of the least expected time from its start; who is
//! looked for stays where she is, and is found when the robot first comes there. Invariant: nothing that is asked for was
//! learned, parameters are chosen on the days that are learned alone, and the same files give the same figures, however many
//! threads there are.

use std::{
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};

use rayon::prelude::*;
use tidemap_model::models::CannotFit;
use tidemap_plan::search::SearchError;

mod protocol;
mod recorded_world;
mod report;
mod simulate;

#[cfg(test)]
mod tests;

pub use protocol::{SearchProtocol, read};
pub use report::{summary, write};

use crate::place_recording::{DAY_MINUTES, RecordingError};
use recorded_world::RecordedWorld;
use simulate::FindTimes;

/// Why searches could not be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// Where the person was.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The map of the places.
    #[error("{0}")]
    Topology(String),
    /// There is nothing to ask for.
    #[error("{learned} days are to be learned, and the world has {found} whole days: nothing is left to ask for")]
    Days {
        /// Days to learn.
        learned: usize,
        /// Days there are.
        found: usize,
    },
    /// Nobody is there to be found.
    #[error("in minutes {from} to {until} nobody is at any node of the topology")]
    Nobody {
        /// First minute asked for.
        from: usize,
        /// The one behind the last.
        until: usize,
    },
    /// A model that cannot be fitted.
    #[error("model {model} cannot be fitted to place {place:?}: {refused}")]
    Fit {
        /// Which, with its parameters.
        model: String,
        /// To which place.
        place: String,
        /// Why.
        refused: CannotFit,
    },
    /// A search that cannot be planned.
    #[error("a search cannot be planned: {0}")]
    Search(#[from] SearchError),
}

/// How one candidate of a model did on the days that are learned.
#[derive(Clone, Debug)]
pub struct SearchTrial {
    /// Index of the model.
    pub model: usize,
    /// Index of the candidate among the model's.
    pub candidate: usize,
    /// Mean time until found, in seconds, of each fold.
    pub folds: Vec<f64>,
    /// Whether it was chosen.
    pub chosen: bool,
}

impl SearchTrial {
    /// The mean over folds.
    pub fn mean_secs(&self) -> f64 {
        self.folds.iter().sum::<f64>() / self.folds.len().max(1) as f64
    }
}

/// How a model did.
#[derive(Clone, Debug)]
pub struct SearchResult {
    /// What it is called.
    pub label: String,
    /// Its parameters, with those that were chosen.
    pub parameters: String,
    /// When the person was found.
    pub found: FindTimes,
}

/// What came of the searches.
#[derive(Debug)]
pub struct SearchComparison {
    /// The models, in the order of the protocol, then who knows where the person is.
    pub rows: Vec<SearchResult>,
    /// Every candidate where there is more than one.
    pub trials: Vec<SearchTrial>,
}

/// What the last row is called: the search of who knows where the person is.
const OMNISCIENT: &str = "omniscient";

/// Searches with every model; `progress` is told how many pieces of work are done, of how many.
pub fn run(protocol: &SearchProtocol, progress: &(impl Fn(u64, u64) + Sync)) -> Result<SearchComparison, ReplayError> {
    let world = RecordedWorld::read(protocol)?;
    let (learned, minutes) = (protocol.train_minutes, world.minutes());
    if learned >= minutes {
        let day = DAY_MINUTES;
        return Err(ReplayError::Days { learned: learned / day, found: minutes / day });
    }
    replay(&world, protocol, progress)
}

fn replay(
    world: &RecordedWorld,
    protocol: &SearchProtocol,
    progress: &(impl Fn(u64, u64) + Sync),
) -> Result<SearchComparison, ReplayError> {
    let (learned, minutes) = (protocol.train_minutes, world.minutes());
    let folds = folds(protocol);
    let tuned = |model: usize| protocol.models[model].candidates.len() > 1;
    let candidates: Vec<(usize, usize)> = (0..protocol.models.len())
        .filter(|&model| tuned(model))
        .flat_map(|model| (0..protocol.models[model].candidates.len()).map(move |candidate| (model, candidate)))
        .collect();
    let (done, total) = (AtomicU64::new(0), (candidates.len() * folds.len() + protocol.models.len() + 1) as u64);
    let step = || progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
    let asked = |model: usize, candidate: usize, learned: usize, asked: Range<usize>| {
        let found = simulate::by_model(world, &protocol.models[model], candidate, learned, asked);
        step();
        found
    };
    let jobs: Vec<(usize, usize, &Range<usize>)> = candidates
        .iter()
        .flat_map(|&(model, candidate)| folds.iter().map(move |fold| (model, candidate, fold)))
        .collect();
    let means = jobs
        .into_par_iter()
        .map(|(model, candidate, fold)| Ok(asked(model, candidate, fold.start, fold.clone())?.mean_secs()))
        .collect::<Result<Vec<f64>, ReplayError>>()?;
    let mut trials: Vec<SearchTrial> = candidates
        .into_iter()
        .zip(means.chunks(folds.len().max(1)))
        .map(|((model, candidate), folds)| SearchTrial { model, candidate, folds: folds.to_vec(), chosen: false })
        .collect();
    for of_model in trials.chunk_by_mut(|a, b| a.model == b.model) {
        // Of equal ones the first.
        if let Some(best) = of_model.iter_mut().min_by(|a, b| a.mean_secs().total_cmp(&b.mean_secs())) {
            best.chosen = true;
        }
    }
    let chosen = |model: usize| {
        trials.iter().find(|trial| trial.model == model && trial.chosen).map_or(0, |trial| trial.candidate)
    };
    let mut rows = (0..protocol.models.len())
        .into_par_iter()
        .map(|model| {
            let (entry, candidate) = (&protocol.models[model], chosen(model));
            let found = asked(model, candidate, learned, learned..minutes)?;
            let parameters = entry.candidates[candidate].shown().to_owned();
            Ok(SearchResult { label: entry.label.clone(), parameters, found })
        })
        .collect::<Result<Vec<SearchResult>, ReplayError>>()?;
    let found = simulate::by_truth(world, learned..minutes)?;
    step();
    rows.push(SearchResult { label: OMNISCIENT.to_owned(), parameters: String::new(), found });
    Ok(SearchComparison { rows, trials })
}

/// The last minutes that are learned, in pieces, each of which is asked for by what is before it.
fn folds(protocol: &SearchProtocol) -> Vec<Range<usize>> {
    let fold = protocol.fold_minutes;
    let until = protocol.train_minutes;
    (0..protocol.folds).rev().map(|behind| until - (behind + 1) * fold..until - behind * fold).collect()
}
