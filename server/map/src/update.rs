//! The nightly update: the data that it takes along and the result that it returns.
//!
//! 1. The writer logs [`UpdateStart`]. Its log position determines which observations the update takes: those at
//!    earlier positions with a time before the cut. A cut never goes back.
//! 2. When the start is durable, the pending observations go into [`UpdateWork`], with a copy of the live values at
//!    that position. The map continues to change meanwhile.
//! 3. For each state and local day, in order of time: the observations of the day that are unusual by the model from
//!    before the day are kept (`anomaly/learned.rs`). The model predicts every observation that is newer than all it
//!    has learned, with each order 0 to 15. The errors are added to the decayed sums, the order with the lowest sum is
//!    chosen, then the day is learned and the model trained again. Older observations are learned without a score. The
//!    alternative models that the map enables are scored in the same way; `auto` changes only to a model whose error is
//!    lower by 5 %.
//! 4. After each day, models that need training data are trained again where they are due (`training.rs`), so that the
//!    map does not depend on how many days one update takes (`update/daily_steps.rs`).
//! 5. The writer publishes the generation, and a snapshot goes to the store. If saving fails, the log still has
//!    everything.
//!
//! An update that was killed runs again from the same log position. It keeps no journal: a day of a grid of 213,000
//! cells takes 1.2 s on one thread (BENCHMARKS.md), a hundred times as many cells two minutes.
//!
//! Invariant: the work holds all that it needs; the result depends only on the work and the readings that it is given.
//! States are processed independently of each other.

use std::{collections::BTreeMap, sync::Arc};

use tidemap_model::{Sample, StateModel, UpdateOutcome, selector::ModelSelector};

#[cfg(test)]
use tidemap_grid::update::rules::UpdateLimits;
use tidemap_grid::{
    live::GridBasis,
    outcome::GridOutcome,
    pace::Pace,
    spec::Retention,
    tile::TileUnavailable,
    update::{GridResult, GridWork},
};

use crate::{
    directory::Directory,
    event::{UpdateCause, UpdateStart},
    history::{HistoryDay, HistoryPiece, origins::Origins},
    ids::StateId,
    name::StateName,
    prior_models::PriorModels,
    site::Site,
    snapshot::ProducerMark,
    spec::MapSpec,
    training::{StateReadings, TrainingOutcome},
    view::LiveState,
};

mod daily_steps;
mod late_rows;
mod spectrum_room;

use daily_steps::DailySteps;
use late_rows::LateRows;
pub use late_rows::LateRowsOutcome;
use spectrum_room::RoomInUse;
pub use spectrum_room::{SpectrumRoom, SpectrumSpill};

/// Maximum number of readings that rows of changes and events represent in one update, except the readings of one local
/// day: about half a minute's work. The number is part of the definition of an update, and not a setting: a repeated
/// update must learn the same data.
pub const UPDATE_READINGS_MAX: u64 = 4_000_000;

/// Sums that an update needs cannot be read back from the disk.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SumsUnavailable {
    /// A tile of the grid.
    #[error(transparent)]
    Tile(#[from] TileUnavailable),
    /// The sums of a state.
    #[error("state {name:?}: {reason}")]
    State {
        /// The name of the state.
        name: String,
        /// The reason.
        reason: String,
    },
}

/// The map at the update's log position, except its models.
#[derive(Debug)]
pub(crate) struct MapAtUpdate {
    pub(crate) start: UpdateStart,
    pub(crate) position: u64,
    pub(crate) replay_from: u64,
    pub(crate) newest_nanos: i64,
    pub(crate) producers: Vec<ProducerMark>,
    pub(crate) directory: Directory,
    pub(crate) live: Vec<LiveState>,
    pub(crate) site: Arc<Site>,
    pub(crate) grid: Option<GridBasis>,
}

