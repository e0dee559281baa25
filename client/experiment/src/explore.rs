//! Exploration replayed: strategies that choose where to look, with models that learn from what was seen, in a world that
//! was recorded whole.
//!
//! The protocol is that of RAS 2017 (Santos et al., "Spatio-temporal exploration strategies for long-term autonomy of mobile
//! robots", Robotics and Autonomous Systems 88, sections 3 to 7): every place is a binary state and a location of its
//! own; plans and models are remade at local midnight; a visit shows its place at the middle of its slot; all places are
//! predicted for the middle of each slot, before what that slot's visit shows is known, and judged every minute; the
//! place that is visited counts as known (eq. 2). Invariant: nothing is predicted by what comes later, and the same
//! protocol gives the same figures, however many threads there are.

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;
use tidemap_model::models::CannotFit;
use tidemap_plan::strategy::StrategyError;

mod belief;
pub mod office;
mod picture;
mod protocol;
mod replay;
mod report;

#[cfg(test)]
mod tests;

pub use protocol::{PlacesProtocol, read};
pub use report::{summary, write};

use crate::place_recording::{PlaceRecording, RecordingError};
use belief::BeliefModel;
use office::OfficeProtocol;
use replay::VisitStrategy;

/// What a file wants explored.
#[derive(Clone, Debug, PartialEq)]
pub enum ExploreProtocol {
    /// A recorded world of places.
    Places(PlacesProtocol),
    /// A simulated office.
    Office(OfficeProtocol),
}

/// Days of a week.
const WEEK_DAYS: usize = 7;

/// Why a world cannot be explored.
#[derive(Debug, thiserror::Error)]
pub enum ExploreError {
    /// Its recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// It has fewer weeks than are to be scored apart.
    #[error("weeks {first} to {last} are to be scored apart, and the world has {found} whole weeks")]
    Weeks {
        /// First of them, from 1.
        first: usize,
        /// Last.
        last: usize,
        /// How many there are.
        found: usize,
    },
    /// A model that cannot be fitted.
    #[error("model {model} cannot be fitted: {refused}")]
    Fit {
        /// Which.
        model: String,
        /// Why.
        refused: CannotFit,
    },
    /// A plan that cannot be made.
    #[error("strategy {strategy}: {refused}")]
    VisitStrategy {
        /// Which strategy.
        strategy: &'static str,
        /// Why.
        refused: StrategyError,
    },
}

/// A strategy with a model, as they did over all seeds.
#[derive(Clone, Debug)]
pub struct StrategyResult {
    /// The strategy.
    pub plan: VisitStrategy,
    /// The model.
    pub model: BeliefModel,
    /// Share of states that were wrong, 0 to 1: of each seed, of each day.
    pub days: Vec<Vec<f64>>,
    /// Visits a day, on average.
    pub visits_per_day: f64,
}

/// A mean over seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Its standard error; none of a single seed.
    pub standard_error: Option<f64>,
}

impl StrategyResult {
    /// The share of states that were wrong on average over the days of a range, over seeds.
    pub fn error(&self, days: std::ops::Range<usize>) -> Estimate {
        let of_seed = |seed: &Vec<f64>| {
            let days = seed.get(days.clone()).unwrap_or_default();
            days.iter().sum::<f64>() / days.len().max(1) as f64
        };
        let errors: Vec<f64> = self.days.iter().map(of_seed).collect();
        let count = errors.len().max(1) as f64;
        let mean = errors.iter().sum::<f64>() / count;
        let squares: f64 = errors.iter().map(|error| (error - mean).powi(2)).sum();
        let standard_error = (errors.len() > 1).then(|| (squares / (count - 1.0) / count).sqrt());
        Estimate { mean, standard_error }
    }
}

/// What came of exploring.
#[derive(Debug)]
pub struct Exploration {
    /// Every strategy with every model, in the order of the protocol, strategy by strategy.
    pub pairs: Vec<StrategyResult>,
    /// Days of the world.
    pub days: usize,
}

/// Explores a world with every pair and seed; `progress` is told how many runs are done, of how many.
pub fn run(protocol: &PlacesProtocol, progress: &(impl Fn(u64, u64) + Sync)) -> Result<Exploration, ExploreError> {
    let world = PlaceRecording::read(&protocol.world, protocol.slot_minutes)?;
    let weeks = world.days() / WEEK_DAYS;
    if let Some((first, last)) = protocol.weeks.filter(|&(_, last)| last > weeks) {
        return Err(ExploreError::Weeks { first, last, found: weeks });
    }
    explore(&world, protocol, progress)
}

fn explore(
    world: &PlaceRecording,
    protocol: &PlacesProtocol,
    progress: &(impl Fn(u64, u64) + Sync),
) -> Result<Exploration, ExploreError> {
    let pairs: Vec<(VisitStrategy, BeliefModel)> =
        protocol.plans.iter().flat_map(|&plan| protocol.models.iter().map(move |&model| (plan, model))).collect();
    let jobs: Vec<(VisitStrategy, BeliefModel, u64)> =
        pairs.iter().flat_map(|&(plan, model)| (0..protocol.seeds).map(move |seed| (plan, model, seed))).collect();
    let (done, total) = (AtomicU64::new(0), jobs.len() as u64);
    let runs = jobs
        .into_par_iter()
        .map(|(plan, model, seed)| {
            let run = replay::replay(world, protocol.exploration, plan, model, seed);
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            run
        })
        .collect::<Result<Vec<replay::Run>, ExploreError>>()?;
    let seeds = (protocol.seeds as usize).max(1);
    let of_pair = |(&(plan, model), runs): (&(VisitStrategy, BeliefModel), &[replay::Run])| {
        let visits: u64 = runs.iter().map(|run| run.visits).sum();
        let visits_per_day = visits as f64 / (runs.len() * world.days()).max(1) as f64;
        StrategyResult { plan, model, days: runs.iter().map(|run| run.errors.clone()).collect(), visits_per_day }
    };
    Ok(Exploration { pairs: pairs.iter().zip(runs.chunks(seeds)).map(of_pair).collect(), days: world.days() })
}
