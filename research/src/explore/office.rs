//! A simulated office explored with and without a temporal model, as in RA-L 2016, section IV.C (Santos et al.,
//! "Spatio-temporal exploration strategies for long-term autonomy").
//!
//! Each explorer goes on a number of tours a day, with its own map of the same office, the same sensor and the same
//! first day. Spatial-only exploration plans on its last map, at regular times. Spatio-temporal exploration plans on
//! the predictions of its map for the time of the tour, in slots drawn in proportion to the expected information of
//! their tours. In the middle of every slot, before its tours, the predictions of each explorer are compared with the
//! truth, over all cells that any explorer has seen. The world is [`tidemap_sim::ExploredOffice`]: the truth of every
//! cell at every time is a function of the seed.
//!
//! - `protocol.rs`: YAML to [`OfficeProtocol`]; `space.rs`: the office as lattice, truth and scene;
//! - `explorer.rs`: a map in this process ([`LiveMap`](tidemap_map::live_map::LiveMap)) with its tours and
//!   observations;
//! - `run.rs`: goes slot by slot: all explorers are judged before any tour takes place; updates run at midnight;
//! - `report.rs`: results.csv, slots.csv; `picture.rs`: exploration.svg.
//!
//! A tour is planned by `plan_tour` on the explorer's prediction; an observation is `ViewScorer::cells` on the truth,
//! and becomes one scan. A last map is certain of all cells that it has seen, so its tours end when the office is
//! known; unused goals of a plan go to cells that were not seen since a round began. The slots of the first day are
//! random and equal for all; regular times would make periods of 24 h / i and 24 h / (24 - i) indistinguishable.
//!
//! Invariant: predictions use earlier observations only, and the same protocol gives the same figures for any number of
//! threads.

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;
use tidemap_map::{live_map::InconsistentEvent, update::SumsUnavailable};
use tidemap_plan::{day::DayError, predicted::PredictError, strategy::StrategyError, tour::TourError};
use tidemap_sim::ExploredOffice;

use crate::paired;

mod explorer;
mod picture;
mod protocol;
mod report;
mod run;
mod space;

#[cfg(test)]
mod tests;

pub use explorer::ExplorerKind;
pub use protocol::OfficeProtocol;
pub(super) use protocol::RawOffice;
pub use report::{summary, write};

