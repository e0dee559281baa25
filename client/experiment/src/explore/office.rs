//! A simulated office explored, with and without time, as in RA-L 2016, section IV.C (Santos et al., "Spatio-temporal
//! exploration strategies for long-term autonomy").
//!
//! Explorers go on so many tours a day, each with its own map of the same office, the same sensor, and the same first
//! day. Spatial-only exploration plans on its last map, at even distances of time; spatio-temporal exploration plans on
//! what its map predicts for the time of the tour, in slots drawn in proportion to what their tours are expected to
//! tell. What each expects of all cells that anybody has seen is compared with the truth in the middle of every slot,
//! before that slot's tours. Invariant: nothing is predicted by what comes later, and the same protocol gives the same
//! figures, however many threads there are.

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;
use tidemap_map::{grid::tile::TileUnavailable, live_map::InconsistentEvent};
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

/// Why an office could not be explored.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum OfficeError {
    /// A map that was not told what it can know.
    Map(#[from] InconsistentEvent),
    /// A map that could not be read.
    Tile(#[from] TileUnavailable),
    /// A prediction.
    Predict(#[from] PredictError),
    /// A tour.
    Tour(#[from] TourError),
    /// A schedule.
    Strategy(#[from] StrategyError),
    /// A day.
    Day(#[from] DayError),
    /// Properties of the maps.
    #[error("{0}")]
    Setting(String),
}

/// What an explorer did in a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExplorerCourse {
    /// Of each slot from the first, the share of cells that it expects wrongly, 0 to 1; none before anything was seen.
    pub errors: Vec<Option<f64>>,
    /// Of each day, cells seen in another state than this explorer had seen them in before.
    pub changes: Vec<u64>,
    /// Of each day, cells that this explorer had never seen before.
    pub discovered: Vec<u64>,
    /// Of each day, tours that looked from at least one goal.
    pub tours: Vec<u64>,
    /// Of each day, tours from eight to six.
    pub tours_by_day: Vec<u64>,
}

/// What came of exploring.
#[derive(Debug)]
pub struct OfficeExploration {
    /// By seed, then by explorer, in the order of the protocol.
    pub runs: Vec<Vec<ExplorerCourse>>,
}

/// An explorer on a day, over all seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct DayFigures {
    /// From 1.
    pub day: usize,
    /// Which.
    pub kind: ExplorerKind,
    /// Mean error over slots and seeds, 0 to 1.
    pub error: f64,
    /// The same less that of the first explorer.
    pub difference: f64,
    /// Of each seed the p-value of that difference over the slots of the day; none of the first explorer.
    pub p_values: Vec<f64>,
    /// Seeds with a difference below 0 and a p-value below 0.05.
    pub better: usize,
    /// Seeds with one above 0 and such a p-value.
    pub worse: usize,
    /// Changed cells seen in a tour, mean over seeds.
    pub changes_per_tour: f64,
    /// Changed cells seen, mean over seeds.
    pub changes: f64,
    /// Cells seen for the first time, mean over seeds.
    pub discovered: f64,
    /// Tours, mean over seeds.
    pub tours: f64,
    /// Tours from eight to six, mean over seeds.
    pub tours_by_day: f64,
}

/// Differences below this p-value count.
const SIGNIFICANCE: f64 = 0.05;

/// Explores the office with every seed; `progress` is told how many days are done, of how many.
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
        let mean = |of: &dyn Fn(&Vec<ExplorerCourse>) -> f64| {
            self.runs.iter().map(of).sum::<f64>() / self.runs.len().max(1) as f64
        };
        let mean_of = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len().max(1) as f64;
        let error = |index: usize| mean(&|run| mean_of(&errors(&run[index])));
        let count = |of: fn(&ExplorerCourse) -> &Vec<u64>| {
            mean(&|run| of(&run[index]).get(day).map_or(0.0, |&count| count as f64))
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

    /// The mean error over seeds in a slot, from the first; none before anything was seen.
    pub fn error_at(&self, index: usize, slot: usize) -> Option<f64> {
        let errors: Vec<f64> =
            self.runs.iter().filter_map(|run| run.get(index)?.errors.get(slot).copied().flatten()).collect();
        (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
    }
}
