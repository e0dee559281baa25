//! The update: what it takes along, and what it brings back.
//!
//! Invariant: the work holds all that it needs, so that the map goes on changing meanwhile; the result depends on
//! nothing but the work. States are worked off independently of each other.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use rayon::prelude::*;
use tidemap_model::{Sample, StateModel, UpdateOutcome};

use crate::{
    directory::Directory,
    event::{StateId, UpdateStart},
    name::StateName,
    snapshot::ProducerMark,
    spec::MapSpec,
    view::LiveState,
};

/// The map at the update's log position, but for its models.
#[derive(Debug)]
pub(crate) struct Basis {
    pub(crate) start: UpdateStart,
    pub(crate) position: u64,
    pub(crate) replay_from: u64,
    pub(crate) newest_nanos: i64,
    pub(crate) producers: Vec<ProducerMark>,
    pub(crate) directory: Directory,
    pub(crate) live: Vec<LiveState>,
}

/// An update, ready to run.
#[derive(Debug)]
pub struct UpdateWork {
    pub(crate) basis: Basis,
    pub(crate) spec: Arc<MapSpec>,
    pub(crate) models: Arc<Vec<Arc<StateModel>>>,
    pub(crate) unlearned: Arc<StateModel>,
    pub(crate) samples: Vec<(StateId, Vec<Sample>)>,
}

/// What an update learned.
#[derive(Debug)]
pub struct UpdateResult {
    pub(crate) basis: Basis,
    pub(crate) models: Arc<Vec<Arc<StateModel>>>,
    outcomes: Vec<StateOutcome>,
}

/// What an update did to one state.
#[derive(Clone, Debug, PartialEq)]
pub struct StateOutcome {
    /// Its name.
    pub name: StateName,
    /// Orders, errors and counts.
    pub outcome: UpdateOutcome,
}

impl UpdateWork {
    /// How the log holds its start.
    #[must_use]
    pub fn start(&self) -> UpdateStart {
        self.basis.start
    }

    /// Number of states with observations to fold in.
    #[must_use]
    pub fn states(&self) -> u64 {
        self.samples.len() as u64
    }

    /// Number of observations to fold in.
    #[must_use]
    pub fn observations(&self) -> u64 {
        self.samples.iter().map(|(_, samples)| samples.len() as u64).sum()
    }

    /// Runs the update, on the threads of the rayon pool that this is called in. `progress` counts the states done.
    #[must_use]
    pub fn run(self, progress: &AtomicU64) -> UpdateResult {
        let mut models: Vec<Arc<StateModel>> = Vec::with_capacity(self.basis.directory.len());
        models.extend(self.models.iter().cloned());
        models.resize(self.basis.directory.len(), Arc::clone(&self.unlearned));
        let learned: Vec<(StateId, Arc<StateModel>, UpdateOutcome)> = self
            .samples
            .into_par_iter()
            .map(|(id, samples)| {
                let mut model = StateModel::clone(&models[id.0 as usize]);
                let outcome = model.update(&self.spec.periodicities, self.spec.criterion, samples);
                progress.fetch_add(1, Ordering::Relaxed);
                (id, Arc::new(model), outcome)
            })
            .collect();
        let mut outcomes = Vec::with_capacity(learned.len());
        for (id, model, outcome) in learned {
            models[id.0 as usize] = model;
            if let Some(info) = self.basis.directory.info(id) {
                outcomes.push(StateOutcome { name: info.name.clone(), outcome });
            }
        }
        UpdateResult { basis: self.basis, models: Arc::new(models), outcomes }
    }
}

impl UpdateResult {
    /// What was done to each state that had observations, in order of first appearance.
    #[must_use]
    pub fn outcomes(&self) -> &[StateOutcome] {
        &self.outcomes
    }
}
