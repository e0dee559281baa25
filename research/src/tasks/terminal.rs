//! An information terminal on wheels: where should it stand in each quarter of an hour, so that people use it?
//!
//! The visitors of a simulated house come to eight places by the hour and the day of the week. A robot stands in one
//! place for each slot of a day and learns, at midnight, in which of its slots somebody came (N. Hawes et al., IEEE RAM
//! 2017, "Predicting Human–Robot Interaction"; M. Kulich et al., MESAS 2016). It plans the next day by the learned
//! probabilities and by the information gain of an observation.
//!
//! - `visitors.rs`: the house; `robot.rs`: the robots; `report.rs`: results.csv, weeks.csv.
//!
//! Invariant: with one seed all robots meet the same visitors; plans use earlier days only, except plans of the robots
//! that are called best or oracle; the same protocol gives the same figures for any number of threads.

use std::{
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};

use rayon::prelude::*;
use tidemap_map::{live_map::InconsistentEvent, update::SumsUnavailable};
use tidemap_plan::strategy::StrategyError;

use crate::seed_mean::SeedMean;

mod report;
mod robot;
mod visitors;

#[cfg(test)]
mod tests;

pub use report::{summary, write};
pub use robot::TerminalRobotKind;

/// The protocol of a comparison of terminals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TerminalProtocol {
    /// Number of houses with different visitors, at least 1.
    pub seeds: u64,
    /// The first seed; the others follow.
    pub first_seed: u64,
    /// Weeks of each run, at least 1.
    pub weeks: usize,
}

/// Why terminals cannot be compared.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum TerminalError {
    /// An event does not fit the map.
    Map(#[from] InconsistentEvent),
    /// The map cannot be read.
    Sums(#[from] SumsUnavailable),
    /// A day cannot be planned.
    Strategy(#[from] StrategyError),
    /// The house is inconsistent.
    #[error("{0}")]
    Setting(String),
}

impl TerminalError {
    fn setting(error: impl std::fmt::Display) -> Self {
        Self::Setting(error.to_string())
    }
}

/// The number of uses of a robot, by seed and week, in each hour of its work.
#[derive(Clone, Debug)]
pub struct TerminalCourse {
    /// The method by which the terminal chooses its places.
    pub kind: TerminalRobotKind,
    /// The weeks of each seed.
    pub seeds: Vec<Vec<f64>>,
}

impl TerminalCourse {
    /// Interactions an hour in the weeks of a range, counted from 0, over the seeds.
    pub fn per_hour(&self, weeks: Range<usize>) -> SeedMean {
        SeedMean::of(&self.by_seed(weeks))
    }

    /// Interactions an hour in the weeks of a range, by seed.
    fn by_seed(&self, weeks: Range<usize>) -> Vec<f64> {
        let count = weeks.len().max(1) as f64;
        let mean = |seed: &Vec<f64>| seed.get(weeks.clone()).unwrap_or_default().iter().sum::<f64>() / count;
        self.seeds.iter().map(mean).collect()
    }
}

/// The results of all robots.
#[derive(Clone, Debug)]
pub struct TerminalComparison {
    /// The robots, in the order of [`TerminalRobotKind::ALL`].
    pub courses: Vec<TerminalCourse>,
    /// Number of weeks.
    pub weeks: usize,
}

impl TerminalComparison {
    /// Interactions an hour of a robot, divided by the interactions of this kind; and the number of seeds in which they
    /// are more.
    fn against(&self, course: &TerminalCourse, kind: TerminalRobotKind) -> (f64, usize) {
        let all = 0..self.weeks;
        let Some(other) = self.courses.iter().find(|course| course.kind == kind) else { return (f64::NAN, 0) };
        let pairs = course.by_seed(all.clone()).into_iter().zip(other.by_seed(all.clone()));
        let above = pairs.filter(|(own, other)| own > other).count();
        (course.per_hour(all.clone()).mean / other.per_hour(all).mean, above)
    }
}

/// Runs all robots; `progress` receives the numbers of finished and of all runs.
pub fn run(
    protocol: &TerminalProtocol,
    progress: &(impl Fn(u64, u64) + Sync),
) -> Result<TerminalComparison, TerminalError> {
    let (done, total) = (AtomicU64::new(0), protocol.seeds);
    let seeds: Vec<u64> = (0..total).map(|seed| protocol.first_seed.wrapping_add(seed)).collect();
    let runs = seeds
        .into_par_iter()
        .map(|seed| {
            let run = robot::run(seed, protocol.weeks);
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            run
        })
        .collect::<Result<Vec<Vec<Vec<f64>>>, TerminalError>>()?;
    let course = |(index, kind): (usize, TerminalRobotKind)| TerminalCourse {
        kind,
        seeds: runs.iter().map(|robots| robots[index].clone()).collect(),
    };
    let courses = TerminalRobotKind::ALL.into_iter().enumerate().map(course).collect();
    Ok(TerminalComparison { courses, weeks: protocol.weeks })
}
