//! Plans the tasks of a day: selects which tasks a robot does, in which order and when.
//!
//! A task is done at a place. It begins within its window, takes its duration, and ends within its window. Its value
//! may change over the day, for example with the probability that somebody is there. A robot travels between places by
//! legs ([`LegTable`]): the expected time of a leg includes repeated attempts at edges that fail, and its success is
//! the probability that nothing fails. The plan has the greatest sum of values, each times the success of the leg to it
//! unless the task [persists](DayTask::persists); ties: the earliest end. Charging is an ordinary task (N. Hawes et
//! al., "The STRANDS Project", IEEE RAM 2017).
//!
//! The day is divided into slots of equal length, as in [`crate::policy`]: a leg is as forecast for the slot of its
//! departure, and a value counts for the slot in which the task begins. Within a slot earlier is never worse, because a
//! robot may wait. So only some times need to be tried: departures at once or at the beginning of a later slot, and
//! beginnings at the arrival, at the opening of the window, or at the beginning of a later slot. Few tasks are planned
//! exactly, over all sets of tasks (`tasks/exact.rs`); more by insertion and local search (`tasks/search.rs`).
//!
//! Invariant: a plan is a function of its request. Steps do not overlap, each lies within its window, and each task is
//! either a step or unserved, with a reason.

mod day;
mod exact;
mod legs;
mod search;
mod timing;

pub use day::{MapDay, Occurrence, PlannedTasks, UnservedTask, occurrences};
pub use legs::{Leg, LegError, LegOptions, LegTable};
use tidemap_model::{EarlyStop, StopSignal};

use exact::plan_exactly;
use search::search_order;
use timing::Timing;

/// Maximum number of tasks of one plan.
pub const PLANNED_TASKS_MAX: usize = 100;
/// Maximum number of tasks that are planned exactly.
pub(crate) const EXACT_TASKS_MAX: usize = 12;
/// Maximum number of slots of a day.
pub const TASK_SLOTS_MAX: usize = 1_500;

/// A task to plan. Times are in seconds after the reference time.
#[derive(Clone, Debug, PartialEq)]
pub struct DayTask {
    /// The place at which the task is done: a place of the [`LegTable`].
    pub place: usize,
    /// The earliest start.
    pub from_secs: f64,
    /// The latest end.
    pub until_secs: f64,
    /// Duration of the task, above 0.
    pub duration_secs: f64,
    /// Value of the task.
    pub value: TaskValue,
    /// Whether the robot tries until it gets to the place, for example to its charger: failures on the way do not
    /// reduce the worth. Otherwise no robot would leave its charger for a task of less value.
    pub persists: bool,
}

impl DayTask {
    /// The worth of a value in a plan, after a way with this success.
    fn worth(&self, value: f64, success: f64) -> f64 {
        if self.persists { value } else { value * success }
    }
}

/// The value of a task.
#[derive(Clone, Debug, PartialEq)]
pub enum TaskValue {
    /// A constant value; at least 0.
    Fixed(f64),
    /// A value by the slot in which the task begins; one number per slot, at least 0.
    BySlot(Vec<f64>),
}

impl TaskValue {
    pub(crate) fn at(&self, slot: usize) -> f64 {
        match self {
            TaskValue::Fixed(value) => *value,
            TaskValue::BySlot(values) => values.get(slot).copied().unwrap_or(0.0),
        }
    }
}

/// A day of tasks.
#[derive(Clone, Debug)]
pub struct TaskDay<'a> {
    /// The tasks.
    pub tasks: &'a [DayTask],
    /// The ways between places.
    pub legs: &'a LegTable,
    /// The place where the robot is at the beginning.
    pub start: usize,
    /// Time at which the robot is ready, in seconds after the reference time.
    pub ready_secs: f64,
}

/// A planned task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskStep {
    /// Index of the task.
    pub task: usize,
    /// The latest departure for the task with which it begins at this time with this success.
    pub departure_secs: f64,
    /// Start of the task.
    pub start_secs: f64,
    /// End of the task.
    pub end_secs: f64,
    /// Value of the task if it begins at this time.
    pub value: f64,
    /// Probability that nothing fails on the way to the task.
    pub success: f64,
}

/// The reason why a task is not in a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnservedReason {
    /// The window of the task is shorter than its duration, or is over.
    NoWindow,
    /// No leg leads to the place of the task.
    Unreachable,
    /// The task has no value at any time.
    NoValue,
    /// The task could be done alone; the other tasks are worth more.
    NoTime,
    /// The map has no such node.
    UnknownNode,
    /// The map has no such state, so the value of the task is not known.
    UnknownState,
}

/// A plan of tasks.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskPlan {
    /// The tasks in their order.
    pub steps: Vec<TaskStep>,
    /// Tasks that are not in the plan, ascending by index.
    pub unserved: Vec<(usize, UnservedReason)>,
    /// Sum of the values, each times the success of the leg to it unless the task persists.
    pub expected_value: f64,
    /// Whether no plan is better.
    pub is_proven: bool,
}

