//! Updates, erasures and scheduled backups as jobs that can be listed, watched and reported.
//!
//! Invariant: a job only moves forward: waiting, running, ended. Old jobs are forgotten; only the last update of each
//! map keeps its report.

use std::{
    collections::{HashMap, VecDeque},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use tidemap_base::telemetry::traces::Span;
use tidemap_grid::outcome::GridOutcome;
use tidemap_map::{
    event::UpdateCause,
    name::{MapName, StateName},
    update::StateOutcome,
};
use tokio::sync::watch;

const JOBS_KEPT: usize = 1000;

/// The cause of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobCause {
    /// The cause of an update.
    Update(UpdateCause),
    /// A request to erase something.
    Erasure,
    /// The schedule of backups.
    Backup,
}

impl JobCause {
    /// Name of the cause, for the log.
    pub fn name(self) -> &'static str {
        match self {
            Self::Update(UpdateCause::Request) => "request",
            Self::Update(UpdateCause::Midnight) => "midnight",
            Self::Update(UpdateCause::DataTime) => "midnight in data time",
            Self::Update(UpdateCause::PendingLimit) => "limit of pending observations",
            Self::Erasure => "erasure",
            Self::Backup => "backup",
        }
    }
}

impl From<UpdateCause> for JobCause {
    fn from(cause: UpdateCause) -> Self {
        Self::Update(cause)
    }
}

/// The progress of a job.
#[derive(Clone, Debug, PartialEq)]
pub enum Phase {
    /// The job waits for another job of the same map.
    Waiting,
    /// The job runs since this instant.
    Running(Instant),
    /// The job ended successfully, after this time.
    Done(Duration),
    /// The job failed, after this time.
    Failed(Duration, String),
}

impl Phase {
    /// Whether the job has ended.
    pub fn has_ended(&self) -> bool {
        matches!(self, Self::Done(_) | Self::Failed(..))
    }
}

/// The status of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct JobStatus {
    /// The phase of the job.
    pub phase: Phase,
    /// States and tiles with observations to learn.
    pub states_total: u64,
    /// Observations and scans to learn.
    pub observations: u64,
    /// The published generation and its cut.
    pub published: Option<(u64, i64)>,
}

impl JobCause {
    /// The name of the work, for the job's span.
    fn span_name(self) -> &'static str {
        match self {
            Self::Update(_) => "update",
            Self::Erasure => "erasure",
            Self::Backup => "backup",
        }
    }
}

/// An update, an erasure or a backup.
#[derive(Debug)]
pub struct UpdateJob {
    /// Number of the job.
    pub id: u64,
    /// The map of the job; `None`: all maps.
    pub map: Option<MapName>,
    /// The cause of the update.
    pub cause: JobCause,
    /// Time of the request, nanoseconds UTC.
    pub created_nanos: i64,
    /// States and tiles done so far.
    pub states_done: AtomicU64,
    status: watch::Sender<JobStatus>,
    /// The job as a span.
    span: Span,
    /// The current step, as a part of the span. It has a lock, because steps begin in several threads; the lock is held
    /// only to replace a pointer.
    step: Mutex<Span>,
    // The report has a lock, because it is dropped when the map's next update ends; the lock is held only to copy a
    // pointer.
    report: Mutex<Option<Arc<UpdateReport>>>,
}

/// The result of an update.
#[derive(Clone, Debug, Default)]
pub struct UpdateReport {
    /// The result for all cells of the grid together.
    pub cells: Option<GridOutcome>,
    /// The result for each state that had observations.
    pub states: Vec<StateOutcome>,
}

impl UpdateReport {
    /// The combined result of two updates, one after the other.
    fn followed_by(mut self, later: UpdateReport) -> UpdateReport {
        let mut places: HashMap<StateName, usize> = HashMap::with_capacity(self.states.len());
        places.extend(self.states.iter().enumerate().map(|(place, state)| (state.name.clone(), place)));
        for state in later.states {
            match places.get(&state.name).and_then(|place| self.states.get_mut(*place)) {
                Some(known) => {
                    known.outcome.add(&state.outcome);
                    known.chosen = state.chosen;
                }
                None => self.states.push(state),
            }
        }
        self.cells = later.cells.filter(|cells| cells.scans > 0).or(self.cells);
        self
    }
}

