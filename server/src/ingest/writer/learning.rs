//! The writer's updates: started when they are due, run elsewhere, published when they are back, saved behind that.
//!
//! Invariant: one update is out at a time, and its job ends, whatever happens to it. A snapshot that is not saved costs
//! nothing but time at the next start.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
    time::Instant,
};

use tidemap_map::{
    event::Event,
    snapshot::MapSnapshot,
    update::{UpdateResult, UpdateWork},
};
use tracing::{error, info, warn};

use super::{Command, Flight, Job, Wanted, Writer};

impl Writer {
    /// Whether an update can be started or made due: never while another is on its way into the log.
    pub(super) fn may_update(&self) -> bool {
        self.stopping.is_none()
            && self.failing.is_none()
            && self.updates_wait_until.is_none_or(|until| until <= Instant::now())
            && !self.flights.iter().any(|flight| matches!(flight, Flight::UpdateStart { .. }))
    }

    pub(super) fn start_update(&mut self, now: i64) {
        if self.map.is_updating() {
            return;
        }
        let Some(Wanted { until_nanos, cause, job }) = self.updates.pop() else { return };
        let event = Event::UpdateStart(self.map.plan_update(until_nanos, now, cause));
        self.launch(Flight::UpdateStart { event, job });
    }

    pub(super) fn run_update(&mut self, work: UpdateWork, job: &Arc<Job>) {
        job.start(work.states(), work.observations());
        self.running_job = Some(Arc::clone(job));
        let commands = self.commands.clone();
        let pool = Arc::clone(&self.context.update_pool);
        let for_thread = Arc::clone(job);
        let spawned = std::thread::Builder::new().name(format!("update-{}", self.id.0)).spawn(move || {
            let run = || pool.install(|| work.run(&for_thread.states_done));
            let result = catch_unwind(AssertUnwindSafe(run)).map(Box::new);
            let result = result.map_err(|_| "the update panicked; this is a defect of tidemap".to_owned());
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
        self.context.jobs.set_report(job, result.outcomes().to_vec());
        let states = result.outcomes().len();
        let snapshot = self.map.finish_update(*result);
        self.changed = true;
        metrics::counter!("tidemap_updates_total").increment(1);
        info!(
            map = %self.map.spec().name, cause = ?job.cause, generation = snapshot.generation, states,
            observations = job.status().observations, "updated"
        );
        self.ended_jobs.push((Arc::clone(job), Ok((snapshot.generation, snapshot.cut_nanos))));
        self.unsaved = Some(snapshot);
    }

    pub(super) fn save(&mut self) {
        if self.saving {
            return;
        }
        let Some(snapshot) = self.unsaved.take() else { return };
        let (store, id, commands) = (Arc::clone(&self.context.store), self.id, self.commands.clone());
        let spawned = std::thread::Builder::new().name(format!("save-{}", id.0)).spawn(move || {
            let saved = catch_unwind(AssertUnwindSafe(|| store.save(id, &snapshot)));
            let saved = match saved {
                Ok(Ok(())) => Ok(()),
                Ok(Err(error)) => Err((error.to_string(), snapshot)),
                Err(_) => Err(("saving panicked; this is a defect of tidemap".to_owned(), snapshot)),
            };
            // At a stop nobody waits: the log gives back what is not saved.
            let _ = commands.send(Command::Saved(saved));
        });
        match spawned {
            Ok(_) => self.saving = true,
            Err(error) => warn!(%error, "no thread to save a checkpoint; the next update tries again"),
        }
    }

    pub(super) fn saved(&mut self, result: Result<(), (String, MapSnapshot)>) {
        self.saving = false;
        self.last_save = Some(Instant::now());
        if let Err((error, snapshot)) = result {
            warn!(map = %self.map.spec().name, error, "checkpoint not saved; the log keeps everything, tried again");
            // A newer one is better.
            self.unsaved.get_or_insert(snapshot);
        }
    }
}
