//! A map as its single writer holds it: it applies events and publishes views.
//!
//! Invariant: the state is a function of the events applied and their order. Nothing here waits: an update leaves as
//! [`UpdateWork`], runs elsewhere while observations continue, and returns through [`LiveMap::finish_update`]. At most
//! one update runs at a time.

use std::{
    collections::HashMap,
    sync::{Arc, OnceLock},
};

use tidemap_grid::{live::LiveGrid, view::GridView};
use tidemap_model::StateModel;

use crate::{
    directory::{Directory, StateInfo},
    event::{Event, Reporting, StateKind, StateSensor, StateShape, UpdateStart},
    ids::{ProducerId, StateId},
    name::ProducerKey,
    pending::{Origin, Pending},
    prior_models::PriorModels,
    site::Site,
    snapshot::{MapSnapshot, ProducerMark},
    spec::MapSpec,
    update::UpdateWork,
    view::{LIVE_CHUNK, LiveState, MapView},
};

mod apply;
mod paging;
mod recall;
pub mod rename;
mod updates;

#[cfg(test)]
mod tests;

/// Maximum number of readings that the rows of all states of a map represent in a day: the readings of 100,000 states
/// with one reading every five minutes. An update learns at least one local day.
pub const ROW_READINGS_A_DAY_MAX: u64 = 28_800_000;

/// An event is inconsistent with the events before it: this map did not write the log.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("event at log position {position} does not fit the map: {reason}")]
pub struct InconsistentEvent {
    /// Log position of the event.
    pub position: u64,
    /// The inconsistency.
    pub reason: String,
}

/// Amounts of pending data at which an update runs early.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PendingLimits {
    /// Observations of named states.
    pub observations: u64,
    /// Changes in scans of the grid.
    pub changes: u64,
}

/// A map that applies events.
#[derive(Debug)]
pub struct LiveMap {
    spec: Arc<MapSpec>,
    position: u64,
    generation: u64,
    cut_nanos: i64,
    newest_nanos: i64,
    observations: u64,
    producers: Vec<ProducerMark>,
    producer_ids: HashMap<ProducerKey, ProducerId>,
    /// Number of producers that have given their places up.
    forgotten: usize,
    directory: Directory,
    live: Vec<LiveState>,
    live_published: Vec<Arc<[LiveState]>>,
    live_dirty: Vec<bool>,
    /// The states that report changes or events, ascending.
    with_rows: Vec<StateId>,
    /// Maximum number of readings that the rows of these states represent in a day.
    row_readings_a_day: u64,
    models: Arc<Vec<Arc<StateModel>>>,
    /// Rows that updates have taken and not learned yet.
    waiting_rows: u64,
    prior_models: PriorModels,
    pending: Pending,
    /// While a snapshot's pending observations are read again: the number of observations of each state that have been
    /// read.
    recovered: HashMap<StateId, u64>,
    site: Arc<Site>,
    pub(crate) grid: Option<LiveGrid>,
    /// The running update: its start, and the amounts it has taken.
    running: Option<(UpdateStart, PendingLimits)>,
}

impl LiveMap {
    /// An empty map.
    pub fn new(spec: Arc<MapSpec>) -> Self {
        let prior_models = PriorModels::new(&spec);
        let grid = spec.grid.clone().map(|grid| LiveGrid::new(Arc::new(grid)));
        Self {
            spec,
            position: 0,
            generation: 0,
            cut_nanos: 0,
            newest_nanos: 0,
            observations: 0,
            producers: Vec::new(),
            producer_ids: HashMap::new(),
            forgotten: 0,
            directory: Directory::new(),
            live: Vec::new(),
            live_published: Vec::new(),
            live_dirty: Vec::new(),
            with_rows: Vec::new(),
            row_readings_a_day: 0,
            models: Arc::new(Vec::new()),
            waiting_rows: 0,
            prior_models,
            pending: Pending::default(),
            recovered: HashMap::new(),
            site: Arc::default(),
            grid,
            running: None,
        }
    }

    /// Restores a snapshot, without its pending observations: replay the events from `snapshot.replay_from` on to
    /// restore those.
    pub fn restore(spec: Arc<MapSpec>, snapshot: MapSnapshot) -> Self {
        let mut map = Self::new(spec);
        map.position = snapshot.position;
        map.generation = snapshot.generation;
        map.cut_nanos = snapshot.cut_nanos;
        map.newest_nanos = snapshot.newest_nanos;
        for mark in snapshot.producers {
            map.add_producer(mark);
        }
        let mut models = Vec::with_capacity(snapshot.states.len());
        for state in snapshot.states {
            let (sensor, reporting) = (state.model.sensor(), state.model.reporting());
            map.add_state(StateInfo { name: state.name, kind: state.kind, sensor, reporting });
            if let Some(live) = map.live.last_mut() {
                *live = LiveState {
                    observations: state.observations,
                    persistence: state.persistence,
                    recent: state.recent,
                    newest_row: state.newest_row,
                };
            }
            map.observations += state.observations;
            models.push(state.model);
        }
        map.models = Arc::new(models);
        map.waiting_rows = map.count_waiting_rows();
        map.site = snapshot.site;
        if let Some(grid) = snapshot.grid {
            if let Some(received) = grid.received_nanos {
                map.pending.received(received);
            }
            map.grid = map.grid.map(|empty| empty.restore(grid));
        }
        map
    }