impl UpdateJob {
    /// The name of the job's map; empty: all maps.
    pub fn map_name(&self) -> &str {
        self.map.as_ref().map_or("", MapName::as_str)
    }

    /// The current status.
    pub fn status(&self) -> JobStatus {
        self.status.borrow().clone()
    }

    /// Whether the job has ended.
    pub fn has_ended(&self) -> bool {
        self.status.borrow().phase.has_ended()
    }

    /// A receiver of the job's status.
    pub fn watch(&self) -> watch::Receiver<JobStatus> {
        self.status.subscribe()
    }

    /// Begins the next step, which ends the one before.
    pub fn step(&self, name: &'static str) {
        let next = self.span.child(name);
        let last = std::mem::replace(&mut *self.step.lock().unwrap_or_else(PoisonError::into_inner), next);
        last.end();
    }

    /// Marks the job as running. If the job runs already, these amounts are added to its work.
    pub fn start(&self, states: u64, observations: u64) {
        self.status.send_modify(|status| {
            if status.phase == Phase::Waiting {
                status.phase = Phase::Running(Instant::now());
            }
            status.states_total += states;
            status.observations += observations;
        });
    }

    /// Corrects the amounts of a running job.
    pub fn count(&self, states_total: u64, observations: u64) {
        self.status.send_modify(|status| {
            (status.states_total, status.observations) = (states_total, observations);
        });
    }

    /// Ends the job of an update, which may have published a generation and its cut.
    pub fn end(&self, result: Result<(u64, i64), String>) {
        self.end_with(result.map(Some));
    }

    /// Ends the job.
    pub(crate) fn end_with(&self, result: Result<Option<(u64, i64)>, String>) {
        self.step.lock().unwrap_or_else(PoisonError::into_inner).end();
        match &result {
            Ok(Some((generation, _))) => self.span.number("tidemap.generation", *generation),
            Ok(None) => {}
            Err(_) => self.span.fail("the job failed: `tidemap job list` and the log have the reason"),
        }
        let status = self.status();
        self.span.number("tidemap.states", status.states_total);
        self.span.number("tidemap.observations", status.observations);
        self.span.end();
        self.status.send_modify(|status| {
            let elapsed = match status.phase {
                Phase::Running(since) => since.elapsed(),
                _ => Duration::ZERO,
            };
            match result {
                Ok(published) => {
                    status.published = published;
                    status.phase = Phase::Done(elapsed);
                }
                Err(error) => {
                    if matches!(self.cause, JobCause::Update(_)) {
                        metrics::counter!("tidemap_update_failures_total").increment(1);
                    }
                    status.phase = Phase::Failed(elapsed, error);
                }
            }
        });
    }

