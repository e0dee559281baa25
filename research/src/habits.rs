//! Calibration and accuracy of tidemap: simulated habits of real buildings, predicted day by day.
//!
//! Everything runs in one process, with the parts of a daemon: a robot's readings become observations in a
//! [`LiveMap`](tidemap_map::live_map::LiveMap), one for each habit and seed. Before each test day the state is
//! predicted for every ten minutes of the day, then the day is learned at midnight. Predictions are compared with the
//! hidden state, with simple tables, and with the probabilities that the intervals state. An interval is about the mean
//! of the state over an hour, so it is compared with the six hidden steps of a local hour.
//!
//! - `calendar.rs`: days and steps; `habit.rs`: the habits; `world.rs`: hidden states and readings;
//! - `learner.rs`: the map; `baselines.rs`: the tables; `score.rs`: the scores;
//! - `report.rs`: results.csv, errors.csv.
//!
//! Invariant: predictions use readings of earlier days only, and the same protocol gives the same figures for any
//! number of threads.

use std::{
    collections::VecDeque,
    sync::atomic::{AtomicU64, Ordering},
};

use rayon::prelude::*;
use tidemap_map::{live_map::InconsistentEvent, update::SumsUnavailable, view::MapView};

mod baselines;
mod calendar;
mod habit;
mod learner;
mod report;
mod score;
mod world;

#[cfg(test)]
mod tests;

pub use baselines::BASELINES;
pub use habit::{HABITS, Habit};
pub use report::{summary, write};
pub use score::{Errors, HourClaims, SURE_WITHIN, Scores, Sure};

use baselines::Baselines;
use calendar::HOUR_STEPS;
use learner::HabitLearner;
use world::HabitWorld;

/// The levels of the intervals.
pub const LEVELS: [f64; 4] = [0.5, 0.8, 0.9, 0.95];
/// Hours of which the true probability is less than this away from 0 or 1 are not uncertain; less a rounding error.
const UNCERTAIN: f64 = 0.05 - 1e-9;

/// The protocol of the experiment.
#[derive(Clone, Debug)]
pub struct HabitsProtocol {
    /// Number of worlds of each habit, at least 1.
    pub seeds: u64,
    /// The first seed; the others follow.
    pub first_seed: u64,
    /// The habits; all, if there is none.
    pub habits: Vec<&'static Habit>,
    /// The lead time in days, at least 1: a day is predicted with the readings until so many days before its end.
    pub ahead_days: u32,
}

