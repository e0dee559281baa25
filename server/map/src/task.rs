//! Tasks of a map: the work that a robot should do, with places and times, the kept plans of days, and the reports of
//! what was done.
//!
//! A task is done at a node of the topological map. Charging is a task like others, of the kind [`CHARGE_KIND`] (N.
//! Hawes et al., "The STRANDS Project", IEEE RAM 2017). Windows are in local time, so that a task at nine stays at nine
//! when the clocks change.
//!
//! Invariant: a task that [`RobotTask::check`] accepts has a window in which it can be done on some day. A kept plan
//! and the reports do not change when tasks do.

mod book;
mod figures;

use std::{collections::VecDeque, sync::Arc};

use tidemap_model::{LocalDay, Zone};

pub use self::{
    book::{KEPT_PLANS_MAX, KEPT_STEPS_MAX, KeptPlan, KeptStep, KeptWork, TASKS_MAX, TaskBook, TaskEdit},
    figures::{AllowedHours, TaskWeek, task_weeks},
};
use crate::{
    name::{StateName, TaskName},
    traversal::{TRAVERSAL_MAX_NANOS, TraversalError},
};

/// Kind of the tasks that charge the robot. They do not count as active time.
pub const CHARGE_KIND: &str = "charge";
/// Number of reports that a map keeps.
pub(crate) const TASK_RUNS_MAX: usize = 10_000;
/// Greatest value of a task.
pub const TASK_VALUE_MAX: f64 = 1e6;
/// Maximum number of times that a task is done on one day.
pub(crate) const REPEATS_MAX: u32 = 96;

const DAY_SECS: u32 = 86_400;
/// A bit for each day of the week, Monday in the lowest.
pub const ALL_WEEKDAYS: u8 = 0x7f;

/// The days on which something is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskDays {
    /// On these days of every week: a bit for each day, Monday in the lowest; at least one.
    Weekly(u8),
    /// On this day only.
    On(LocalDay),
}

impl TaskDays {
    fn has(self, day: LocalDay) -> bool {
        match self {
            TaskDays::Weekly(days) => days & (1 << day.weekday()) != 0,
            TaskDays::On(only) => only == day,
        }
    }
}

/// A task.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotTask {
    /// The kind and the node of the task.
    pub name: TaskName,
    /// Earliest start, seconds after local midnight.
    pub from_secs: u32,
    /// Latest end, seconds after local midnight, at most a day.
    pub until_secs: u32,
    /// How long it takes, in seconds.
    pub duration_secs: u32,
    /// The days on which the task is done.
    pub days: TaskDays,
    /// The window is divided into parts of this length, and the task is done once in each; `None`: once in the window.
    pub every_secs: Option<u32>,
    /// The value of the task, 0 to [`TASK_VALUE_MAX`].
    pub value: f64,
    /// A state whose probability at the time multiplies the value.
    pub value_state: Option<StateName>,
}

/// Why a task, or a report of one, is invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum TaskError {
    /// A window is invalid.
    #[error("the window from {from_secs} s to {until_secs} s of a day is empty or longer than the day")]
    Window { from_secs: u32, until_secs: u32 },
    /// The duration is invalid.
    #[error("the task takes {duration_secs} s: expected 1 s up to {window_secs} s, the length of its window")]
    Duration { duration_secs: u32, window_secs: u32 },
    /// The repetition is invalid.
    #[error(
        "the task is repeated every {every_secs} s: expected its duration of {duration_secs} s or more, and at most \
         {REPEATS_MAX} times a day"
    )]
    Every { every_secs: u32, duration_secs: u32 },
    /// There are no days.
    #[error("the task is done on no day of the week: name at least one")]
    NoDays,
    /// The value is invalid.
    #[error("the value of the task is {0}: expected 0 to {TASK_VALUE_MAX}")]
    Value(f64),
    /// The map has no such task.
    #[error("task {0:?} does not exist")]
    Unknown(String),
    /// A task of a renamed node would have the name of another task.
    #[error("a task of the node would be renamed to {0:?}, but a task of that name exists: remove one of them first")]
    Renamed(String),
    /// The map has too many tasks.
    #[error("the map has the maximum of {0} tasks")]
    TooMany(usize),
    /// A plan is invalid.
    #[error("the plan of {day} is not valid: {what}")]
    Plan { day: LocalDay, what: &'static str },
}

