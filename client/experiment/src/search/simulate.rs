//! The searches themselves: for each minute a walk by what is expected then, and when it comes to where the person is.
//!
//! Invariant: equal expectations give the same walk, so that it is planned once where they follow one another.

use std::ops::Range;

use rayon::prelude::*;
use tidemap_plan::search::{Goal, SearchError, SearchOptions, search};

use super::{RecordedWorld, ReplayError};
use crate::{
    parameter_set::{FittedModel, ValueKind},
    protocol::ModelEntry,
};

/// Minutes that are searched one after another by one thread.
const PIECE: usize = 1440;

/// When the person was found.
#[derive(Clone, Debug, Default)]
pub struct FindTimes {
    /// Seconds after the robot left its start, ascending.
    secs: Vec<f64>,
}

impl FindTimes {
    fn of(mut secs: Vec<f64>) -> FindTimes {
        secs.sort_by(f64::total_cmp);
        FindTimes { secs }
    }

    /// How many searches there were.
    pub fn count(&self) -> usize {
        self.secs.len()
    }

    /// The mean, in seconds.
    pub fn mean_secs(&self) -> f64 {
        self.secs.iter().sum::<f64>() / self.secs.len().max(1) as f64
    }

    /// The time within which a share of the searches, 0 to 1, has found her: 0.5 is the median, of two middle ones the later.
    pub fn quantile_secs(&self, share: f64) -> f64 {
        let last = self.secs.len().saturating_sub(1);
        let at = (share * self.secs.len() as f64) as usize;
        self.secs.get(at.min(last)).copied().unwrap_or(0.0)
    }
}

/// Searches of some minutes by a candidate of a model that has learned all before the minute `learned`.
pub fn by_model(
    world: &RecordedWorld,
    entry: &ModelEntry,
    candidate: usize,
    learned: usize,
    minutes: Range<usize>,
) -> Result<FindTimes, ReplayError> {
    let chosen = &entry.candidates[candidate];
    let models = (0..world.names.len())
        .into_par_iter()
        .map(|node| {
            chosen.fit(&world.samples(node, learned), ValueKind::Probability).map_err(|refused| {
                let model = format!("{} {}", entry.label, chosen.shown());
                let (model, place) = (model.trim_end().to_owned(), world.names[node].clone());
                ReplayError::Fit { model, place, refused }
            })
        })
        .collect::<Result<Vec<FittedModel>, ReplayError>>()?;
    find(world, minutes, |node, minute| models[node].predict(world.moment(minute)))
}

/// Searches by who knows where the person is.
pub fn by_truth(world: &RecordedWorld, minutes: Range<usize>) -> Result<FindTimes, ReplayError> {
    find(world, minutes, |node, minute| f64::from(u8::from(world.room(minute) == Some(node))))
}

fn find(
    world: &RecordedWorld,
    minutes: Range<usize>,
    expect: impl Fn(usize, usize) -> f64 + Sync,
) -> Result<FindTimes, ReplayError> {
    let pieces: Vec<Range<usize>> =
        minutes.clone().step_by(PIECE).map(|from| from..minutes.end.min(from + PIECE)).collect();
    let found = pieces
        .into_par_iter()
        .map(|piece| {
            let mut found = Vec::with_capacity(piece.len());
            let mut last: (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
            for minute in piece {
                let Some(room) = world.room(minute) else { continue };
                let expected: Vec<f64> =
                    (0..world.names.len()).map(|node| expect(node, minute).clamp(0.0, 1.0)).collect();
                if expected != last.0 {
                    last = (expected.clone(), arrivals(world, &expected)?);
                }
                found.push(last.1[room]);
            }
            Ok(found)
        })
        .collect::<Result<Vec<Vec<f64>>, SearchError>>()?
        .concat();
    if found.is_empty() {
        return Err(ReplayError::Nobody { from: minutes.start, until: minutes.end });
    }
    Ok(FindTimes::of(found))
}

/// When the robot comes to each node, in seconds after it left its start.
fn arrivals(world: &RecordedWorld, expected: &[f64]) -> Result<Vec<f64>, SearchError> {
    let goal = |(index, &probability): (usize, &f64)| Goal { node: world.roads.node(index), probability };
    let goals: Vec<Goal> = expected.iter().enumerate().map(goal).collect();
    let plan = search(&world.roads, world.start, &goals, &SearchOptions::default(), || false)?;
    let mut arrivals = vec![f64::INFINITY; expected.len()];
    for step in &plan.steps {
        if let Some(index) = world.roads.index_of(step.node) {
            arrivals[index] = step.arrival_secs;
        }
    }
    Ok(arrivals)
}
