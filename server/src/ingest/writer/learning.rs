//! The writer's updates: started when they are due, run elsewhere, published when they are back.
//!
//! Invariant: one update is out at a time, and its job ends, whatever happens to it.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, atomic::AtomicU64},
    time::Instant,
};

use tidemap_map::{
    event::Event,
    grid::tile::TileUnavailable,
    history::HistoryPiece,
    name::MapName,
    update::{UpdateResult, UpdateWork},
};
use tidemap_store::MapId;
use tracing::{error, info, warn};

use super::{Command, Context, Flight, Job, Wanted, Writer};
use crate::{ingest::folded::Folded, jobs::Report};

impl Context {
    /// Runs the update of a map, from where an earlier run of it was cut off. `unsaved`: what the updates before have folded
    /// in and no save has kept yet.
    ///
    /// # Errors
    /// [`TileUnavailable`] where a tile of the grid cannot be read back from the disk.
    pub fn run_update(
        &self,
        id: MapId,
        map: &MapName,
        work: UpdateWork,
        unsaved: Vec<Arc<HistoryPiece>>,
        progress: &AtomicU64,
    ) -> Result<UpdateResult, TileUnavailable> {
        let work = match self.store.history(id) {
            Ok(history) => {
                let folded = Folded::before(work.start().generation, history, unsaved);
                work.with_readings(Arc::new(folded))
            }
            Err(error) => {
                warn!(%map, %error, "no model is fitted again");
                work
            }
        };
        let result = self.run_noting(id, map, work, progress)?;
        let refits = result.refits();
        if let Some(reason) = &refits.failure {
            warn!(%map, states = refits.failed, reason, "models are not fitted again, because history cannot be read");
        }
        if refits.waiting > 0 {
            info!(%map, fitted = refits.fitted, waiting = refits.waiting, "models wait to be fitted at a later update");
        }
        Ok(result)
    }

    /// Runs an update, and notes what it does where that takes long.
    fn run_noting(
        &self,
        id: MapId,
        map: &MapName,
        work: UpdateWork,
        progress: &AtomicU64,
    ) -> Result<UpdateResult, TileUnavailable> {
        let file = if work.has_tiles() { self.store.update_file(id, &work.identity()).map(Some) } else { Ok(None) };
        let file = file.unwrap_or_else(|error| {
            warn!(%map, %error, "what the update does is not noted");
            None
        });
        let Some(file) = file else { return self.update_pool.install(|| work.run(progress)) };
        if file.resumed() > 0 {
            let (tiles, generation) = (file.resumed(), work.start().generation);
            info!(%map, generation, tiles, of = work.states(), "going on with an update that was cut off");
        }
        self.update_pool.install(|| work.run_noting(progress, &file, self.update_journal_min_work))
    }
}

impl Writer {
    /// Whether an update can be started or made due: never while another is on its way into the log.
    pub(super) fn may_update(&self) -> bool {
        self.stopping.is_none()
            && self.failing.is_none()
            && self.updates_wait_until.is_none_or(|until| until <= Instant::now())
            && !self.is_update_starting()
    }

    pub(super) fn start_update(&mut self, now: i64) {
        // A save holds what the last update learned: a grid's sums would have to be copied to change them meanwhile.
        if self.map.is_updating() || (self.saving && self.map.grid().is_some()) {
            return;
        }
        // What is due goes first, and beside an update there is no room for what waits. What has failed before may fail
        // again, and takes its time: no update waits for that.
        if self.updates.is_waited_for() && self.unsaved.is_some() && self.save_failures == 0 && self.is_save_due() {
            self.save();
            if self.saving && self.map.grid().is_some() {
                return;
            }
        }
        let Some(Wanted { until_nanos, cause, job }) = self.updates.pop() else { return };
        let event = Event::UpdateStart(self.map.plan_update(until_nanos, now, cause));
        self.launch(Flight::UpdateStart { event, job });
    }

    /// Runs an update again that the log had begun when the daemon ended. Its job is a new one: jobs are not kept.
    pub(super) fn repeat_update(&mut self, work: UpdateWork) {
        let now = self.context.clock.now_nanos();
        let job = self.context.jobs.create(self.map.spec().name.clone(), work.start().cause, now);
        info!(map = %self.map.spec().name, generation = work.start().generation, "an update is repeated");
        self.run_update(work, &job);
    }

    pub(super) fn run_update(&mut self, work: UpdateWork, job: &Arc<Job>) {
        // Beside the update there is no room for what it replaces.
        self.drop_unsaved();
        job.start(work.states(), work.observations());
        self.updating_times = work.from_nanos().map(|from| (from, work.start().cut_nanos));
        self.running_job = Some(Arc::clone(job));
        let commands = self.commands.clone();
        let (context, id, map) = (self.context.clone(), self.id, self.map.spec().name.clone());
        let for_thread = Arc::clone(job);
        // Its snapshot was dropped above. What a running save keeps may not be in files yet.
        let unsaved = self.unsaved_history.iter().chain(&self.saving_history).map(Arc::clone).collect();
        let spawned = std::thread::Builder::new().name(format!("update-{}", self.id.0)).spawn(move || {
            let progress = Arc::clone(&for_thread);
            // Moved, so that the store is let go of before the result is on its way.
            let run = move || context.run_update(id, &map, work, unsaved, &progress.states_done);
            let result = match catch_unwind(AssertUnwindSafe(run)) {
                Ok(Ok(result)) => Ok(Box::new(result)),
                Ok(Err(unavailable)) => Err(format!(
                    "an update could not read what it learns from: {unavailable}. Restore the folder of this map from a backup"
                )),
                Err(_) => Err("the update panicked; this is a defect of tidemap".to_owned()),
            };
            // Without a writer there is nobody to take the result; the log gives it back at the next start.
            let _ = commands.send(Command::UpdateDone { job: for_thread, result });
        });
        if let Err(error) = spawned {
            self.give_up(job, format!("the update of map {} could not start: {error}", self.map.spec().name));
        }
    }

    /// The log says that the update started, and it has no result: only a restart repeats it.
    fn give_up(&mut self, job: &Arc<Job>, reason: String) {
        error!(map = %self.map.spec().name, reason, "update failed");
        self.running_job = None;
        job.end(Err(reason.clone()));
        self.fatal(reason);
    }

    pub(super) fn update_done(&mut self, job: &Arc<Job>, result: Result<Box<UpdateResult>, String>) {
        let result = match result {
            Ok(result) => result,
            Err(reason) => return self.give_up(job, reason),
        };
        self.running_job = None;
        self.updating_times = None;
        let cells = result.grid_outcome().copied();
        self.context.jobs.set_report(job, Report { cells, states: result.outcomes().to_vec() });
        let states = result.outcomes().len();
        let tiles = cells.map_or(0, |cells| cells.tiles);
        let snapshot = self.map.finish_update(*result);
        self.changed = true;
        metrics::counter!("tidemap_updates_total").increment(1);
        info!(
            map = %self.map.spec().name, cause = ?job.cause, generation = snapshot.generation, states, tiles,
            observations = job.status().observations, "updated"
        );
        self.ended_jobs.push((Arc::clone(job), Ok((snapshot.generation, snapshot.cut_nanos))));
        self.keep_unsaved(snapshot);
        self.page_out();
    }
}
