//! Routes that get better: robots in a simulated building, one of which follows the routes that tidemap plans on what
//! it learned of the ways that it drove.
//!
//! Everything runs in one process, with the parts that a daemon has: traversals become the states of edges in a
//! [`LiveMap`](tidemap_map::live_map::LiveMap), models are learned at midnight,
//! [`EdgeForecasts`](tidemap_map::edge_forecast::EdgeForecasts) says what is to be expected of the ways, and
//! [`plan_routes`](tidemap_plan::route::plan_routes) plans. Compared are failed traversals by week. The trend of a
//! robot is the slope of a straight line through its weeks (least squares), one for each seed; whether slopes differ
//! from 0 is tested over the seeds, either way.
//!
//! Invariant: nothing is planned on what comes later, and the same question gives the same figures, however many
//! threads there are.

use std::{
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};

use rayon::prelude::*;
use tidemap_map::{grid::tile::TileUnavailable, live_map::InconsistentEvent};
use tidemap_plan::route::PlanRouteError;

use super::paired;

mod building;
mod learner;
mod picture;
mod report;
mod robot;

#[cfg(test)]
mod tests;

pub use report::{summary, write};
pub use robot::{RobotKind, Week};

const DAY_SECS: f64 = 86_400.0;
const WEEK_DAYS: usize = 7;
/// Midnight before the first day, which is a Monday: 2025-01-06 UTC.
const START_NANOS: i64 = 20_094 * 86_400_000_000_000;

/// What is to be run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RoutesProtocol {
    /// Buildings with another luck each, 1 or more.
    pub seeds: u64,
    /// The first seed; the others follow.
    pub first_seed: u64,
    /// Weeks of each, 2 or more.
    pub weeks: usize,
    /// Tasks of a day.
    pub tasks: usize,
}

/// Why robots could not be sent around.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum RoutesError {
    /// A map that was not told what it can know.
    Map(#[from] InconsistentEvent),
    /// A map that could not be read.
    Tile(#[from] TileUnavailable),
    /// A route.
    Route(#[from] PlanRouteError),
    /// The building.
    #[error("{0}")]
    Setting(String),
}

/// A robot, as it did with all seeds.
#[derive(Clone, Debug)]
pub struct RobotCourse {
    /// How it chose its ways.
    pub kind: RobotKind,
    /// Of each seed, of each week.
    pub seeds: Vec<Vec<Week>>,
}

/// A mean over seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Its standard error; none of a single seed.
    pub standard_error: Option<f64>,
}

impl Estimate {
    fn of(values: &[f64]) -> Estimate {
        let count = values.len().max(1) as f64;
        let mean = values.iter().sum::<f64>() / count;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let standard_error = (values.len() > 1).then(|| (squares / (count - 1.0) / count).sqrt());
        Estimate { mean, standard_error }
    }
}

impl RobotCourse {
    /// Failed traversals a week, over the weeks of a range, counted from 0.
    pub fn failures(&self, weeks: Range<usize>) -> Estimate {
        self.over(weeks, |weeks| weeks.iter().map(|week| week.failures as f64).sum::<f64>() / weeks.len().max(1) as f64)
    }

    /// Failed traversals a task.
    pub fn failures_per_task(&self, weeks: Range<usize>) -> Estimate {
        self.over(weeks, |weeks| per_task(weeks, |week| week.failures as f64))
    }

    /// Seconds a task.
    pub fn secs_per_task(&self, weeks: Range<usize>) -> Estimate {
        self.over(weeks, |weeks| per_task(weeks, |week| week.secs))
    }

    /// By how many failures a week its weeks rise, of each seed: the slope of a straight line (least squares), over the
    /// weeks of a range.
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

    fn over(&self, weeks: Range<usize>, of: impl Fn(&[Week]) -> f64) -> Estimate {
        let of_seed = |seed: &Vec<Week>| of(seed.get(weeks.clone()).unwrap_or_default());
        Estimate::of(&self.seeds.iter().map(of_seed).collect::<Vec<f64>>())
    }
}

fn per_task(weeks: &[Week], of: impl Fn(&Week) -> f64) -> f64 {
    let tasks: u64 = weeks.iter().map(|week| week.tasks).sum();
    weeks.iter().map(of).sum::<f64>() / tasks.max(1) as f64
}

/// What came of it.
#[derive(Clone, Debug)]
pub struct RouteComparison {
    /// The robots, in the order of [`RobotKind::ALL`].
    pub courses: Vec<RobotCourse>,
    /// Weeks that they were on their way.
    pub weeks: usize,
}

/// The trend of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trend {
    /// Failures a week that its weeks rise by, mean over seeds.
    pub slope: f64,
    /// How often slopes so far from 0 would be found, either way, if there were no trend; none of less than six seeds.
    pub p_value: Option<f64>,
    /// Seeds in which it falls.
    pub falling: usize,
}

impl RouteComparison {
    /// The later half of the weeks, counted from 0.
    pub fn late(&self) -> Range<usize> {
        self.weeks / 2..self.weeks
    }

    /// How a robot's failures develop over the weeks of a range.
    pub fn trend(&self, course: &RobotCourse, weeks: Range<usize>) -> Trend {
        let slopes = course.slopes(weeks);
        Trend {
            slope: Estimate::of(&slopes).mean,
            p_value: paired::p_value(&slopes),
            falling: slopes.iter().filter(|&&slope| slope < 0.0).count(),
        }
    }

    /// The failures of a robot's later weeks as a share of those of the robot that takes the shortest ways.
    pub fn of_shortest(&self, course: &RobotCourse) -> f64 {
        let baseline = self.courses.first().map_or(0.0, |first| first.failures(self.late()).mean);
        course.failures(self.late()).mean / baseline
    }
}

/// Sends all robots around; `progress` is told how many runs are done, of how many.
pub fn run(protocol: &RoutesProtocol, progress: &(impl Fn(u64, u64) + Sync)) -> Result<RouteComparison, RoutesError> {
    // The quick ones last, so that no thread is left with a long one at the end.
    let jobs: Vec<(RobotKind, u64)> = RobotKind::ALL
        .into_iter()
        .rev()
        .flat_map(|kind| (0..protocol.seeds).map(move |seed| (kind, protocol.first_seed.wrapping_add(seed))))
        .collect();
    let (done, total) = (AtomicU64::new(0), jobs.len() as u64);
    let runs = jobs
        .into_par_iter()
        .map(|(kind, seed)| {
            let run = robot::run(kind, seed, protocol);
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            Ok((kind, run?))
        })
        .collect::<Result<Vec<(RobotKind, Vec<Week>)>, RoutesError>>()?;
    let course = |kind: RobotKind| RobotCourse {
        kind,
        seeds: runs.iter().filter(|(other, _)| *other == kind).map(|(_, weeks)| weeks.clone()).collect(),
    };
    Ok(RouteComparison { courses: RobotKind::ALL.into_iter().map(course).collect(), weeks: protocol.weeks })
}
