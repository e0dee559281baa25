//! Unusual observations of a state, judged before they were learned.
//!
//! At an update each local day is judged by the model in force before the day, for the day's own score and before it is
//! learned; pending observations are judged by the model in force now. Both make the same runs, so a door that was left
//! open yesterday and is open still is one run. Cells of a grid keep none.
//!
//! Invariant: an observation is judged by a model that has not learned it. A state that no update has learned has no
//! unusual observations.

use std::{ops::Range, sync::Arc};

use tidemap_model::{
    JudgedReading, KEPT_CONFIDENCE, Periodicities, Sample, StateKind, StateModel, SurpriseRun, Surprises,
    selector::ModelSelector,
};

use super::{Confidence, ValueJudge};
use crate::{history::Reading, ids::StateId, view::MapView};

/// Maximum number of runs that a map keeps: 6 MB. If there are more, those that ended first go.
pub const MAP_RUNS_MAX: usize = 65_536;

/// A run of unusual observations of a state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateSurprise {
    /// The state.
    pub state: StateId,
    /// The run.
    pub run: SurpriseRun,
}

/// Judges observations of a state by a model that has not learned them, in their order.
pub(crate) fn judge(surprises: &mut Surprises, model: &StateModel, periodicities: &Periodicities, samples: &[Sample]) {
    if model.accumulator().observations() == 0 {
        return;
    }
    let expected = model.predict_in_force(periodicities, samples);
    let judged = samples.iter().zip(&expected);
    if model.kind() == StateKind::Probability {
        return judged.for_each(|(sample, &probability)| surprises.observe(judge_probability(sample, probability)));
    }
    let Some(judge) = ValueJudge::new(model, ModelSelector::default()) else { return };
    for (sample, &expected) in judged {
        let probability = judge.tail(sample.value, expected, sample.moment());
        surprises.observe(JudgedReading {
            utc_nanos: sample.utc_nanos,
            value: sample.value,
            probability,
            observed_probability: probability,
            is_above: sample.value > expected,
            is_unusual: probability <= 1.0 - KEPT_CONFIDENCE,
            is_unexpected: probability <= 1.0 - KEPT_CONFIDENCE,
        });
    }
}

/// Judges a reading of a probability state. A value between 0 and 1 counts as the nearer of the two, as in
/// [`super::is_anomalous`].
fn judge_probability(sample: &Sample, probability: f64) -> JudgedReading {
    let is_above = sample.value >= 0.5;
    let observed_probability = if is_above { probability } else { 1.0 - probability };
    JudgedReading {
        utc_nanos: sample.utc_nanos,
        value: sample.value,
        probability,
        observed_probability,
        is_above,
        is_unusual: observed_probability <= 1.0 - KEPT_CONFIDENCE,
        is_unexpected: observed_probability < 0.5,
    }
}

/// Drops the runs that ended first until the states have at most `max` together. Returns the number of runs that stay.
pub(crate) fn bound(models: &mut [Arc<StateModel>], max: usize) -> usize {
    let runs = || models.iter().flat_map(|model| model.surprises().runs());
    let count = runs().count();
    if count <= max {
        return count;
    }
    let mut ends: Vec<i64> = runs().map(|run| run.last_nanos).collect();
    let (_, &mut newest_dropped, _) = ends.select_nth_unstable(count - max - 1);
    // Runs that ended at one time all stay or are all dropped.
    let is_kept = |run: &SurpriseRun| run.last_nanos > newest_dropped;
    for model in models.iter_mut().filter(|model| !model.surprises().runs().iter().all(is_kept)) {
        let mut surprises = model.surprises().clone();
        surprises.retain(is_kept);
        *model = Arc::new(StateModel::clone(model).with_surprises(surprises));
    }
    models.iter().map(|model| model.surprises().runs().len()).sum()
}

/// A query for the unusual observations of states.
#[derive(Clone, Debug, PartialEq)]
pub struct SurpriseQuestion {
    /// Only runs that have a part from the first time up to, not including, the last time; nanoseconds UTC.
    pub within_nanos: Range<i64>,
    /// Minimum certainty of the model that the most surprising observation of a run would be the contrary or, for
    /// values, how far out that observation is: at least [`KEPT_CONFIDENCE`].
    pub confidence: Confidence,
    /// Maximum number of runs.
    pub top: usize,
}

impl MapView {
    /// The unusual observations of states, the most surprising first. Learned observations have the judgement from
    /// before they were learned. Pending readings (see [`MapView::pending_readings`]), ascending by time, are judged by
    /// the model in force.
    #[must_use]
    pub fn surprises(&self, states: &[(StateId, Vec<Reading>)], question: &SurpriseQuestion) -> Vec<StateSurprise> {
        let mut found: Vec<StateSurprise> = Vec::new();
        for (state, pending) in states {
            let surprises = self.surprises_with(*state, pending);
            let runs = surprises.runs().iter().filter(|run| question.asks_for(run));
            found.extend(runs.map(|&run| StateSurprise { state: *state, run }));
        }
        let order = |one: &StateSurprise, other: &StateSurprise| {
            let by_surprise = other.run.bits.total_cmp(&one.run.bits);
            by_surprise.then((one.state, one.run.first_nanos).cmp(&(other.state, other.run.first_nanos)))
        };
        found.sort_by(order);
        found.truncate(question.top);
        found
    }

    /// Number of runs of a state that were dropped to make room for others.
    #[must_use]
    pub fn dropped_surprises(&self, state: StateId) -> u64 {
        self.model(state).surprises().dropped()
    }

    /// The runs of a state with the runs of pending observations.
    fn surprises_with(&self, state: StateId, pending: &[Reading]) -> Surprises {
        let model = self.model(state);
        let mut surprises = model.surprises().clone();
        if !pending.is_empty() {
            let mut sample = self.sample_maker();
            let samples: Vec<Sample> = pending.iter().map(|&(nanos, value)| sample(nanos, value)).collect();
            judge(&mut surprises, model, &self.spec().periodicities, &samples);
        }
        surprises
    }
}

impl SurpriseQuestion {
    fn asks_for(&self, run: &SurpriseRun) -> bool {
        run.observed_probability <= 1.0 - self.confidence.get()
            && run.first_nanos < self.within_nanos.end
            && run.last_nanos >= self.within_nanos.start
    }
}

#[cfg(test)]
mod tests;