/// Why the experiment fails.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum HabitsError {
    /// An event does not fit the map.
    Map(#[from] InconsistentEvent),
    /// The map cannot be read.
    Sums(#[from] SumsUnavailable),
    /// The simulation is inconsistent.
    #[error("{0}")]
    Setting(String),
}

impl HabitsError {
    fn setting(error: impl std::fmt::Display) -> Self {
        Self::Setting(error.to_string())
    }
}

/// The scores of a habit over all seeds.
#[derive(Clone, Debug)]
pub struct HabitScores {
    /// The habit.
    pub habit: &'static Habit,
    /// The scores of all its days that were predicted.
    pub scores: Scores,
}

/// The results of all habits.
#[derive(Clone, Debug)]
pub struct HabitsComparison {
    /// The habits, in the order of [`HABITS`].
    pub habits: Vec<HabitScores>,
}

/// Runs the habits; `progress` receives the numbers of finished and of all runs.
pub fn run(protocol: &HabitsProtocol, progress: &(impl Fn(u64, u64) + Sync)) -> Result<HabitsComparison, HabitsError> {
    let is_wanted =
        |habit: &&Habit| protocol.habits.is_empty() || protocol.habits.iter().any(|wanted| wanted.name == habit.name);
    let habits: Vec<&'static Habit> = HABITS.iter().filter(is_wanted).collect();
    let seeds = || (0..protocol.seeds).map(|seed| protocol.first_seed.wrapping_add(seed));
    let mut jobs: Vec<(usize, u64)> =
        (0..habits.len()).flat_map(|habit| seeds().map(move |seed| (habit, seed))).collect();
    // Habits with many days come first, so that no thread is left with one of them at the end.
    jobs.sort_by_key(|&(habit, _)| std::cmp::Reverse(habits[habit].test.1));
    let (done, total) = (AtomicU64::new(0), jobs.len() as u64);
    let runs = jobs
        .into_par_iter()
        .with_max_len(1)
        .map(|(habit, seed)| {
            let scores = scores_of(habits[habit], seed, protocol.ahead_days);
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            Ok((habit, scores?))
        })
        .collect::<Result<Vec<(usize, Scores)>, HabitsError>>()?;
    let of_habit = |(index, &habit): (usize, &&'static Habit)| {
        let mut scores = Scores::default();
        runs.iter().filter(|(habit, _)| *habit == index).for_each(|(_, run)| scores.join(run));
        HabitScores { habit, scores }
    };
    Ok(HabitsComparison { habits: habits.iter().enumerate().map(of_habit).collect() })
}

/// The scores of a habit with one seed at a lead time in days.
fn scores_of(habit: &Habit, seed: u64, ahead_days: u32) -> Result<Scores, HabitsError> {
    let world = HabitWorld::new(habit, seed).map_err(HabitsError::setting)?;
    let calendar = &world.calendar;
    let first_nanos = calendar.steps.first().map_or(0, |step| step.utc_nanos);
    let mut learner = HabitLearner::new(calendar.zone.clone(), first_nanos)?;
    let mut baselines = Baselines::new(calendar);
    let mut scores = Scores::default();
    let first_test_day = world.first_test_day(habit);
    // The views and baselines of the last midnights, the oldest first.
    let mut known: VecDeque<(MapView, Baselines)> = VecDeque::new();
    for day in 0..calendar.days.len() {
        known.push_back((learner.view(), baselines.clone()));
        if known.len() > ahead_days as usize {
            known.pop_front();
        }
        let oldest = known.front().filter(|_| known.len() == ahead_days as usize);
        if let Some((view, baselines)) = oldest.filter(|_| day >= first_test_day) {
            score_day(&mut scores, &world, day, view, baselines, ahead_days);
        }
        let next = calendar.steps.get(calendar.days[day].steps.end);
        // After the last day nothing is predicted.
        let Some(midnight_nanos) = next.map(|step| step.utc_nanos) else { break };
        baselines.learn(calendar, world.looks_of(day));
        learner.learn(world.looks_of(day), midnight_nanos)?;
    }
    Ok(scores)
}

/// Adds the scores of a day that no model has learned yet.
fn score_day(
    scores: &mut Scores,
    world: &HabitWorld,
    day: usize,
    view: &MapView,
    baselines: &Baselines,
    ahead_days: u32,
) {
    let HabitWorld { calendar, truth, values, .. } = world;
    let steps = calendar.days[day].steps.clone();
    let times: Vec<i64> = calendar.steps[steps.clone()].iter().map(|step| step.utc_nanos).collect();
    let middles: Vec<i64> = times.iter().copied().skip(HOUR_STEPS / 2).step_by(HOUR_STEPS).collect();
    let ahead = HabitLearner::ask(view, &times, &middles);
    for (step, &p) in steps.clone().zip(&ahead.values) {
        scores.auto.add(p, values[step]);
        scores.truth.add(truth[step], values[step]);
        for (errors, p) in scores.baselines.iter_mut().zip(baselines.predict(calendar, step, ahead_days)) {
            errors.add(p, values[step]);
        }
        for (sure, within) in scores.sure.iter_mut().zip(SURE_WITHIN) {
            sure.add(within, p, values[step]);
        }
    }
    for (hour, first) in steps.step_by(HOUR_STEPS).enumerate() {
        let of_hour = first..(first + HOUR_STEPS).min(truth.len());
        let habit = truth[of_hour.clone()].iter().sum::<f64>() / HOUR_STEPS as f64;
        if !(UNCERTAIN..=1.0 - UNCERTAIN).contains(&habit) {
            continue;
        }
        let mean = values[of_hour].iter().filter(|&&value| value).count() as f64 / HOUR_STEPS as f64;
        for (held, intervals) in scores.held.iter_mut().zip(&ahead.hours) {
            if let Some(interval) = intervals.get(hour) {
                held.add(interval, mean);
            }
        }
    }
}
