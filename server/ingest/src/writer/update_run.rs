//! Updates of the map: they are started when they are due, run in a thread of their own, and are published when they
//! end.
//!
//! An update that leaves rows of changes or events to the next is a part of a job: the next part starts when it ends.
//!
//! Invariant: one update of a map runs at a time, and its job ends in every case.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, atomic::AtomicU64},
    time::{Duration, Instant},
};

use tidemap_grid::pace::Pace;
use tidemap_map::{
    event::{Event, UpdateCause},
    history::HistoryPiece,
    name::MapName,
    snapshot::MapSnapshot,
    update::{LateRowsOutcome, SumsUnavailable, UpdateResult, UpdateWork},
};
use tidemap_model::time::format_rfc3339;
use tidemap_store::MapId;
use tracing::{error, info, warn};

use super::{Context, Writer, appends::InFlight};
use crate::{
    jobs::{JobCause, UpdateJob, UpdateReport},
    protocol::Command,
    training_data::TrainingData,
    update_schedule::{DueUpdate, UpdateSchedule},
    update_turns::UpdateTurn,
};

#[cfg(test)]
mod tests;

/// Number of states above which an update waits for a save.
const STATES_BESIDE_SAVE_MAX: usize = 10_000;

/// Time for which updates wait after the log did not accept the start of one.
const UPDATE_RETRY: Duration = Duration::from_secs(10);

/// The reason why an update has no result.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the variants and fields")]
pub enum UpdateFailed {
    #[error("an update could not read its training data: {0}. Restore the folder of this map from a backup")]
    Sums(#[from] SumsUnavailable),
    #[error("the threads of an update could not start: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}

/// The pace of an update among those of other maps.
struct UpdatePace<'a> {
    done: &'a AtomicU64,
    turn: UpdateTurn,
}

impl Pace for UpdatePace<'_> {
    fn add_done(&self, parts: u64) {
        self.done.add_done(parts);
    }

    fn await_turn(&self) {
        self.turn.wait();
    }
}

/// The updates of a map: scheduled, running, and ended but not published.
pub(super) struct Updates {
    /// The waiting updates, and the data that makes new ones due.
    pub(super) schedule: UpdateSchedule,
    /// The job of the running update.
    running: Option<Arc<UpdateJob>>,
    /// The least time of the observations that the running update has, and its cut. Both are kept when the update
    /// fails, because it still has the observations.
    times: Option<(i64, i64)>,
    /// The time before which no update starts.
    wait_until: Option<Instant>,
    /// Jobs whose results the next view shows: generation and cut.
    ended: Vec<(Arc<UpdateJob>, (u64, i64))>,
}

impl Updates {
    pub(super) fn new(schedule: UpdateSchedule) -> Self {
        Self { schedule, running: None, times: None, wait_until: None, ended: Vec::new() }
    }

    /// Whether updates may start at `now`, as far as the last failure allows it.
    pub(super) fn may_start(&self, now: Instant) -> bool {
        self.wait_until.is_none_or(|until| until <= now)
    }

    /// The log did not accept the start of an update.
    pub(super) fn not_started(&mut self, cause: UpdateCause, now: Instant) {
        self.schedule.failed(cause);
        self.wait(now);
    }

    /// The log accepts no start or end of an update for now.
    pub(super) fn wait(&mut self, now: Instant) {
        self.wait_until = Some(now + UPDATE_RETRY);
    }

    /// This daemon writes the map from now on: updates are due as at a start.
    pub(super) fn become_due_again(&mut self) {
        self.schedule.begin_anew();
        self.wait_until = None;
    }

    /// Records that an update runs that has the observations from `from_nanos`, if any, to `cut_nanos`.
    fn begin(&mut self, job: &Arc<UpdateJob>, from_nanos: Option<i64>, cut_nanos: i64) {
        self.times = from_nanos.map(|from| (from, cut_nanos));
        self.running = Some(Arc::clone(job));
    }

    /// Records that the update has ended; its job ends when the view shows the generation.
    fn end(&mut self, job: &Arc<UpdateJob>, generation: u64, cut_nanos: i64) {
        self.running = None;
        self.times = None;
        self.ended.push((Arc::clone(job), (generation, cut_nanos)));
    }

    /// A part of the update has ended; the next part learns the rest at once.
    fn go_on(&mut self, next: DueUpdate) {
        self.running = None;
        self.times = None;
        self.schedule.push_first(next);
    }

    /// The update has failed.
    fn fail(&mut self, job: &UpdateJob, reason: String) {
        self.running = None;
        job.end(Err(reason));
    }

