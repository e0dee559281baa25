//! The tasks of a site, with the kept plans and the reports.
//!
//! Invariant: a book is a function of the edits and reports applied and their order. An edit that [`TaskBook::check`]
//! accepts is applied whole; any other changes nothing.

use std::{collections::BTreeMap, sync::Arc};

use tidemap_model::LocalDay;

use super::{RobotTask, TaskError, TaskRun, TaskRuns};
use crate::name::{StateName, TaskName, unprintable};

/// Maximum number of tasks of a map.
pub const TASKS_MAX: usize = 1_000;
/// Number of plans that a map keeps: the plans of the latest days.
pub const KEPT_PLANS_MAX: usize = 100;
/// Maximum number of steps of a kept plan.
pub const KEPT_STEPS_MAX: usize = 2_000;
/// Maximum number of characters of the name of a place that is explored.
const PLACE_CHARS_MAX: usize = 400;

/// The work of a robot in a step of a plan.
#[derive(Clone, Debug, PartialEq)]
pub enum KeptWork {
    /// A task.
    Task {
        /// The name of the task.
        name: TaskName,
        /// The value of the task at the time.
        value: f64,
        /// Probability that nothing fails on the way to the task.
        success: f64,
    },
    /// The robot explores.
    Explore {
        /// A location, a viewpoint `X,Y`, or `tour`.
        place: String,
        /// Information that the exploration is worth, in bits.
        information_bits: f64,
    },
}

/// A step of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct KeptStep {
    /// When the robot departs for the step, nanoseconds UTC.
    pub departure_nanos: i64,
    /// When the step begins, nanoseconds UTC.
    pub start_nanos: i64,
    /// When the step ends, nanoseconds UTC.
    pub end_nanos: i64,
    /// The work that is done.
    pub work: KeptWork,
}

/// The plan of a local day.
#[derive(Clone, Debug, PartialEq)]
pub struct KeptPlan {
    /// The day.
    pub day: LocalDay,
    /// When the plan was made, nanoseconds UTC.
    pub made_nanos: i64,
    /// The steps of the plan, ascending by start.
    pub steps: Vec<KeptStep>,
}

impl KeptPlan {
    /// The step at a moment, from its departure to before its end.
    #[must_use]
    pub fn at(&self, utc_nanos: i64) -> Option<&KeptStep> {
        self.steps.iter().find(|step| (step.departure_nanos..step.end_nanos).contains(&utc_nanos))
    }

    fn check(&self) -> Result<(), TaskError> {
        let wrong = |what| Err(TaskError::Plan { day: self.day, what });
        if self.steps.len() > KEPT_STEPS_MAX {
            return wrong("it has too many steps");
        }
        let follows = |pair: &[KeptStep]| pair[0].end_nanos <= pair[1].departure_nanos;
        let is_forward = |step: &KeptStep| {
            step.departure_nanos <= step.start_nanos && step.start_nanos < step.end_nanos && step.departure_nanos >= 0
        };
        if !self.steps.windows(2).all(follows) || !self.steps.iter().all(is_forward) {
            return wrong("its steps do not follow one another");
        }
        let is_sound = |step: &KeptStep| match &step.work {
            KeptWork::Task { value, success, .. } => {
                (0.0..=super::TASK_VALUE_MAX).contains(value) && (0.0..=1.0).contains(success)
            }
            KeptWork::Explore { place, information_bits } => {
                information_bits.is_finite()
                    && place.chars().count() <= PLACE_CHARS_MAX
                    && !place.is_empty()
                    && !place.chars().any(unprintable)
            }
        };
        if !self.steps.iter().all(is_sound) {
            return wrong("a value, a success or a place of a step is out of range");
        }
        Ok(())
    }
}

/// A change of the tasks of a site.
#[derive(Clone, Debug, PartialEq)]
pub enum TaskEdit {
    /// A task is added, or replaces the task of its name.
    Set(RobotTask),
    /// A task is removed. Its learned data stays.
    Remove(TaskName),
    /// A plan is kept; it replaces the plan of its day.
    KeepPlan(KeptPlan),
}

/// The tasks of a site.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TaskBook {
    tasks: BTreeMap<TaskName, RobotTask>,
    plans: BTreeMap<LocalDay, Arc<KeptPlan>>,
    runs: TaskRuns,
}

impl TaskBook {
    /// The tasks, by kind and then by node.
    pub fn tasks(&self) -> impl ExactSizeIterator<Item = &RobotTask> {
        self.tasks.values()
    }

    /// The kept plan of a day.
    #[must_use]
    pub fn plan(&self, day: LocalDay) -> Option<&Arc<KeptPlan>> {
        self.plans.get(&day)
    }