/// An update, ready to run.
#[derive(Debug)]
pub struct UpdateWork {
    pub(crate) basis: MapAtUpdate,
    pub(crate) spec: Arc<MapSpec>,
    pub(crate) models: Arc<Vec<Arc<StateModel>>>,
    pub(crate) prior_models: PriorModels,
    pub(crate) samples: Vec<(StateId, Vec<Sample>)>,
    /// The origins of the observations of each entry of `samples`.
    pub(crate) origins: Vec<Origins>,
    /// For each state that reports changes or events: the time up to which its rows are known to be complete,
    /// nanoseconds UTC.
    pub(crate) horizons: BTreeMap<StateId, i64>,
    pub(crate) grid: Option<GridWork>,
    pub(crate) readings: Option<Arc<dyn StateReadings>>,
    pub(crate) room: Option<SpectrumRoom>,
    /// Maximum number of readings that rows represent, except the readings of one local day.
    pub(crate) readings_max: u64,
}

/// The result of an update.
#[derive(Debug)]
pub struct UpdateResult {
    pub(crate) basis: MapAtUpdate,
    pub(crate) models: Arc<Vec<Arc<StateModel>>>,
    pub(crate) grid: Option<GridResult>,
    pub(crate) history: Option<HistoryPiece>,
    outcomes: Vec<StateOutcome>,
    training: TrainingOutcome,
    late_rows: LateRowsOutcome,
    /// Local midnight up to which rows are learned; `None`: all are.
    rows_to_nanos: Option<i64>,
}

/// The outcome of an update for one state.
#[derive(Clone, Debug, PartialEq)]
pub struct StateOutcome {
    /// The name of the state.
    pub name: StateName,
    /// Orders, errors and counts.
    pub outcome: UpdateOutcome,
    /// The model that predicts the state from now on.
    pub chosen: ModelSelector,
}

impl UpdateWork {
    /// The start of the update, as in the log.
    pub fn start(&self) -> UpdateStart {
        self.basis.start
    }

    /// Number of states and tiles with observations to learn.
    pub fn states(&self) -> u64 {
        let silent = self.horizons.keys().filter(|id| self.samples.binary_search_by_key(id, |(id, _)| id).is_err());
        (self.samples.len() + silent.count()) as u64 + self.grid.as_ref().map_or(0, GridWork::busy_tiles)
    }

    /// Number of observations and scans to learn.
    pub fn observations(&self) -> u64 {
        let scans = self.grid.as_ref().map_or(0, GridWork::scans);
        self.samples.iter().map(|(_, samples)| samples.len() as u64).sum::<u64>() + scans
    }

    /// This update, with the readings that earlier updates have learned, so that models are trained again where they
    /// are due. Without these readings, models stay unchanged. A repeated update must be given the same readings as the
    /// first time.
    pub fn with_readings(self, readings: Arc<dyn StateReadings>) -> UpdateWork {
        UpdateWork { readings: Some(readings), ..self }
    }

    /// This update with a limit of the memory for sums of states; without a limit all sums stay in memory.
    pub fn with_room(self, room: SpectrumRoom) -> UpdateWork {
        UpdateWork { room: Some(room), ..self }
    }

    /// This update with another maximum number of readings that rows represent.
    #[must_use]
    pub fn with_readings_max(self, readings_max: u64) -> UpdateWork {
        UpdateWork { readings_max, ..self }
    }

    /// This update with other limits of the update of the grid.
    #[cfg(test)]
    pub(crate) fn with_limits(mut self, limits: UpdateLimits) -> UpdateWork {
        self.grid = self.grid.map(|grid| grid.with_limits(limits));
        self
    }