    /// Whether an update runs.
    pub(super) fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Whether the running update has observations from `from_nanos` up to but not including `to_nanos`.
    pub(super) fn has_times(&self, from_nanos: i64, to_nanos: i64) -> bool {
        self.times.is_some_and(|(from, cut)| from_nanos < cut && from < to_nanos)
    }

    /// Ends the jobs whose results are public now.
    pub(super) fn published(&mut self) {
        for (job, published) in self.ended.drain(..) {
            job.end(Ok(published));
        }
    }

    /// Fails all updates that wait or run.
    pub(super) fn fail_all(&mut self, reason: &str) {
        self.schedule.fail_all(reason);
        if let Some(job) = self.running.take() {
            job.end(Err(reason.to_owned()));
        }
    }
}

impl Context {
    /// Runs the update of a map. `unsaved`: history of earlier updates that no save has stored.
    ///
    /// Waits for its turn among the updates of other maps.
    ///
    /// # Errors
    /// [`UpdateFailed`] where a tile of the grid or the sums of a state cannot be read back from the disk, or no thread
    /// can be started.
    pub fn run_update(
        &self,
        id: MapId,
        map: &MapName,
        work: UpdateWork,
        unsaved: Vec<Arc<HistoryPiece>>,
        progress: &AtomicU64,
    ) -> Result<UpdateResult, UpdateFailed> {
        let pace = UpdatePace { done: progress, turn: self.update_turns.begin() };
        // The pool belongs to this update, because its threads wait while other updates have their turn.
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(self.update_turns.threads())
            .thread_name(|index| format!("learn-{index}"))
            .build()?;
        let work = work.with_readings_max(self.update_readings_max);
        let work = work.with_room(self.store.spectrum_room(id));
        let work = match self.store.history(id) {
            Ok(history) => {
                let training_data = TrainingData::before(work.start().generation, history, unsaved);
                work.with_readings(Arc::new(training_data))
            }
            Err(error) => {
                warn!(%map, %error, "history cannot be read: no model is trained again");
                work
            }
        };
        let result = pool.install(|| work.run(&pace))?;
        let outcome = result.training_outcome();
        if let Some(reason) = &outcome.failure {
            warn!(%map, states = outcome.failed, reason, "models are not trained again, because history cannot be read");
        }
        if outcome.waiting > 0 {
            info!(%map, trained = outcome.trained, waiting = outcome.waiting, "models wait to be trained at a later update");
        }
        report_late_rows(map, result.late_rows_outcome());
        Ok(result)
    }
}

fn report_late_rows(map: &MapName, outcome: &LateRowsOutcome) {
    let LateRowsOutcome { learned_anew, not_kept, beyond_bound, unreadable, failure } = outcome;
    if *learned_anew > 0 {
        info!(%map, states = learned_anew, "states are learned again, because some of their rows arrived late");
    }
    let singly = not_kept + beyond_bound + unreadable;
    if singly > 0 {
        let reason = failure.as_deref().unwrap_or_default();
        warn!(
            %map, states = singly, not_kept, beyond_bound, unreadable, reason,
            "late rows are learned as single readings: history does not keep all rows of their states, or one update \
             cannot learn more states again, or history cannot be read"
        );
    }
}

impl Writer {
    /// Whether an update may start or become due: never while the start of another one is in flight, or before the log
    /// contains the result of the one before. Only the writer of the map decides it.
    pub(super) fn may_update(&self) -> bool {
        self.stopping.is_none()
            && self.follower.is_writing()
            && !self.owes_update_end()
            && self.appends.failure().is_none()
            && self.updates.may_start(Instant::now())
            && !self.appends.is_update_starting()
    }

    pub(super) fn start_update(&mut self, now: i64) {
        if !self.has_room_for_update(self.updates.schedule.is_waited_for()) {
            return;
        }
        let Some(DueUpdate { until_nanos, cause, job }) = self.updates.schedule.pop() else { return };
        let event = Event::UpdateStart(self.map.plan_update(until_nanos, now, cause));
        self.append(InFlight::UpdateStart { event, job });
    }

    /// Whether an update that the log begins may run here: the one before must have ended, with its digest.
    pub(super) fn may_follow_update(&mut self) -> bool {
        !self.ends.is_computing() && self.has_room_for_update(true)
    }

    /// Whether no update runs and no save is in the way. `is_waited_for`: an update waits, so that a due save begins.
    fn has_room_for_update(&mut self, is_waited_for: bool) -> bool {
        // A save holds the data that the last update learned: a grid's sums would be copied if they changed meanwhile,
        // and with many states there is no memory for another generation.
        let is_large = self.map.grid().is_some() || self.map.states() > STATES_BESIDE_SAVE_MAX;
        let is_blocked_by_save = |writer: &Self| writer.saves.is_saving() && is_large;
        if self.map.is_updating() || is_blocked_by_save(self) {
            return false;
        }
        // A due save goes first, because there is no memory for its snapshot beside an update. A save that has failed
        // may fail again, and takes time: no update waits for it.
        if is_waited_for && self.saves.has_unsaved() && !self.saves.has_failed() && self.is_save_due() {
            self.save();
            if is_blocked_by_save(self) {
                return false;
            }
        }
        true
    }

