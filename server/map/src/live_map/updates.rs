//! Starts the updates of a map, and publishes their results.
//!
//! Invariant: the observations of an update are determined by the log position of its start and by its cut.

use std::{collections::BTreeMap, sync::Arc};

use tidemap_model::time::FUTURE_MAX_NANOS;

use super::{LiveMap, PendingLimits};
use crate::{
    event::{UpdateCause, UpdateStart},
    ids::StateId,
    live_state::Delivery,
    pending::Taken,
    snapshot::{MapSnapshot, StateSnapshot},
    update::{MapAtUpdate, UPDATE_READINGS_MAX, UpdateResult, UpdateWork},
    view::LIVE_CHUNK,
};

impl LiveMap {
    /// The start of an update for the log. `until_nanos`: learn older observations; `None`: all. Observations further
    /// in the future of `now_nanos` than [`FUTURE_MAX_NANOS`] always wait.
    pub fn plan_update(&self, until_nanos: Option<i64>, now_nanos: i64, cause: UpdateCause) -> UpdateStart {
        let latest = now_nanos.saturating_add(FUTURE_MAX_NANOS).saturating_add(1);
        let future = self.pending.newest_future_before(latest);
        let scans_ahead = self.grid.as_ref().and_then(|grid| grid.newest_future_before(latest));
        let all = || future.max(scans_ahead).unwrap_or(0).max(self.newest_nanos).saturating_add(1);
        let wanted = until_nanos.unwrap_or_else(all);
        UpdateStart { generation: self.generation + 1, cut_nanos: wanted.min(latest).max(self.cut_nanos), cause }
    }

    pub(super) fn start_update(&mut self, position: u64, start: UpdateStart) -> Result<UpdateWork, String> {
        if self.running.is_some() {
            return Err("another update has not ended".to_owned());
        }
        if start.generation != self.generation + 1 || start.cut_nanos < self.cut_nanos {
            return Err(format!("generation {} does not follow {}", start.generation, self.generation));
        }
        let Taken { by_state: samples, mut origins, were_ahead } = self.pending.take_before(start.cut_nanos);
        for ((state, _), origins) in samples.iter().zip(&mut origins).filter(|(_, origins)| origins.ahead > 0) {
            origins.arrived = self.live.get(state.0 as usize).map_or(0, |live| live.observations);
        }
        for (state, sample, producer) in were_ahead {
            // The time of these observations has come: from here on they are treated like all others.
            let (index, reporting) = (state.0 as usize, self.reporting(state));
            if let Some(live) = self.live.get_mut(index) {
                let arrival = Delivery { producer, received_nanos: sample.utc_nanos };
                live.observe_row(reporting, &sample, arrival);
                self.live_dirty[index / LIVE_CHUNK] = true;
            }
            self.newest_nanos = self.newest_nanos.max(sample.utc_nanos);
            self.note_newest_time(producer, sample.utc_nanos);
        }
        let grid = self.grid.as_mut().map(|grid| {
            let before = grid.pending_changes();
            let (work, basis, newest) =
                grid.start_update(start.cut_nanos, &self.spec.periodicities, self.spec.criterion);
            self.newest_nanos = self.newest_nanos.max(newest.unwrap_or(0));
            (work, basis, before.saturating_sub(grid.pending_changes()))
        });
        let observations = samples.iter().map(|(_, samples)| samples.len() as u64).sum::<u64>();
        let changes = grid.as_ref().map_or(0, |(_, _, changes)| *changes);
        self.running = Some((start, PendingLimits { observations, changes }));
        let (grid_work, mut grid_basis) = grid.map(|(work, basis, _)| (work, basis)).unzip();
        if self.pending() == 0 && self.future() == 0 {
            self.pending.all_taken();
        }
        if let Some(basis) = &mut grid_basis {
            basis.received_nanos = self.pending.received_nanos();
        }
        let horizons = self.horizons(start.cut_nanos);
        let basis = MapAtUpdate {
            start,
            position,
            replay_from: self.pending.replay_from(position + 1),
            newest_nanos: self.newest_nanos,
            producers: self.producers.clone(),
            directory: self.directory.clone(),
            live: self.live.clone(),
            site: Arc::clone(&self.site),
            grid: grid_basis,
        };
        Ok(UpdateWork {
            basis,
            spec: Arc::clone(&self.spec),
            models: Arc::clone(&self.models),
            prior_models: self.prior_models.clone(),
            samples,
            origins,
            horizons,
            grid: grid_work,
            readings: None,
            room: None,
            readings_max: UPDATE_READINGS_MAX,
        })
    }

    /// For each state that reports changes or events: the time up to which its rows are known to be complete,
    /// exclusive, because its producer has sent an observation of that time, of this or another state.
    fn horizons(&self, cut_nanos: i64) -> BTreeMap<StateId, i64> {
        let horizon = |&id: &StateId| {
            let newest = self.live.get(id.0 as usize)?.newest_row?;
            let mark = self.producers.get(newest.producer.0 as usize)?;
            Some((id, mark.newest_nanos.min(cut_nanos)))
        };
        self.with_rows.iter().filter_map(horizon).collect()
    }

    /// Publishes what an update learned as the new generation. Returns the snapshot for the store.
    pub fn finish_update(&mut self, result: UpdateResult) -> MapSnapshot {
        let UpdateResult { basis, models, grid, history, .. } = result;
        self.running = None;
        self.generation = basis.start.generation;
        self.cut_nanos = basis.start.cut_nanos;
        self.models = Arc::clone(&models);
        self.waiting_rows = self.count_waiting_rows();
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
                recent: live.recent,
                newest_row: live.newest_row,
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
            site: basis.site,
            grid,
            history: history.map(Arc::new).into_iter().collect(),
        }
    }
}