impl RobotTask {
    /// Checks the task's numbers. Whether node and state exist is not checked: they may be added later.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn check(&self) -> Result<(), TaskError> {
        let RobotTask { from_secs, until_secs, duration_secs, days, every_secs, value, .. } = *self;
        if from_secs >= until_secs || until_secs > DAY_SECS {
            return Err(TaskError::Window { from_secs, until_secs });
        }
        let window_secs = until_secs - from_secs;
        if !(1..=window_secs).contains(&duration_secs) {
            return Err(TaskError::Duration { duration_secs, window_secs });
        }
        if let Some(every_secs) = every_secs
            && (every_secs < duration_secs || window_secs.div_ceil(every_secs.max(1)) > REPEATS_MAX)
        {
            return Err(TaskError::Every { every_secs, duration_secs });
        }
        if let TaskDays::Weekly(days) = days
            && !(1..=ALL_WEEKDAYS).contains(&days)
        {
            return Err(TaskError::NoDays);
        }
        if !(0.0..=TASK_VALUE_MAX).contains(&value) {
            return Err(TaskError::Value(value));
        }
        Ok(())
    }

    /// The windows of a day, in seconds after local midnight; none on other days.
    #[must_use]
    pub fn windows(&self, day: LocalDay) -> Vec<(u32, u32)> {
        if !self.days.has(day) {
            return Vec::new();
        }
        let every_secs = self.every_secs.unwrap_or(DAY_SECS).max(1);
        let starts = (self.from_secs..self.until_secs).step_by(every_secs as usize);
        let part = |from: u32| (from, from.saturating_add(every_secs).min(self.until_secs));
        starts.map(part).filter(|(from, until)| until - from >= self.duration_secs).collect()
    }
}

/// The moment of a local time of day, nanoseconds UTC. A time that the clocks skip moves to the other side of the jump:
/// 01:30 becomes 02:30 where the clocks jump from 01:00 to 02:00.
#[must_use]
pub fn local_nanos(zone: &Zone, day: LocalDay, secs: u32) -> i64 {
    const NANOS: i64 = 1_000_000_000;
    let wanted = (i64::from(day.0) * i64::from(DAY_SECS) + i64::from(secs)) * NANOS;
    let midnight = zone.midnight_nanos(day);
    let guess = midnight.saturating_add(i64::from(secs) * NANOS);
    let by_clock = guess.saturating_add(i64::from(zone.offset_secs(guess)) * NANOS);
    let moment = guess.saturating_sub(by_clock.saturating_sub(wanted)).max(midnight);
    let is_skipped = moment.saturating_add(i64::from(zone.offset_secs(moment)) * NANOS) != wanted && by_clock > wanted;
    if is_skipped { guess } else { moment }
}

/// A report: a robot did a task, or tried to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskRun {
    /// The task. It need not exist: a robot may do a task that no plan contains.
    pub name: TaskName,
    /// When the robot began, nanoseconds UTC.
    pub start_nanos: i64,
    /// When the robot ended or gave up, nanoseconds UTC.
    pub end_nanos: i64,
    /// Whether the robot succeeded.
    pub success: bool,
    /// Whether the robot could not go on by itself, so that a person had to help without being asked to. It ends the
    /// lifetime of the system.
    pub intervention: bool,
    /// Reason of a failure, for people, normalised in the same way as the reason of a traversal.
    pub reason: String,
}

impl TaskRun {
    /// Checks the times of the report.
    ///
    /// # Errors
    /// [`TraversalError`].
    pub fn check(&self) -> Result<(), TraversalError> {
        let Self { start_nanos, end_nanos, .. } = *self;
        if start_nanos < 0 {
            return Err(TraversalError::Before1970(start_nanos));
        }
        if end_nanos < start_nanos {
            return Err(TraversalError::Backwards { start_nanos, end_nanos });
        }
        if end_nanos - start_nanos > TRAVERSAL_MAX_NANOS {
            return Err(TraversalError::TooLong { secs: (end_nanos - start_nanos) as f64 / 1e9 });
        }
        Ok(())
    }

    /// The value of the report's observation: of the state [`TaskName::state`], at the start of the run.
    #[must_use]
    pub fn observed(&self) -> f64 {
        f64::from(u8::from(self.success))
    }
}

/// The reports of a map that began last: at most [`TASK_RUNS_MAX`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TaskRuns {
    /// The reports, ascending by start; reports with equal starts are in order of arrival.
    oldest_first: Arc<VecDeque<Arc<TaskRun>>>,
}

impl TaskRuns {
    /// Adds a report, and drops the oldest report where there are too many.
    pub fn add(&mut self, run: TaskRun) {
        let kept = Arc::make_mut(&mut self.oldest_first);
        let place = kept.partition_point(|known| known.start_nanos <= run.start_nanos);
        kept.insert(place, Arc::new(run));
        if kept.len() > TASK_RUNS_MAX {
            kept.pop_front();
        }
    }

    /// All reports. If they are added again in this order, the result is equal.
    pub fn oldest_first(&self) -> impl DoubleEndedIterator<Item = &TaskRun> + ExactSizeIterator {
        self.oldest_first.iter().map(|run| &**run)
    }

    fn rename_node(&mut self, from: &StateName, to: &StateName) {
        if !self.oldest_first().any(|run| run.name.node == *from) {
            return;
        }
        for run in Arc::make_mut(&mut self.oldest_first).iter_mut().filter(|run| run.name.node == *from) {
            Arc::make_mut(run).name.node = to.clone();
        }
    }
}

#[cfg(test)]
mod tests;