    /// The fixed properties of the map.
    pub fn spec(&self) -> &Arc<MapSpec> {
        &self.spec
    }

    /// Position of the last event applied; 0 before the first.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.directory.len()
    }

    /// The state of this name.
    pub fn find(&self, name: &str) -> Option<StateId> {
        self.directory.find(name)
    }

    /// The shape of the observations of a name, with the id of its state or of its first axis.
    pub fn shape(&self, name: &str) -> Option<(StateId, StateShape)> {
        self.directory.shape(name)
    }

    /// The producer of this key, if it has ever sent anything.
    pub fn producer(&self, key: &ProducerKey) -> Option<(ProducerId, &ProducerMark)> {
        let id = *self.producer_ids.get(key)?;
        self.producers.get(id.0 as usize).map(|mark| (id, mark))
    }

    /// All producers, in the order of their numbers.
    pub fn producer_marks(&self) -> &[ProducerMark] {
        &self.producers
    }

    /// Number of producer keys with a place: keys that were not forgotten, or have sent again since.
    pub fn producer_places(&self) -> usize {
        self.producers.len() - self.forgotten
    }

    /// Number of forgotten producer keys.
    pub fn forgotten_producers(&self) -> usize {
        self.forgotten
    }

    /// Number of producer keys, forgotten ones included.
    pub fn producers(&self) -> usize {
        self.producers.len()
    }

    /// The sensor that reads a state, where it is known.
    pub fn sensor(&self, id: StateId) -> Option<StateSensor> {
        self.directory.info(id).and_then(|info| info.sensor)
    }

    /// How the rows of a state are reported.
    pub fn reporting(&self, id: StateId) -> Reporting {
        self.directory.info(id).map_or(Reporting::Samples, |info| info.reporting)
    }

    /// Maximum number of readings that the rows of all states that report changes or events represent in a day.
    pub fn row_readings_a_day(&self) -> u64 {
        self.row_readings_a_day
    }

    /// Kind of a state.
    pub fn kind(&self, id: StateId) -> Option<StateKind> {
        self.directory.info(id).map(|info| info.kind)
    }

    /// The site: the data that people and robots give the map besides observations.
    pub fn site(&self) -> &Site {
        &self.site
    }

    /// The grid, where the map has one.
    pub fn grid(&self) -> Option<&LiveGrid> {
        self.grid.as_ref()
    }

    /// Number of pending items that an update could learn, without those of a running update: observations, and changes
    /// of scans, which are what memory holds.
    pub fn pending(&self) -> u64 {
        self.pending.total() + self.grid.as_ref().map_or(0, LiveGrid::pending_changes)
    }

    /// Observations and scans that wait because their time is too far in the future.
    pub fn future(&self) -> u64 {
        self.pending.future() + self.grid.as_ref().map_or(0, LiveGrid::future)
    }

    /// Number of rows of changes and events that updates have taken and not learned yet, because they represent more
    /// readings than one update may learn. The next update learns more of them.
    pub fn waiting_rows(&self) -> u64 {
        self.waiting_rows
    }

    fn count_waiting_rows(&self) -> u64 {
        let of_state =
            |id: &StateId| self.models.get(id.0 as usize)?.learned_rows().map(|rows| rows.waiting.len() as u64);
        self.with_rows.iter().filter_map(of_state).sum()
    }

    /// Observations that a running update has taken.
    pub fn updating(&self) -> u64 {
        self.running.map_or(0, |(_, taken)| taken.observations + taken.changes)
    }

    /// Load of the memory for pending data, optionally with that of a running update: 1 when the fuller of the two
    /// kinds reaches its limit.
    pub fn pending_load(&self, limits: PendingLimits, with_running: bool) -> f64 {
        let taken = self.running.map(|(_, taken)| taken).filter(|_| with_running).unwrap_or_default();
        let observations = self.pending.total() + self.waiting_rows + taken.observations;
        let changes = self.grid.as_ref().map_or(0, LiveGrid::pending_changes) + taken.changes;
        let share = |held: u64, limit: u64| held as f64 / limit.max(1) as f64;
        share(observations, limits.observations).max(share(changes, limits.changes))
    }

    /// The earliest time of the pending observations, or an earlier time, nanoseconds UTC.
    pub fn pending_since_nanos(&self) -> Option<i64> {
        let scans = self.grid.as_ref().and_then(LiveGrid::oldest_pending_nanos);
        [self.pending.oldest_nanos(), scans].into_iter().flatten().min()
    }

    /// The time at which the first of the pending observations was received, or an earlier time; nanoseconds UTC of the
    /// server's clock.
    pub fn pending_received_nanos(&self) -> Option<i64> {
        self.pending.received_nanos()
    }

    /// Latest time of any observation that did not have to wait, nanoseconds UTC; 0 without observations.
    pub fn newest_nanos(&self) -> i64 {
        self.newest_nanos
    }

    /// Cut of the last update, nanoseconds UTC; 0 before the first.
    pub fn cut_nanos(&self) -> i64 {
        self.cut_nanos
    }

    /// Whether an update is running at present.
    pub fn is_updating(&self) -> bool {
        self.running.is_some()
    }

    /// Applies the event at the next log position. The start of an update returns the work to run.
    ///
    /// # Errors
    /// [`InconsistentEvent`] where the event cannot follow the events before it; the map is then unusable.
    pub fn apply(&mut self, position: u64, event: &Event) -> Result<Option<UpdateWork>, InconsistentEvent> {
        let inconsistent = |reason: String| InconsistentEvent { position, reason };
        if position != self.position + 1 {
            return Err(inconsistent(format!("the position before it should be {}", self.position)));
        }
        self.number_recovered();
        let work = match event {
            Event::Observations(envelope, observations) => {
                self.apply_observations(position, envelope, observations).map_err(inconsistent)?;
                None
            }
            Event::Scans(envelope, scans) => {
                self.take_in_scans(envelope, scans).map_err(inconsistent)?;
                None
            }
            Event::UpdateStart(start) => Some(self.start_update(position, *start).map_err(inconsistent)?),
            Event::AddState(new) => {
                self.add_new_state(new).map_err(inconsistent)?;
                None
            }
            Event::EditSite(edit) => {
                let states = self.directory.len();
                Arc::make_mut(&mut self.site).apply(edit, states).map_err(|error| inconsistent(error.to_string()))?;
                self.rename_states(edit);
                None
            }
            Event::ForgetProducers(producers) => {
                self.forget_producers(producers).map_err(inconsistent)?;
                None
            }
            Event::Epoch(_) | Event::UpdateDone(_) => None,
        };
        self.position = position;
        Ok(work)
    }

    /// After a restore: applies the pending observations of an event that the snapshot covers.
    ///
    /// # Errors
    /// [`InconsistentEvent`] where the event names states that the snapshot lacks.
    pub fn recover_pending(&mut self, position: u64, event: &Event) -> Result<(), InconsistentEvent> {
        if let Event::Observations(envelope, observations) = event {
            for (state, sample) in observations.samples() {
                let number = self.recovered.entry(state).or_default();
                *number += 1;
                if sample.utc_nanos < self.cut_nanos {
                    continue;
                }
                if state.0 as usize >= self.live.len() {
                    let reason = format!("state {} is unknown", state.0);
                    return Err(InconsistentEvent { position, reason });
                }
                let from = Origin { position, producer: envelope.producer, number: *number };
                if sample.utc_nanos <= envelope.plausible_nanos() {
                    self.pending.push(state, sample, from);
                } else {
                    self.pending.push_future(state, sample, from);
                }
                self.pending.received(envelope.received_nanos);
            }
        }
        Ok(())
    }

    /// Assigns numbers: the last of the observations that were read again is the last that the snapshot counts.
    fn number_recovered(&mut self) {
        let mut recovered = std::mem::take(&mut self.recovered);
        for (state, number) in &mut recovered {
            let counted = self.live.get(state.0 as usize).map_or(0, |live| live.observations);
            *number = counted.saturating_sub(*number);
        }
        if !recovered.is_empty() {
            self.pending.raise(&recovered);
        }
    }

    /// Publishes the view for readers from now on.
    pub fn publish(&mut self) -> MapView {
        for (index, dirty) in self.live_dirty.iter_mut().enumerate() {
            if !std::mem::take(dirty) {
                continue;
            }
            let from = index * LIVE_CHUNK;
            let chunk: Arc<[LiveState]> = self.live[from..self.live.len().min(from + LIVE_CHUNK)].into();
            match self.live_published.get_mut(index) {
                Some(published) => *published = chunk,
                None => self.live_published.push(chunk),
            }
        }
        MapView {
            spec: Arc::clone(&self.spec),
            position: self.position,
            generation: self.generation,
            cut_nanos: self.cut_nanos,
            observations: self.observations,
            pending: self.pending.total() + self.pending.future() + self.updating() + self.waiting_rows,
            ahead: self.pending.future(),
            waiting_rows: self.waiting_rows,
            newest_nanos: self.newest_nanos,
            has_rows: !self.with_rows.is_empty(),
            now_nanos: None,
            directory: self.directory.clone(),
            live: self.live_published.clone(),
            models: Arc::clone(&self.models),
            prior_models: self.prior_models.clone(),
            site: Arc::clone(&self.site),
            grid: self.grid.as_mut().map(GridView::new),
            edge_success: OnceLock::new(),
        }
    }
}