    /// The kept plans, by day.
    pub fn plans(&self) -> impl ExactSizeIterator<Item = &KeptPlan> {
        self.plans.values().map(|plan| &**plan)
    }

    /// The reports of what was done.
    #[must_use]
    pub fn runs(&self) -> &TaskRuns {
        &self.runs
    }

    /// This book with stored reports.
    #[must_use]
    pub fn with_runs(self, runs: TaskRuns) -> TaskBook {
        TaskBook { runs, ..self }
    }

    /// This book with every task as `change` returns it, under the same name.
    pub(crate) fn with_tasks(self, change: impl Fn(RobotTask) -> RobotTask) -> TaskBook {
        let tasks = self.tasks.into_iter().map(|(name, task)| (name, change(task))).collect();
        TaskBook { tasks, ..self }
    }

    /// This book with every kept plan as `change` returns it, for the same day.
    pub(crate) fn with_plans(self, change: impl Fn(KeptPlan) -> KeptPlan) -> TaskBook {
        let changed = |(day, plan): (LocalDay, Arc<KeptPlan>)| (day, Arc::new(change(Arc::unwrap_or_clone(plan))));
        TaskBook { plans: self.plans.into_iter().map(changed).collect(), ..self }
    }

    /// Adds reports. Unlike edits, these are part of the observations that they come with.
    pub(crate) fn add_runs(&mut self, runs: &[TaskRun]) {
        runs.iter().for_each(|run| self.runs.add(run.clone()));
    }

    /// Checks that an edit may be applied now.
    ///
    /// # Errors
    /// [`TaskError`], with what is wrong.
    pub fn check(&self, edit: &TaskEdit) -> Result<(), TaskError> {
        match edit {
            TaskEdit::Set(task) => {
                task.check()?;
                let is_known = self.tasks.contains_key(&task.name);
                if is_known || self.tasks.len() < TASKS_MAX { Ok(()) } else { Err(TaskError::TooMany(TASKS_MAX)) }
            }
            TaskEdit::Remove(name) if self.tasks.contains_key(name) => Ok(()),
            TaskEdit::Remove(name) => Err(TaskError::Unknown(name.to_string())),
            TaskEdit::KeepPlan(plan) => plan.check(),
        }
    }

    /// Applies an edit.
    ///
    /// # Errors
    /// The errors of [`TaskBook::check`]; nothing is changed then.
    pub fn apply(&mut self, edit: &TaskEdit) -> Result<(), TaskError> {
        self.check(edit)?;
        match edit {
            TaskEdit::Set(task) => drop(self.tasks.insert(task.name.clone(), task.clone())),
            TaskEdit::Remove(name) => drop(self.tasks.remove(name)),
            TaskEdit::KeepPlan(plan) => {
                self.plans.insert(plan.day, Arc::new(plan.clone()));
                if self.plans.len() > KEPT_PLANS_MAX {
                    self.plans.pop_first();
                }
            }
        }
        Ok(())
    }

    /// Checks that no task of a renamed node would have the name of another task.
    ///
    /// # Errors
    /// [`TaskError::Renamed`].
    pub(crate) fn check_rename(&self, from: &StateName, to: &StateName) -> Result<(), TaskError> {
        let renamed = |name: &TaskName| TaskName { node: to.clone(), ..name.clone() };
        let mut moved = self.tasks.keys().filter(|name| name.node == *from && from != to).map(renamed);
        let taken = moved.find(|name| self.tasks.contains_key(name));
        taken.map_or(Ok(()), |name| Err(TaskError::Renamed(name.to_string())))
    }

    /// Gives a node another name.
    pub(crate) fn rename_node(&mut self, from: &StateName, to: &StateName) {
        let renamed = |name: &TaskName| TaskName { node: to.clone(), ..name.clone() };
        let moved: Vec<TaskName> = self.tasks.keys().filter(|name| name.node == *from).cloned().collect();
        for name in moved {
            if let Some(task) = self.tasks.remove(&name) {
                self.tasks.insert(renamed(&name), RobotTask { name: renamed(&name), ..task });
            }
        }
        for task in self.tasks.values_mut() {
            if let Some(Ok(name)) = task.value_state.as_ref().and_then(|s| s.with_node_renamed(from.as_str(), to)) {
                task.value_state = Some(name);
            }
        }
        let is_of_node = |step: &KeptStep| matches!(&step.work, KeptWork::Task { name, .. } if name.node == *from);
        for plan in self.plans.values_mut().filter(|plan| plan.steps.iter().any(is_of_node)) {
            for step in Arc::make_mut(plan).steps.iter_mut().filter(|step| is_of_node(step)) {
                if let KeptWork::Task { name, .. } = &mut step.work {
                    name.node = to.clone();
                }
            }
        }
        self.runs.rename_node(from, to);
    }
}