    /// The result of the update; `None` if a later update of the map has ended since, or data was erased from the map.
    pub fn report(&self) -> Option<Arc<UpdateReport>> {
        self.report.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// All jobs of the daemon.
#[derive(Debug, Default)]
pub struct Jobs {
    next_id: AtomicU64,
    // The jobs have a lock, because they come from all maps; it is held only to push or copy pointers.
    jobs: Mutex<VecDeque<Arc<UpdateJob>>>,
}

impl Jobs {
    /// The jobs of one of several daemons: other daemons have other job numbers. The numbers are below 2^52, which JSON
    /// readers keep exactly.
    pub fn of_member(name: &str) -> Self {
        let number = u64::from(crc32c::crc32c(name.as_bytes()) & 0xF_FFFF).max(1);
        Self { next_id: AtomicU64::new(number << 32), ..Self::default() }
    }

    /// Adds a waiting job.
    pub fn create(
        &self,
        map: impl Into<Option<MapName>>,
        cause: impl Into<JobCause>,
        created_nanos: i64,
    ) -> Arc<UpdateJob> {
        let map = map.into();
        let (status, _) =
            watch::channel(JobStatus { phase: Phase::Waiting, states_total: 0, observations: 0, published: None });
        let (id, cause) = (self.next_id.fetch_add(1, Ordering::Relaxed) + 1, cause.into());
        let span = Span::root(cause.span_name());
        if let Some(map) = &map {
            span.text("tidemap.map", map);
        }
        span.number("tidemap.job", id);
        span.text("tidemap.cause", format_args!("{cause:?}"));
        let step = Mutex::new(span.child("wait"));
        let job = Arc::new(UpdateJob {
            id,
            map,
            cause,
            created_nanos,
            states_done: AtomicU64::new(0),
            status,
            span,
            step,
            report: Mutex::new(None),
        });
        let mut jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
        jobs.push_front(Arc::clone(&job));
        // An old job that still waits or runs keeps its place, but does not keep the ended ones.
        while jobs.len() > JOBS_KEPT
            && let Some(oldest) = jobs.iter().rposition(|job| job.has_ended())
        {
            jobs.remove(oldest);
        }
        job
    }

    /// Adds the report of a part of a job and drops that of the map's previous update.
    pub(crate) fn add_report(&self, job: &UpdateJob, mut report: UpdateReport) {
        for other in self.list().iter().filter(|other| other.map == job.map && other.id != job.id) {
            *other.report.lock().unwrap_or_else(PoisonError::into_inner) = None;
        }
        let mut known = job.report.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(earlier) = known.take() {
            report = UpdateReport::clone(&earlier).followed_by(report);
        }
        *known = Some(Arc::new(report));
    }

    /// Drops the reports of a map after an erasure, because they name states, and the reasons of failures that contain
    /// one of these names.
    pub fn erased(&self, map: &MapName, names: &[&str]) {
        for job in self.list().iter().filter(|job| job.map.as_ref() == Some(map)) {
            *job.report.lock().unwrap_or_else(PoisonError::into_inner) = None;
            job.status.send_if_modified(|status| match &mut status.phase {
                Phase::Failed(_, reason) if names.iter().any(|name| reason.contains(name)) => {
                    *reason = "its reason named what has been erased since".to_owned();
                    true
                }
                _ => false,
            });
        }
    }

    /// All known jobs, newest first.
    pub fn list(&self) -> Vec<Arc<UpdateJob>> {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned().collect()
    }

    /// The job of this number; `None`: no such job, or it ended long ago.
    pub fn get(&self, id: u64) -> Option<Arc<UpdateJob>> {
        self.list().into_iter().find(|job| job.id == id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_erased_is_named_by_no_job() {
        let jobs = Jobs::default();
        let map = |name: &str| MapName::new(name).expect("valid");
        let failed = ["office", "home"].map(|name| jobs.create(map(name), UpdateCause::Request, 0));
        failed.iter().for_each(|job| job.end(Err("state \"anna\" is too large".to_owned())));
        let other = jobs.create(map("office"), UpdateCause::Request, 0);
        other.end(Err("no thread".to_owned()));
        let done = jobs.create(map("office"), UpdateCause::Request, 0);
        done.end(Ok((1, 2)));
        jobs.add_report(&done, UpdateReport::default());
        jobs.erased(&map("office"), &["anna"]);
        assert!(done.report().is_none());
        let reason = |job: &UpdateJob| match job.status().phase {
            Phase::Failed(_, reason) => reason,
            phase => panic!("{phase:?}"),
        };
        assert!(!reason(&failed[0]).contains("anna"));
        assert!(reason(&failed[1]).contains("anna"), "that of another map stays");
        assert_eq!(reason(&other), "no thread");
    }

    #[test]
    fn jobs_of_several_daemons_have_different_numbers() {
        let first = |jobs: Jobs| jobs.create(None, JobCause::Backup, 0).id;
        let mut ids: Vec<u64> = ["a", "b", "tidemap-0", "tidemap-1"].map(|name| first(Jobs::of_member(name))).into();
        ids.push(first(Jobs::default()));
        assert_eq!(ids.last(), Some(&1));
        ids.sort_unstable();
        ids.dedup_by_key(|id| *id >> 32);
        assert_eq!(ids.len(), 5, "{ids:?}");
        assert!(ids.iter().all(|id| *id < 1 << 52), "{ids:?}");
    }

    #[test]
    fn the_oldest_ended_job_is_forgotten_first() {
        let jobs = Jobs::default();
        let create = || jobs.create(MapName::new("office").expect("valid"), UpdateCause::Request, 0);
        let waiting = create();
        for _ in 0..JOBS_KEPT + 5 {
            create().end(Ok((1, 2)));
        }
        assert_eq!(jobs.list().len(), JOBS_KEPT);
        assert!(jobs.get(waiting.id).is_some());
        assert!(jobs.get(waiting.id + 1).is_none());
        for _ in 0..JOBS_KEPT {
            create();
        }
        assert_eq!(jobs.list().len(), JOBS_KEPT + 1);
    }
}
