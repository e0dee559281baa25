//! A map as its single writer holds it: events go in, views come out.
//!
//! Invariant: the state is a function of the events applied and their order. Nothing here waits: an update is taken out
//! as [`UpdateWork`], run elsewhere while observations go on, and brought back with [`LiveMap::finish_update`]; at most
//! one is out at a time.

use std::{collections::HashMap, sync::Arc};

use tidemap_model::StateModel;

use crate::{
    MAX_AHEAD_NANOS,
    directory::{Directory, StateInfo},
    event::{Event, Observations, ProducerId, StateId, UpdateStart},
    grid::{live::LiveGrid, scan::Scans, view::GridView},
    name::ProducerKey,
    pending::{Pending, Taken},
    snapshot::{MapSnapshot, ProducerMark, StateSnapshot},
    spec::MapSpec,
    update::{Basis, UpdateResult, UpdateWork},
    view::{LIVE_CHUNK, LiveState, MapView},
};

#[cfg(test)]
mod tests;

/// An event does not follow from the events before it: the log is not what this map wrote.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("event at log position {position} does not fit the map: {reason}")]
pub struct InconsistentEvent {
    /// Log position of the event.
    pub position: u64,
    /// What does not fit.
    pub reason: String,
}

/// How an event moves its producer's mark on.
struct Advance<'a> {
    producer: ProducerId,
    new_producer: Option<&'a ProducerKey>,
    incarnation: u64,
    first_sequence: u64,
    last_sequence: u64,
    content_crc: u32,
}

/// A map that takes events.
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
    directory: Directory,
    live: Vec<LiveState>,
    live_published: Vec<Arc<[LiveState]>>,
    live_dirty: Vec<bool>,
    models: Arc<Vec<Arc<StateModel>>>,
    unlearned: Arc<StateModel>,
    pending: Pending,
    grid: Option<LiveGrid>,
    /// The update that is out: where it started, and how many observations it took.
    running: Option<(UpdateStart, u64)>,
}

