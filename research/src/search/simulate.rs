//! The searches: for every minute a plan by the predicted presence, and the time at which it reaches the person.
//!
//! Invariant: consecutive minutes with equal predictions share one plan.

use std::ops::Range;

use rayon::prelude::*;
use tidemap_model::{StateKind, models::TemporalModel as _};
use tidemap_plan::search::{Goal, SearchError, SearchOptions, search};

use super::{RecordedWorld, ReplayError};
use crate::{compared::ComparedModel, protocol::ModelEntry};

/// Consecutive minutes that one job searches.
const JOB_MINUTES: usize = 1440;
/// Least prediction of a node in log losses, so that one surprise does not outweigh a week.
const SHARE_MIN: f64 = 1e-3;

/// The times until the person was found.
#[derive(Clone, Debug, Default)]
pub struct FindTimes {
    /// Seconds after the robot left its start, ascending.
    secs: Vec<f64>,
}

impl FindTimes {
    /// Number of searches.
    pub fn count(&self) -> usize {
        self.secs.len()
    }

    /// The mean.
    pub fn mean_secs(&self) -> f64 {
        self.secs.iter().sum::<f64>() / self.secs.len().max(1) as f64
    }

    /// A quantile; `share` is 0.5 for the median. Between two values: the later.
    pub fn quantile_secs(&self, share: f64) -> f64 {
        let last = self.secs.len().saturating_sub(1);
        let at = (share * self.secs.len() as f64) as usize;
        self.secs.get(at.min(last)).copied().unwrap_or(0.0)
    }
}

/// Searches in the given minutes by a parameter set of a model that is trained on all minutes before `train_minutes`.
pub(super) fn by_model(
    world: &RecordedWorld,
    entry: &ModelEntry,
    set: usize,
    train_minutes: usize,
    minutes: Range<usize>,
) -> Result<FindTimes, ReplayError> {
    let models = trained(world, entry, set, train_minutes)?;
    find(world, minutes, |node, minute| models[node].predict(world.moment(minute)))
}

/// The mean of -ln p of the node where the person is, over the given minutes, by a parameter set of a model that is
/// trained on all minutes before them; p is the node's share of the predictions of all nodes, each at least
/// [`SHARE_MIN`].
pub(super) fn log_loss(
    world: &RecordedWorld,
    entry: &ModelEntry,
    set: usize,
    minutes: Range<usize>,
) -> Result<f64, ReplayError> {
    let models = trained(world, entry, set, minutes.start)?;
    let (mut sum, mut count) = (0.0, 0.0);
    for minute in minutes.clone() {
        let Some(room) = world.room(minute) else { continue };
        let moment = world.moment(minute);
        let predicted = |model: &ComparedModel| model.predict(moment).clamp(SHARE_MIN, 1.0);
        let total: f64 = models.iter().map(predicted).sum();
        sum -= (predicted(&models[room]) / total).ln();
        count += 1.0;
    }
    if count > 0.0 { Ok(sum / count) } else { Err(ReplayError::Nobody { from: minutes.start, until: minutes.end }) }
}

/// The models of all nodes, trained on all minutes before `train_minutes`.
fn trained(
    world: &RecordedWorld,
    entry: &ModelEntry,
    set: usize,
    train_minutes: usize,
) -> Result<Vec<ComparedModel>, ReplayError> {
    let set = &entry.sets[set];
    (0..world.names.len())
        .into_par_iter()
        .map(|node| {
            set.train(&world.samples(node, train_minutes), StateKind::Probability).map_err(|refused| {
                let model = format!("{} {}", entry.label, set.shown()).trim_end().to_owned();
                ReplayError::CannotTrain { model, place: world.names[node].clone(), refused }
            })
        })
        .collect()
}

/// Searches by an oracle that knows where the person is.
pub(super) fn by_truth(world: &RecordedWorld, minutes: Range<usize>) -> Result<FindTimes, ReplayError> {
    find(world, minutes, |node, minute| f64::from(u8::from(world.room(minute) == Some(node))))
}

fn find(
    world: &RecordedWorld,
    minutes: Range<usize>,
    predict: impl Fn(usize, usize) -> f64 + Sync,
) -> Result<FindTimes, ReplayError> {
    let starts: Vec<usize> = minutes.clone().step_by(JOB_MINUTES).collect();
    let mut secs = starts
        .into_par_iter()
        .map(|start| {
            let mut secs = Vec::with_capacity(JOB_MINUTES);
            let mut last: (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
            for minute in start..minutes.end.min(start + JOB_MINUTES) {
                let Some(room) = world.room(minute) else { continue };
                let predicted: Vec<f64> =
                    (0..world.names.len()).map(|node| predict(node, minute).clamp(0.0, 1.0)).collect();
                if predicted != last.0 {
                    last = (predicted.clone(), arrivals(world, &predicted)?);
                }
                secs.push(last.1[room]);
            }
            Ok(secs)
        })
        .collect::<Result<Vec<Vec<f64>>, SearchError>>()?
        .concat();
    if secs.is_empty() {
        return Err(ReplayError::Nobody { from: minutes.start, until: minutes.end });
    }
    secs.sort_by(f64::total_cmp);
    Ok(FindTimes { secs })
}

/// The times at which the robot arrives at each node, in seconds after it left its start.
fn arrivals(world: &RecordedWorld, predicted: &[f64]) -> Result<Vec<f64>, SearchError> {
    let goal = |(index, &probability): (usize, &f64)| Goal { node: world.roads.node(index), probability };
    let goals: Vec<Goal> = predicted.iter().enumerate().map(goal).collect();
    let plan = search(&world.roads, world.start, &goals, &SearchOptions::default(), || false)?;
    let mut arrivals = vec![f64::INFINITY; predicted.len()];
    for step in &plan.steps {
        if let Some(index) = world.roads.index_of(step.node) {
            arrivals[index] = step.arrival_secs;
        }
    }
    Ok(arrivals)
}