/// Why an office cannot be explored.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum OfficeError {
    /// An event does not fit the map.
    Map(#[from] InconsistentEvent),
    /// The map cannot be read.
    Sums(#[from] SumsUnavailable),
    /// A prediction fails.
    Predict(#[from] PredictError),
    /// A tour cannot be planned.
    Tour(#[from] TourError),
    /// A schedule fails.
    Strategy(#[from] StrategyError),
    /// A day has no slots.
    Day(#[from] DayError),
    /// The office and its map are inconsistent.
    #[error("{0}")]
    Setting(String),
}

impl OfficeError {
    fn setting(error: impl std::fmt::Display) -> Self {
        Self::Setting(error.to_string())
    }
}

/// The course of an explorer in a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExplorerCourse {
    /// The share of wrongly predicted cells, 0 to 1, in each slot; none before any observation.
    pub errors: Vec<Option<f64>>,
    /// Cells that this explorer saw changed, for each day.
    pub changes: Vec<u64>,
    /// Cells that this explorer saw for the first time, for each day.
    pub discovered: Vec<u64>,
    /// Tours with at least one observation, for each day.
    pub tours: Vec<u64>,
    /// The number of these tours from 8:00 to 18:00, for each day.
    pub tours_by_day: Vec<u64>,
}

/// The results of all runs.
#[derive(Debug)]
pub struct OfficeExploration {
    /// By seed, then by explorer, in the order of the protocol.
    pub runs: Vec<Vec<ExplorerCourse>>,
}

/// The figures of an explorer on a day, over all seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct DayFigures {
    /// The day, from 1.
    pub day: usize,
    /// The explorer.
    pub kind: ExplorerKind,
    /// Mean error over slots and seeds, 0 to 1.
    pub error: f64,
    /// The error minus the error of the first explorer.
    pub difference: f64,
    /// For each seed, the p-value of that difference over the slots of the day; empty for the first explorer.
    pub p_values: Vec<f64>,
    /// Number of seeds with a significant difference below 0.
    pub better: usize,
    /// Number of seeds with a significant difference above 0.
    pub worse: usize,
    /// Changed cells seen in a tour, mean over seeds.
    pub changes_per_tour: f64,
    /// Changed cells seen, mean over seeds.
    pub changes: f64,
    /// Cells seen for the first time, mean over seeds.
    pub discovered: f64,
    /// Tours, mean over seeds.
    pub tours: f64,
    /// Tours from 8:00 to 18:00, mean over seeds.
    pub tours_by_day: f64,
}

/// Differences with a lower p-value are significant.
const SIGNIFICANCE: f64 = 0.05;

/// Explores the office with every seed; `progress` receives the numbers of finished and of all days.
pub fn run(protocol: &OfficeProtocol, progress: &(impl Fn(u64, u64) + Sync)) -> Result<OfficeExploration, OfficeError> {
    let (done, total) = (AtomicU64::new(0), protocol.seeds * protocol.days as u64);
    let day_done = || progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
    let seeds: Vec<u64> = (0..protocol.seeds).collect();
    let runs = seeds
        .into_par_iter()
        .map(|seed| run::explore(protocol, &ExploredOffice::new(seed, protocol.rooms), seed, &day_done))
        .collect::<Result<_, OfficeError>>()?;
    Ok(OfficeExploration { runs })
}

impl OfficeExploration {
    /// Every day of every explorer, day by day.
    pub fn days(&self, protocol: &OfficeProtocol) -> Vec<DayFigures> {
        let explorers = || protocol.explorers.iter().enumerate();
        (0..protocol.days)
            .flat_map(|day| explorers().map(move |(index, &kind)| self.day(protocol, day, index, kind)))
            .collect()
    }

    fn day(&self, protocol: &OfficeProtocol, day: usize, index: usize, kind: ExplorerKind) -> DayFigures {
        let slots = day * protocol.slots()..(day + 1) * protocol.slots();
        let errors = |course: &ExplorerCourse| -> Vec<f64> {
            course.errors.get(slots.clone()).unwrap_or_default().iter().flatten().copied().collect()
        };
        let mean = |value_of: &dyn Fn(&Vec<ExplorerCourse>) -> f64| {
            self.runs.iter().map(value_of).sum::<f64>() / self.runs.len().max(1) as f64
        };
        let mean_of = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len().max(1) as f64;
        let error = |index: usize| mean(&|run| mean_of(&errors(&run[index])));
        let count = |value_of: fn(&ExplorerCourse) -> &Vec<u64>| {
            mean(&|run| value_of(&run[index]).get(day).map_or(0.0, |&count| count as f64))
        };
        let (mut p_values, mut better, mut worse) = (Vec::new(), 0, 0);
        for run in self.runs.iter().filter(|_| index > 0) {
            let differences: Vec<f64> =
                errors(&run[index]).into_iter().zip(errors(&run[0])).map(|(one, first)| one - first).collect();
            let p_value = paired::p_value(&differences).unwrap_or(1.0);
            let is_significant = p_value < SIGNIFICANCE;
            let difference = mean_of(&differences);
            better += usize::from(is_significant && difference < 0.0);
            worse += usize::from(is_significant && difference > 0.0);
            p_values.push(p_value);
        }
        let (changes, tours) = (count(|course| &course.changes), count(|course| &course.tours));
        DayFigures {
            day: day + 1,
            kind,
            error: error(index),
            difference: error(index) - error(0),
            p_values,
            better,
            worse,
            changes_per_tour: changes / tours.max(1.0),
            changes,
            discovered: count(|course| &course.discovered),
            tours,
            tours_by_day: count(|course| &course.tours_by_day),
        }
    }

    /// The mean error over seeds in a slot; none before any observation.
    pub fn error_at(&self, index: usize, slot: usize) -> Option<f64> {
        let errors: Vec<f64> =
            self.runs.iter().filter_map(|run| run.get(index)?.errors.get(slot).copied().flatten()).collect();
        (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
    }
}