impl LiveMap {
    /// An empty map.
    #[must_use]
    pub fn new(spec: Arc<MapSpec>) -> Self {
        let unlearned = Arc::new(StateModel::new(&spec.periodicities));
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
            directory: Directory::new(),
            live: Vec::new(),
            live_published: Vec::new(),
            live_dirty: Vec::new(),
            models: Arc::new(Vec::new()),
            unlearned,
            pending: Pending::default(),
            grid,
            running: None,
        }
    }

    /// The map as it was when the snapshot was taken, but for its pending observations: replay the events from
    /// `snapshot.replay_from` on to get them back.
    #[must_use]
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
            map.add_state(StateInfo { name: state.name, kind: state.kind });
            if let Some(live) = map.live.last_mut() {
                *live = LiveState { observations: state.observations, persistence: state.persistence };
            }
            map.observations += state.observations;
            models.push(state.model);
        }
        map.models = Arc::new(models);
        if let Some(grid) = snapshot.grid {
            map.grid = map.grid.map(|empty| LiveGrid::restore(empty.spec, grid));
        }
        map
    }

    /// The fixed properties of the map.
    #[must_use]
    pub fn spec(&self) -> &Arc<MapSpec> {
        &self.spec
    }

    /// Position of the last event applied; 0 before the first.
    #[must_use]
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Number of states.
    #[must_use]
    pub fn states(&self) -> usize {
        self.directory.len()
    }

    /// The state of this name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<StateId> {
        self.directory.find(name)
    }

    /// The producer of this key, if it ever sent anything.
    #[must_use]
    pub fn producer(&self, key: &ProducerKey) -> Option<(ProducerId, &ProducerMark)> {
        let id = *self.producer_ids.get(key)?;
        self.producers.get(id.0 as usize).map(|mark| (id, mark))
    }

    /// Number of producer keys.
    #[must_use]
    pub fn producers(&self) -> usize {
        self.producers.len()
    }

    /// The grid, where the map has one.
    #[must_use]
    pub fn grid(&self) -> Option<&LiveGrid> {
        self.grid.as_ref()
    }

    /// Observations that an update could fold in, those of a running one not counted. Of scans the changes count, which
    /// are what is held in memory.
    #[must_use]
    pub fn pending(&self) -> u64 {
        self.pending.total() + self.grid.as_ref().map_or(0, |grid| grid.pending_changes)
    }

    /// Observations and scans that wait because their time is too far ahead.
    #[must_use]
    pub fn ahead(&self) -> u64 {
        self.pending.ahead() + self.grid.as_ref().map_or(0, LiveGrid::ahead)
    }

    /// Observations that a running update has taken.
    #[must_use]
    pub fn updating(&self) -> u64 {
        self.running.map_or(0, |(_, taken)| taken)
    }

    /// The least time of the pending observations, nanoseconds UTC, or less.
    #[must_use]
    pub fn pending_since_nanos(&self) -> Option<i64> {
        let scans = self.grid.as_ref().and_then(|grid| grid.oldest_pending_nanos);
        [self.pending.oldest_nanos(), scans].into_iter().flatten().min()
    }

    /// When the first of the pending observations was received, or earlier; nanoseconds UTC of the server's clock.
    #[must_use]
    pub fn pending_received_nanos(&self) -> Option<i64> {
        self.pending.received_nanos()
    }

    /// Greatest time of any observation that did not have to wait, nanoseconds UTC; 0 where there is none.
    #[must_use]
    pub fn newest_nanos(&self) -> i64 {
        self.newest_nanos
    }

    /// Cut of the last update, nanoseconds UTC; 0 before the first.
    #[must_use]
    pub fn cut_nanos(&self) -> i64 {
        self.cut_nanos
    }

    /// Whether an update is out.
    #[must_use]
    pub fn is_updating(&self) -> bool {
        self.running.is_some()
    }

    /// The start of an update as the log is to hold it. `until_nanos`: fold in what is older; `None`: all there is.
    /// Observations further ahead of `now_nanos` than [`MAX_AHEAD_NANOS`] always wait.
    #[must_use]
    pub fn plan_update(
        &self,
        until_nanos: Option<i64>,
        now_nanos: i64,
        cause: crate::event::UpdateCause,
    ) -> UpdateStart {
        let latest = now_nanos.saturating_add(MAX_AHEAD_NANOS).saturating_add(1);
        let ahead = self.pending.newest_ahead_before(latest);
        let scans_ahead = self.grid.as_ref().and_then(|grid| grid.newest_ahead_before(latest));
        let all = || ahead.max(scans_ahead).unwrap_or(0).max(self.newest_nanos).saturating_add(1);
        let wanted = until_nanos.unwrap_or_else(all);
        UpdateStart { generation: self.generation + 1, cut_nanos: wanted.min(latest).max(self.cut_nanos), cause }
    }

    /// Applies the event at the next log position. An update's start gives the work to run and bring back.
    ///
    /// # Errors
    /// [`InconsistentEvent`] where the event cannot follow the events before it; the map is then unusable.
    pub fn apply(&mut self, position: u64, event: &Event) -> Result<Option<UpdateWork>, InconsistentEvent> {
        let inconsistent = |reason: String| InconsistentEvent { position, reason };
        if position != self.position + 1 {
            return Err(inconsistent(format!("the position before it should be {}", self.position)));
        }
        let work = match event {
            Event::Observations(observations) => {
                self.take_in(position, observations).map_err(inconsistent)?;
                None
            }
            Event::Scans(scans) => {
                self.take_in_scans(scans).map_err(inconsistent)?;
                None
            }
            Event::UpdateStart(start) => Some(self.start_update(position, *start).map_err(inconsistent)?),
        };
        self.position = position;
        Ok(work)
    }

    /// Takes back, after a restore, the pending observations of an event that the snapshot covers.
    ///
    /// # Errors
    /// [`InconsistentEvent`] where the event names states that the snapshot lacks.
    pub fn recover_pending(&mut self, position: u64, event: &Event) -> Result<(), InconsistentEvent> {
        if let Event::Observations(observations) = event {
            for (state, sample) in observations.samples() {
                if sample.utc_nanos < self.cut_nanos {
                    continue;
                }
                if state.0 as usize >= self.live.len() {
                    let reason = format!("state {} is unknown", state.0);
                    return Err(InconsistentEvent { position, reason });
                }
                if sample.utc_nanos <= observations.plausible_nanos() {
                    self.pending.push(position, state, sample);
                } else {
                    self.pending.push_ahead(position, state, sample);
                }
                self.pending.received(observations.received_nanos);
            }
        }
        Ok(())
    }

    fn add_producer(&mut self, mark: ProducerMark) {
        let id = ProducerId(u32::try_from(self.producers.len()).unwrap_or(u32::MAX));
        self.producer_ids.insert(mark.key.clone(), id);
        self.producers.push(mark);
    }

    fn add_state(&mut self, info: StateInfo) {
        self.directory.push(info);
        self.live.push(LiveState::default());
        self.live_dirty.resize(self.live.len().div_ceil(LIVE_CHUNK), true);
        if let Some(dirty) = self.live_dirty.last_mut() {
            *dirty = true;
        }
    }

    /// Moves a producer's mark on.
    fn advance(&mut self, event: &Advance<'_>) -> Result<(), String> {
        if let Some(key) = event.new_producer {
            if event.producer.0 as usize != self.producers.len() || self.producer_ids.contains_key(key) {
                return Err(format!("producer {} is not new", event.producer.0));
            }
            self.add_producer(ProducerMark { key: key.clone(), incarnation: 0, durable_sequence: 0, content_crc: 0 });
        }
        let mark =
            self.producers.get_mut(event.producer.0 as usize).ok_or("it names an unknown producer".to_owned())?;
        if event.first_sequence != mark.durable_sequence + 1 || event.last_sequence < event.first_sequence {
            return Err(format!(
                "its sequence {}..={} does not follow {}",
                event.first_sequence, event.last_sequence, mark.durable_sequence
            ));
        }
        mark.incarnation = mark.incarnation.max(event.incarnation);
        mark.durable_sequence = event.last_sequence;
        mark.content_crc = event.content_crc;
        Ok(())
    }

    fn take_in_scans(&mut self, event: &Scans) -> Result<(), String> {
        self.grid.as_ref().ok_or("the map has no grid")?.check(event)?;
        self.advance(&Advance {
            producer: event.producer,
            new_producer: event.new_producer.as_ref(),
            incarnation: event.incarnation,
            first_sequence: event.first_sequence,
            last_sequence: event.last_sequence,
            content_crc: event.content_crc,
        })?;
        if let Some(grid) = &mut self.grid {
            self.newest_nanos = self.newest_nanos.max(grid.take_in(event).unwrap_or(0));
        }
        if !event.scans.is_empty() {
            self.pending.received(event.received_nanos);
        }
        Ok(())
    }

    fn take_in(&mut self, position: u64, event: &Observations) -> Result<(), String> {
        self.advance(&Advance {
            producer: event.producer,
            new_producer: event.new_producer.as_ref(),
            incarnation: event.incarnation,
            first_sequence: event.first_sequence,
            last_sequence: event.last_sequence,
            content_crc: event.content_crc,
        })?;
        for new in &event.new_states {
            if new.id.0 as usize != self.directory.len() || self.directory.find(new.name.as_str()).is_some() {
                return Err(format!("state {:?} is not new", new.name.as_str()));
            }
            self.add_state(StateInfo { name: new.name.clone(), kind: new.kind });
        }
        let plausible = event.plausible_nanos();
        for (state, sample) in event.samples() {
            let index = state.0 as usize;
            let live = self.live.get_mut(index).ok_or_else(|| format!("state {index} is unknown"))?;
            live.observations += 1;
            self.live_dirty[index / LIVE_CHUNK] = true;
            if sample.utc_nanos <= plausible {
                live.persistence.observe(sample.utc_nanos, sample.value);
                self.newest_nanos = self.newest_nanos.max(sample.utc_nanos);
                self.pending.push(position, state, sample);
            } else {
                self.pending.push_ahead(position, state, sample);
            }
        }
        if !event.states.is_empty() {
            self.pending.received(event.received_nanos);
        }
        self.observations += event.states.len() as u64;
        Ok(())
    }

    fn start_update(&mut self, position: u64, start: UpdateStart) -> Result<UpdateWork, String> {
        if self.running.is_some() {
            return Err("another update has not ended".to_owned());
        }
        if start.generation != self.generation + 1 || start.cut_nanos < self.cut_nanos {
            return Err(format!("generation {} does not follow {}", start.generation, self.generation));
        }
        let Taken { by_state: samples, were_ahead } = self.pending.take_before(start.cut_nanos);
        for (state, sample) in were_ahead {
            // Their time has come: from here on they are observations like all others.
            let index = state.0 as usize;
            if let Some(live) = self.live.get_mut(index) {
                live.persistence.observe(sample.utc_nanos, sample.value);
                self.live_dirty[index / LIVE_CHUNK] = true;
            }
            self.newest_nanos = self.newest_nanos.max(sample.utc_nanos);
        }
        let grid = self.grid.as_mut().map(|grid| {
            let before = grid.pending_changes;
            let (work, basis, newest) =
                grid.start_update(start.cut_nanos, &self.spec.periodicities, self.spec.criterion);
            self.newest_nanos = self.newest_nanos.max(newest.unwrap_or(0));
            (work, basis, before.saturating_sub(grid.pending_changes))
        });
        let taken = samples.iter().map(|(_, samples)| samples.len() as u64).sum::<u64>();
        self.running = Some((start, taken + grid.as_ref().map_or(0, |(_, _, changes)| *changes)));
        let (grid_work, grid_basis) = grid.map(|(work, basis, _)| (work, basis)).unzip();
        if self.pending() == 0 && self.ahead() == 0 {
            self.pending.all_taken();
        }
        let basis = Basis {
            start,
            position,
            replay_from: self.pending.replay_from(position + 1),
            newest_nanos: self.newest_nanos,
            producers: self.producers.clone(),
            directory: self.directory.clone(),
            live: self.live.clone(),
            grid: grid_basis,
        };
        Ok(UpdateWork {
            basis,
            spec: Arc::clone(&self.spec),
            models: Arc::clone(&self.models),
            unlearned: Arc::clone(&self.unlearned),
            samples,
            grid: grid_work,
        })
    }

    /// Publishes what an update learned: one generation replaces another. Gives the snapshot for the store.
    pub fn finish_update(&mut self, result: UpdateResult) -> MapSnapshot {
        let UpdateResult { basis, models, grid, history, .. } = result;
        self.running = None;
        self.generation = basis.start.generation;
        self.cut_nanos = basis.start.cut_nanos;
        self.models = Arc::clone(&models);
        let states = basis
            .directory
            .iter()
            .zip(&basis.live)
            .zip(models.iter())
            .map(|((info, live), model)| StateSnapshot {
                name: info.name.clone(),
                kind: info.kind,
                observations: live.observations,
                persistence: live.persistence,
                model: Arc::clone(model),
            })
            .collect();
        let grid = self
            .grid
            .as_mut()
            .zip(basis.grid)
            .zip(grid)
            .map(|((live, basis), learned)| live.finish_update(basis, learned.generation, learned.sums));
        MapSnapshot {
            position: basis.position,
            replay_from: basis.replay_from,
            generation: self.generation,
            cut_nanos: self.cut_nanos,
            newest_nanos: basis.newest_nanos,
            producers: basis.producers,
            states,
            grid,
            history: history.map(Arc::new).into_iter().collect(),
        }
    }

    /// The map as readers are to see it from now on.
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
            pending: self.pending.total() + self.pending.ahead() + self.updating(),
            directory: self.directory.clone(),
            live: self.live_published.clone(),
            models: Arc::clone(&self.models),
            unlearned: Arc::clone(&self.unlearned),
            grid: self.grid.as_mut().map(|grid| GridView::new(grid)),
        }
    }
}