/// The reason why tasks cannot be planned.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum TaskPlanError {
    /// There are too many tasks.
    #[error("the day has {found} tasks: at most {PLANNED_TASKS_MAX} are planned")]
    TooMany { found: usize },
    /// A number of a task is invalid.
    #[error("{what} of task {task} is {found}: expected {expected}")]
    Range { task: usize, what: &'static str, found: f64, expected: &'static str },
    /// A place is not in the table of legs.
    #[error("there is no place {0}")]
    UnknownPlace(usize),
    /// The ways between the tasks cannot be computed.
    #[error(transparent)]
    Leg(#[from] LegError),
    /// The caller stopped the planning.
    #[error("the plan was stopped before it was ready; raise the time limit, or plan fewer tasks")]
    Stopped,
}

impl From<EarlyStop> for TaskPlanError {
    fn from(_: EarlyStop) -> Self {
        TaskPlanError::Stopped
    }
}

fn check(day: &TaskDay<'_>) -> Result<(), TaskPlanError> {
    let found = day.tasks.len();
    if found > PLANNED_TASKS_MAX {
        return Err(TaskPlanError::TooMany { found });
    }
    let places = day.legs.places();
    let unknown = day.tasks.iter().map(|task| task.place).chain([day.start]).find(|place| *place >= places);
    if let Some(place) = unknown {
        return Err(TaskPlanError::UnknownPlace(place));
    }
    for (task, DayTask { from_secs, until_secs, duration_secs, value, .. }) in day.tasks.iter().enumerate() {
        let range = |what, found: f64, holds: bool, expected| {
            if holds { Ok(()) } else { Err(TaskPlanError::Range { task, what, found, expected }) }
        };
        range("the earliest start", *from_secs, from_secs.is_finite(), "a number of seconds")?;
        range("the latest end", *until_secs, until_secs.is_finite(), "a number of seconds")?;
        let is_long = duration_secs.is_finite() && *duration_secs > 0.0;
        range("the duration", *duration_secs, is_long, "seconds above 0")?;
        let values = (0..day.legs.slots()).map(|slot| value.at(slot));
        let wrong = values.into_iter().find(|value| !(value.is_finite() && *value >= 0.0));
        range("the value", wrong.unwrap_or_default(), wrong.is_none(), "a number of at least 0")?;
    }
    Ok(())
}

/// Plans the tasks of a day. With up to 12 tasks that can be done at all the plan is the best, unless its proof would
/// take too many steps; see [`TaskPlan::is_proven`].
///
/// # Errors
/// [`TaskPlanError`].
pub fn plan_tasks(day: &TaskDay<'_>, stop: StopSignal<'_>) -> Result<TaskPlan, TaskPlanError> {
    check(day)?;
    let mut timing = Timing::new(day);
    let mut unserved = Vec::new();
    let mut possible = Vec::new();
    for task in 0..day.tasks.len() {
        match why_impossible(day, &mut timing, task) {
            Some(reason) => unserved.push((task, reason)),
            None => possible.push(task),
        }
    }
    let found = search_order(&mut timing, &possible, stop)?;
    let proven = if possible.len() <= EXACT_TASKS_MAX {
        plan_exactly(&mut timing, &possible, found.as_ref().map_or(0.0, |moves| moves.value), stop)?
    } else {
        None
    };
    let is_proven = proven.is_some() || possible.is_empty();
    let moves = proven.or(found).unwrap_or_default();
    let steps = moves.steps(day);
    let is_served = |task: &usize| steps.iter().any(|step| step.task == *task);
    unserved.extend(possible.into_iter().filter(|task| !is_served(task)).map(|task| (task, UnservedReason::NoTime)));
    unserved.sort_unstable_by_key(|&(task, _)| task);
    let expected_value = steps.iter().map(|step| day.tasks[step.task].worth(step.value, step.success)).sum();
    Ok(TaskPlan { steps, unserved, expected_value, is_proven })
}

/// The reason why a task cannot be done even alone.
fn why_impossible(day: &TaskDay<'_>, timing: &mut Timing<'_>, task: usize) -> Option<UnservedReason> {
    let DayTask { place, from_secs, until_secs, duration_secs, ref value, .. } = day.tasks[task];
    let has_window = from_secs.max(day.ready_secs) + duration_secs <= until_secs;
    let has_value = (0..day.legs.slots()).any(|slot| value.at(slot) > 0.0);
    let is_reached = (0..day.legs.slots()).any(|slot| day.legs.at(day.start, place, slot).is_some());
    if !has_window {
        Some(UnservedReason::NoWindow)
    } else if !has_value {
        Some(UnservedReason::NoValue)
    } else if !is_reached && !is_reached_by_others(day, place) {
        Some(UnservedReason::Unreachable)
    } else if timing.choices(day.start, task, day.ready_secs).is_empty() && !is_reached_by_others(day, place) {
        Some(UnservedReason::NoWindow)
    } else {
        None
    }
}

/// Whether a leg leads to the place from the place of another task.
fn is_reached_by_others(day: &TaskDay<'_>, place: usize) -> bool {
    let from = day.tasks.iter().map(|task| task.place).filter(|from| *from != place && *from != day.start);
    from.into_iter().any(|from| (0..day.legs.slots()).any(|slot| day.legs.at(from, place, slot).is_some()))
}

#[cfg(test)]
mod tests;