    /// Runs the update on the threads of the current rayon pool. `pace` counts the states and tiles done; a tile that
    /// was seen on several days is done in as many parts.
    ///
    /// # Errors
    /// [`SumsUnavailable`] where a tile of the grid or the sums of a state cannot be read back from the disk.
    pub fn run(self, pace: &dyn Pace) -> Result<UpdateResult, SumsUnavailable> {
        let keeps_states = self.spec.retention != Retention::None;
        let kept_grid = self.spec.grid.as_ref().filter(|grid| grid.retention != Retention::None);
        let mut history = HistoryPiece::new(self.basis.start.generation);
        history.states = self.samples;
        history.origins = self.origins;
        let mut grid = self.grid.map(|grid| grid.run(pace)).transpose()?;
        if let Some(grid) = &mut grid {
            let days = std::mem::take(&mut grid.days);
            if let Some(spec) = kept_grid {
                let levels = spec.sensor.levels();
                let encode = |day| HistoryDay::encode(day, &grid.generation, &self.spec.periodicities, levels);
                history.days = days.into_iter().map(encode).collect();
            }
        }
        let mut models: Vec<Arc<StateModel>> = Vec::with_capacity(self.basis.directory.len());
        models.extend(self.models.iter().cloned());
        let new = self.basis.directory.iter().skip(models.len());
        models.extend(new.map(|info| self.prior_models.beginning(info)));
        let is_early = self.basis.start.cause == UpdateCause::PendingLimit;
        for origins in &mut history.origins {
            origins.is_early = is_early;
        }
        let room = RoomInUse::new(self.room, &models);
        // History keeps the samples in order of arrival.
        history.states.iter_mut().for_each(|(_, samples)| samples.shrink_to_fit());
        let readings = self.readings.as_deref();
        // The time is limited as in the deletion of history: an import may be far in advance of the learned data.
        let learned_nanos = self.basis.newest_nanos.min(self.basis.start.cut_nanos);
        let late_rows = LateRows::new(&self.spec, &self.prior_models, learned_nanos);
        let (anew, late_rows) = late_rows.begin(&history.states, &mut models, readings);
        let (spec, horizons, together) = (&*self.spec, &self.horizons, self.basis.directory.parts());
        let readings_max = self.readings_max;
        let steps = DailySteps { spec, readings, horizons, anew, room: &room, together, readings_max, pace };
        let done = steps.learn(&history.states, &mut models).map_err(|(id, reason)| {
            let name = self.basis.directory.info(id).map_or("", |info| info.name.as_str()).to_owned();
            SumsUnavailable::State { name, reason }
        })?;
        // The choice is read after models were trained again, which may change it.
        let named = |(id, outcome): (StateId, UpdateOutcome)| {
            let model = &models[id.0 as usize];
            let chosen = ModelSelector::of_choice(model.answers(), model);
            self.basis.directory.info(id).map(|info| StateOutcome { name: info.name.clone(), outcome, chosen })
        };
        let outcomes = done.outcomes.into_iter().filter_map(named).collect();
        if !keeps_states {
            (history.states, history.origins) = (Vec::new(), Vec::new());
        }
        let history = history.bounded();
        let models = Arc::new(models);
        let (training, rows_to_nanos) = (done.training, done.stop_nanos);
        Ok(UpdateResult { basis: self.basis, models, grid, history, outcomes, training, late_rows, rows_to_nanos })
    }
}

impl UpdateResult {
    /// The outcomes of the states that had observations, in order of first appearance.
    pub fn outcomes(&self) -> &[StateOutcome] {
        &self.outcomes
    }

    /// The outcome of the training of models that were due.
    pub fn training_outcome(&self) -> &TrainingOutcome {
        &self.training
    }

    /// The outcome for the states whose rows of changes or events came late.
    pub fn late_rows_outcome(&self) -> &LateRowsOutcome {
        &self.late_rows
    }

    /// The local midnight up to which rows of changes and events are learned, nanoseconds UTC: all rows together
    /// represent too many readings for one update, and the next update is due at once. `None`: all are learned.
    pub fn rows_to_nanos(&self) -> Option<i64> {
        self.rows_to_nanos
    }

    /// The outcome for the cells of the grid, where the map has one.
    pub fn grid_outcome(&self) -> Option<&GridOutcome> {
        self.grid.as_ref().map(|grid| &grid.outcome)
    }
}
