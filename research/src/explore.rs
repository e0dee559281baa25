//! Exploration replayed: strategies choose which place to visit, models learn from the visits, in a world that was
//! recorded completely.
//!
//! The protocol is the one of RAS 2017 (Santos et al., "Spatio-temporal exploration strategies for long-term autonomy
//! of mobile robots", Robotics and Autonomous Systems 88, sections 3 to 7). Every place is a binary state and a
//! location. Schedules and models are renewed at local midnight; persistence and short-term memory at every visit. A
//! visit observes its place at the middle of its slot. All places are predicted for the middle of each slot, before the
//! visit of that slot is known, and judged every minute; the visited place counts as known (eq. 2).
//!
//! A visit shows where the person is for the rest of the slot; this is used for the visited place only, as in eq. 2.
//! The presence model ([`tidemap_model::models::Presence`]) is the only model of all places together: a hidden Markov
//! chain over places, because one person in one of ten rooms makes each visit informative about all of them. The best
//! strategy with it, `online-error`, computes at each slot where the current prediction is most likely wrong, and
//! whether later slots of the last days had more to gain than the remaining visits can pay for.
//!
//! - `protocol.rs`: YAML to [`ExploreProtocol`]; `place_recording.rs`: rows `FROM UNTIL PLACE` to a place for every
//!   minute;
//! - `belief.rs`: the explorer's knowledge; its models are trained at midnight (`belief/learner.rs`);
//! - `replay.rs`: one run of a strategy with a model and a seed; runs are independent and parallel;
//! - `report.rs`: results.csv, weeks.csv; `picture.rs`: exploration.svg.
//!
//! With the key `office` the world is a simulated office, see [`office`].
//!
//! Invariant: predictions use earlier observations only, and the same protocol gives the same figures for any number of
//! threads.

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;
use tidemap_model::models::CannotTrain;
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

use crate::{
    place_recording::{PlaceRecording, RecordingError},
    seed_mean::SeedMean,
};
use belief::BeliefModel;
use office::OfficeProtocol;
use replay::{Explorer, VisitStrategy, VisitWorth};

/// The protocol of an exploration.
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
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum ExploreError {
    /// The recording is invalid.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The recording has fewer weeks than the protocol scores separately.
    #[error("weeks {first} to {last} are scored separately, and the world has {found} whole weeks")]
    Weeks { first: usize, last: usize, found: usize },
    /// A model cannot be trained.
    #[error("model {model} cannot be trained: {refused}")]
    CannotTrain { model: String, refused: CannotTrain },
    /// A strategy fails.
    #[error("strategy {strategy}: {refused}")]
    Strategy { strategy: &'static str, refused: StrategyError },
}

/// The result of a strategy with a model and a share of slots over all seeds.
#[derive(Clone, Debug)]
pub struct StrategyResult {
    /// The share of slots that may be used for visits, 0 to 1.
    pub exploration: f64,
    /// The strategy.
    pub strategy: VisitStrategy,
    /// The measure of the worth of a visit.
    pub worth: VisitWorth,
    /// The model.
    pub model: BeliefModel,
    /// Share of wrong states, 0 to 1, of each seed, of each day.
    pub days: Vec<Vec<f64>>,
    /// Mean number of visits in a day.
    pub visits_per_day: f64,
}

impl StrategyResult {
    /// The mean share of wrong states over the days of a range.
    pub fn error(&self, days: std::ops::Range<usize>) -> SeedMean {
        let of_seed = |seed: &Vec<f64>| {
            let days = seed.get(days.clone()).unwrap_or_default();
            days.iter().sum::<f64>() / days.len().max(1) as f64
        };
        SeedMean::of(&self.days.iter().map(of_seed).collect::<Vec<f64>>())
    }
}

/// The results of an exploration.
#[derive(Debug)]
pub struct Exploration {
    /// Every strategy with every model, in the order of the protocol: by share of slots, then strategy by
    /// strategy, then by worth.
    pub results: Vec<StrategyResult>,
    /// Days of the world.
    pub days: usize,
}

/// Explores a world with every strategy, model and seed; `progress` receives the numbers of finished and of all runs.
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
    let (seeds, days) = (protocol.seeds as usize, world.days());
    let mut explorers: Vec<Explorer> = Vec::new();
    for &exploration in &protocol.explorations {
        for &strategy in &protocol.strategies {
            for &worth in &protocol.worths {
                let explorer = |&model: &BeliefModel| Explorer { exploration, strategy, worth, model };
                explorers.extend(protocol.models.iter().map(explorer));
            }
        }
    }
    let (done, total) = (AtomicU64::new(0), (explorers.len() * seeds) as u64);
    let runs = (0..explorers.len() * seeds)
        .into_par_iter()
        .map(|job| {
            let run = replay::replay(world, explorers[job / seeds], (job % seeds) as u64);
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            run
        })
        .collect::<Result<Vec<replay::Run>, ExploreError>>()?;
    let result = |(&explorer, runs): (&Explorer, &[replay::Run])| {
        let Explorer { exploration, strategy, worth, model } = explorer;
        let visits: u64 = runs.iter().map(|run| run.visits).sum();
        let visits_per_day = visits as f64 / (runs.len() * days).max(1) as f64;
        let days = runs.iter().map(|run| run.errors.clone()).collect();
        StrategyResult { exploration, strategy, worth, model, days, visits_per_day }
    };
    Ok(Exploration { results: explorers.iter().zip(runs.chunks(seeds.max(1))).map(result).collect(), days })
}
