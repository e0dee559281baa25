//! Routes that improve: robots in a simulated building, some of which follow the routes that tidemap plans from the
//! traversals of the edges that they travelled.
//!
//! Everything runs in one process, with the parts of a daemon: traversals become the states of edges in a
//! [`LiveMap`](tidemap_map::live_map::LiveMap) of each robot, models are learned at midnight, the map's forecasts of
//! edges feed [`plan_routes`](tidemap_plan::route::plan_routes). Robots are compared by failed traversals a week. The
//! trend of a robot is the slope of a straight line through its weeks (least squares), one for each seed; a two-sided
//! test over the seeds shows whether slopes differ from 0.
//!
//! - `building.rs`: the world; `learner.rs`: a robot's map; `robot.rs`: tasks and paths;
//! - `report.rs`: results.csv, weeks.csv; `picture.rs`: routes.svg.
//!
//! Invariant: plans use earlier observations only, and the same protocol gives the same figures for any number of
//! threads.

use std::ops::Range;

use tidemap_map::{live_map::InconsistentEvent, update::SumsUnavailable};
use tidemap_plan::route::PlanRouteError;

use crate::{paired, seed_mean::SeedMean, seed_runs::run_all};

pub(crate) mod building;
mod learner;
mod picture;
mod report;
pub(crate) mod robot;

#[cfg(test)]
mod tests;

pub use report::{summary, write};
pub use robot::{RobotKind, Week};

pub(crate) const DAY_SECS: f64 = 86_400.0;
pub(crate) const WEEK_DAYS: usize = 7;
/// Midnight before the first day, which is a Monday: 2025-01-06 UTC.
pub(crate) const START_NANOS: i64 = START_DAY as i64 * 86_400_000_000_000;
/// The first day.
pub(crate) const START_DAY: i32 = 20_094;

/// The protocol of a comparison of robots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RoutesProtocol {
    /// Number of buildings with different random events, at least 1.
    pub seeds: u64,
    /// The first seed; the others follow.
    pub first_seed: u64,
    /// Weeks of each run, at least 2.
    pub weeks: usize,
    /// Tasks in a day.
    pub tasks: usize,
}

/// Why a comparison of robots fails.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum RoutesError {
    /// An event does not fit the map.
    Map(#[from] InconsistentEvent),
    /// The map cannot be read.
    Sums(#[from] SumsUnavailable),
    /// A route cannot be planned.
    Route(#[from] PlanRouteError),
    /// The building is inconsistent.
    #[error("{0}")]
    Setting(String),
}

impl RoutesError {
    pub(crate) fn setting(error: impl std::fmt::Display) -> Self {
        Self::Setting(error.to_string())
    }
}

/// The course of a robot with all seeds.
#[derive(Clone, Debug)]
pub struct RobotCourse {
    /// The method by which the robot chooses its path.
    pub kind: RobotKind,
    /// The weeks of each seed.
    pub seeds: Vec<Vec<Week>>,
}

impl RobotCourse {
    /// Failed traversals in a week, over the weeks of a range, counted from 0.
    pub fn failures(&self, weeks: Range<usize>) -> SeedMean {
        self.over(weeks, |weeks| weeks.iter().map(|week| week.failures as f64).sum::<f64>() / weeks.len().max(1) as f64)
    }

    /// Failed traversals a task.
    pub fn failures_per_task(&self, weeks: Range<usize>) -> SeedMean {
        self.over(weeks, |weeks| per_task(weeks, |week| week.failures as f64))
    }

    /// Seconds a task.
    pub fn secs_per_task(&self, weeks: Range<usize>) -> SeedMean {
        self.over(weeks, |weeks| per_task(weeks, |week| week.secs))
    }

    /// The slope of a straight line (least squares) through the weeks of a range, in failures a week, for each seed.
    pub fn slopes(&self, weeks: Range<usize>) -> Vec<f64> {
        let slope = |seed: &Vec<Week>| {
            let weeks = seed.get(weeks.clone()).unwrap_or_default();
            let middle = (weeks.len() as f64 - 1.0) / 2.0;
            let (mut along, mut squares) = (0.0, 0.0);
            for (index, week) in weeks.iter().enumerate() {
                let away = index as f64 - middle;
                along += away * week.failures as f64;
                squares += away * away;
            }
            if squares > 0.0 { along / squares } else { 0.0 }
        };
        self.seeds.iter().map(slope).collect()
    }

    fn over(&self, weeks: Range<usize>, value_of: impl Fn(&[Week]) -> f64) -> SeedMean {
        let of_seed = |seed: &Vec<Week>| value_of(seed.get(weeks.clone()).unwrap_or_default());
        SeedMean::of(&self.seeds.iter().map(of_seed).collect::<Vec<f64>>())
    }
}

fn per_task(weeks: &[Week], value_of: impl Fn(&Week) -> f64) -> f64 {
    let tasks: u64 = weeks.iter().map(|week| week.tasks).sum();
    weeks.iter().map(value_of).sum::<f64>() / tasks.max(1) as f64
}

/// The results of all robots.
#[derive(Clone, Debug)]
pub struct RouteComparison {
    /// The robots, in the order of [`RobotKind::ALL`].
    pub courses: Vec<RobotCourse>,
    /// Number of weeks.
    pub weeks: usize,
}

/// The trend of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trend {
    /// Slope of the failures over the weeks, mean over seeds.
    pub slope: f64,
    /// Two-sided p-value of the slopes over seeds; none with fewer than six seeds.
    pub p_value: Option<f64>,
    /// Number of seeds with a negative slope.
    pub falling: usize,
}

impl RouteComparison {
    /// The later half of the weeks, counted from 0.
    pub fn late(&self) -> Range<usize> {
        self.weeks / 2..self.weeks
    }

    /// The trend of a robot's failures over the weeks of a range.
    pub fn trend(&self, course: &RobotCourse, weeks: Range<usize>) -> Trend {
        let slopes = course.slopes(weeks);
        Trend {
            slope: SeedMean::of(&slopes).mean,
            p_value: paired::p_value(&slopes),
            falling: slopes.iter().filter(|&&slope| slope < 0.0).count(),
        }
    }

    /// The failures of a robot's later weeks, divided by the failures of the robot that takes the shortest paths.
    pub fn of_shortest(&self, course: &RobotCourse) -> f64 {
        let baseline = self.courses.first().map_or(0.0, |first| first.failures(self.late()).mean);
        course.failures(self.late()).mean / baseline
    }
}

/// Runs all robots; `progress` receives the numbers of finished and of all runs.
pub fn run(protocol: &RoutesProtocol, progress: &(impl Fn(u64, u64) + Sync)) -> Result<RouteComparison, RoutesError> {
    let seeds = (protocol.first_seed, protocol.seeds);
    let runs = run_all(&RobotKind::ALL, seeds, progress, |kind, seed| robot::run(kind, seed, protocol))?;
    let courses = RobotKind::ALL.into_iter().zip(runs).map(|(kind, seeds)| RobotCourse { kind, seeds }).collect();
    Ok(RouteComparison { courses, weeks: protocol.weeks })
}
