//! Tasks over weeks: robots with windows to keep, in a simulated building whose ways are not always open.
//!
//! The building is the one of [`routes`](crate::routes). Every day has tasks at random places, each with a window, and
//! charging in each part of the day. One robot does them in the order in which their windows open, on shortest ways.
//! The others choose their ways, or their ways and their days, by the data that they learned about the edges that they
//! travelled until the last midnight: the parts of a daemon in one process. A failed traversal costs time; a few of
//! them end with the robot stuck, and somebody has to help.
//!
//! - `demand.rs`: the tasks of a day; `robot.rs`: a robot that does them; `report.rs`: results.csv, weeks.csv;
//! - `terminal.rs`: another world, in which the task is to be where people are.
//!
//! Invariant: with one seed all robots have the same tasks and meet the same world; plans use earlier days only; the
//! same protocol gives the same figures for any number of threads.

use std::ops::Range;

use tidemap_plan::{day::DayError, tasks::TaskPlanError};

use crate::{routes::RoutesError, seed_mean::SeedMean, seed_runs::run_all};

mod demand;
mod report;
mod robot;
pub mod terminal;

#[cfg(test)]
mod tests;

pub use report::{summary, write};
pub use robot::{TaskFigures, TaskRobotKind};

/// The protocol of a comparison of robots with tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TasksProtocol {
    /// Number of buildings with different random events, at least 1.
    pub seeds: u64,
    /// The first seed; the others follow.
    pub first_seed: u64,
    /// Weeks of each run, at least 1.
    pub weeks: usize,
    /// Tasks in a day, without charging.
    pub tasks: usize,
}

/// Why robots cannot be compared.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum TasksError {
    /// The map cannot learn, or a way cannot be planned.
    Route(#[from] RoutesError),
    /// A day cannot be planned.
    Plan(#[from] TaskPlanError),
    /// A day has no slots.
    Day(#[from] DayError),
}

impl TasksError {
    fn setting(error: impl std::fmt::Display) -> Self {
        Self::Route(RoutesError::setting(error))
    }
}

/// The course of a robot with all seeds.
#[derive(Clone, Debug)]
pub struct TaskCourse {
    /// The method by which the robot works.
    pub kind: TaskRobotKind,
    /// The weeks of each seed.
    pub seeds: Vec<Vec<TaskFigures>>,
}

impl TaskCourse {
    /// A figure of the weeks of a range, counted from 0: the mean over them, and over the seeds.
    pub fn weekly(&self, weeks: Range<usize>, figure: impl Fn(&TaskFigures) -> f64) -> SeedMean {
        let count = weeks.len().max(1) as f64;
        self.over(weeks, |weeks| weeks.iter().map(&figure).sum::<f64>() / count)
    }

    /// A sum over the weeks of a range for each task that was done in these weeks.
    pub fn per_task(&self, weeks: Range<usize>, figure: impl Fn(&TaskFigures) -> f64) -> SeedMean {
        self.over(weeks, |weeks| {
            let done: u64 = weeks.iter().map(|week| week.done).sum();
            weeks.iter().map(&figure).sum::<f64>() / done.max(1) as f64
        })
    }

    /// The longest lifetime of the system in the weeks of a range, in days.
    pub fn lifetime_days(&self, weeks: Range<usize>) -> SeedMean {
        self.over(weeks, |weeks| weeks.iter().map(|week| week.lifetime_secs / 86_400.0).fold(0.0, f64::max))
    }

    /// The failed traversals of all weeks, by seed.
    fn failures(&self) -> impl Iterator<Item = u64> {
        self.seeds.iter().map(|weeks| weeks.iter().map(|week| week.failures).sum())
    }

    fn over(&self, weeks: Range<usize>, value_of: impl Fn(&[TaskFigures]) -> f64) -> SeedMean {
        let of_seed = |seed: &Vec<TaskFigures>| value_of(seed.get(weeks.clone()).unwrap_or_default());
        SeedMean::of(&self.seeds.iter().map(of_seed).collect::<Vec<f64>>())
    }
}

/// The results of all robots.
#[derive(Clone, Debug)]
pub struct TaskComparison {
    /// The robots, in the order of [`TaskRobotKind::ALL`].
    pub courses: Vec<TaskCourse>,
    /// Number of weeks.
    pub weeks: usize,
}

impl TaskComparison {
    /// The failures of a robot, divided by the failures of the first robot.
    pub fn of_first_come(&self, course: &TaskCourse) -> f64 {
        let all = |course: &TaskCourse| course.failures().sum::<u64>() as f64;
        self.courses.first().map_or(f64::NAN, |first| all(course) / all(first))
    }

    /// Number of seeds with at most half the failures of the first robot.
    pub fn seeds_halved(&self, course: &TaskCourse) -> usize {
        let pairs = self.courses.first().into_iter().flat_map(|first| first.failures().zip(course.failures()));
        pairs.filter(|(first, own)| 2 * own <= *first).count()
    }
}

/// Runs all robots; `progress` receives the numbers of finished and of all runs.
pub fn run(protocol: &TasksProtocol, progress: &(impl Fn(u64, u64) + Sync)) -> Result<TaskComparison, TasksError> {
    let seeds = (protocol.first_seed, protocol.seeds);
    let runs = run_all(&TaskRobotKind::ALL, seeds, progress, |kind, seed| robot::run(kind, seed, protocol))?;
    let courses = TaskRobotKind::ALL.into_iter().zip(runs).map(|(kind, seeds)| TaskCourse { kind, seeds }).collect();
    Ok(TaskComparison { courses, weeks: protocol.weeks })
}