    /// Repeats an update that the log had begun when the daemon ended. Its job is a new one: jobs are not stored.
    pub(super) fn repeat_update(&mut self, work: UpdateWork) {
        let now = self.context.clock.now_nanos();
        let job = self.context.jobs.create(self.map.spec().name.clone(), work.start().cause, now);
        info!(map = %self.map.spec().name, generation = work.start().generation, "an update is repeated");
        self.run_update(work, &job);
    }

    pub(super) fn run_update(&mut self, work: UpdateWork, job: &Arc<UpdateJob>) {
        // There is no memory beside the update for the snapshot that it replaces.
        self.saves.drop_unsaved();
        self.begin_digest(work.start().generation);
        job.start(work.states(), work.observations());
        job.step("learn");
        self.updates.begin(job, work.from_nanos(), work.start().cut_nanos);
        let commands = self.commands.clone();
        let (context, id, map) = (self.context.clone(), self.id, self.map.spec().name.clone());
        let for_thread = Arc::clone(job);
        // The history includes what a running save may not have written yet.
        let unsaved = self.saves.history().map(Arc::clone).collect();
        let spawned = std::thread::Builder::new().name(format!("update-{}", self.id.0)).spawn(move || {
            let progress = Arc::clone(&for_thread);
            // The data is moved, so that the store is released before the result is sent.
            let run = move || context.run_update(id, &map, work, unsaved, &progress.states_done);
            let result = match catch_unwind(AssertUnwindSafe(run)) {
                Ok(Ok(result)) => Ok(Box::new(result)),
                Ok(Err(failed)) => Err(failed.to_string()),
                Err(_) => Err("the update panicked; this is a defect of tidemap".to_owned()),
            };
            // Without a writer the result is not needed: the next start runs the update again from the log.
            let _ = commands.send(Command::UpdateDone { job: for_thread, result });
        });
        if let Err(error) = spawned {
            self.give_up(job, format!("the update of map {} could not start: {error}", self.map.spec().name));
        }
    }

    /// The log contains the start of the update, and there is no result: only a restart repeats it.
    fn give_up(&mut self, job: &Arc<UpdateJob>, reason: String) {
        error!(map = %self.map.spec().name, reason, "update failed");
        self.updates.fail(job, reason.clone());
        self.fatal(reason);
    }

    pub(super) fn update_done(&mut self, job: &Arc<UpdateJob>, result: Result<Box<UpdateResult>, String>) {
        let result = match result {
            Ok(result) => result,
            Err(reason) => return self.give_up(job, reason),
        };
        let (cells, rows_to_nanos) = (result.grid_outcome().copied(), result.rows_to_nanos());
        job.step("publish");
        self.context.jobs.add_report(job, UpdateReport { cells, states: result.outcomes().to_vec() });
        let states = result.outcomes().len();
        let tiles = cells.map_or(0, |cells| cells.tiles);
        let snapshot = self.map.finish_update(*result);
        self.changed = true;
        self.compute_digest(&snapshot);
        metrics::counter!("tidemap_updates_total").increment(1);
        info!(
            map = %self.map.spec().name, cause = job.cause.name(), generation = snapshot.generation, states, tiles,
            observations = job.status().observations, "updated"
        );
        self.end_update(job, &snapshot, rows_to_nanos);
        self.saves.push(snapshot);
        self.page_out();
    }

    /// Ends the job of an update, or lets its next part follow. `rows_to_nanos`: the end of the learned rows, if the
    /// update has left some. Only the writer of a map starts updates.
    fn end_update(&mut self, job: &Arc<UpdateJob>, snapshot: &MapSnapshot, rows_to_nanos: Option<i64>) {
        let next = rows_to_nanos.filter(|_| self.follower.is_writing() && self.stopping.is_none());
        let (Some(rows_to_nanos), JobCause::Update(cause)) = (next, job.cause) else {
            return self.updates.end(job, snapshot.generation, snapshot.cut_nanos);
        };
        info!(
            map = %self.map.spec().name, generation = snapshot.generation, waiting_rows = self.map.waiting_rows(),
            learned_to = format_rfc3339(rows_to_nanos),
            "rows of changes or events mean more readings than one update learns: another update follows"
        );
        self.updates.go_on(DueUpdate { until_nanos: Some(snapshot.cut_nanos), cause, job: Arc::clone(job) });
    }
}
