//! Trains cheap models day by day, while the first days of a state are learned in one update.
//!
//! If a short record comes at once, models trained after the update would never have been scored, and could not be
//! chosen before the next day is learned. So cheap models are trained after each day here, on the days on which nightly
//! updates would have trained them. Invariant: a model has seen only days before those that it is scored on.

use super::{StateModel, UpdateRules};
use crate::{LocalDay, Periodicities, Sample, models::Readings};

/// With more days, models are trained at the end of the update and join on the day after.
const DAYS_MAX: usize = 14;
/// With more observations, the training would delay the update.
const OBSERVATIONS_MAX: usize = 500_000;

impl StateModel {
    /// Whether an update with these samples, in order of time, trains after each day.
    pub(super) fn trains_day_by_day(&self, rules: UpdateRules, samples: &[Sample]) -> bool {
        let is_first = self.accumulator.last_nanos().is_none();
        let days = || samples.chunk_by(|one, next| one.local_day() == next.local_day()).take(DAYS_MAX + 1).count();
        rules.trains_day_by_day && is_first && samples.len() <= OBSERVATIONS_MAX && days() <= DAYS_MAX
    }

    /// Trains the cheap models that are due after a day; `seen`: all samples so far.
    pub(super) fn train_after_day(
        &mut self,
        periodicities: &Periodicities,
        rules: UpdateRules,
        day: LocalDay,
        seen: &[Sample],
    ) {
        let since = self.alternatives().and_then(|known| known.training_since());
        let from = seen.partition_point(|sample| since.is_some_and(|since| sample.local_day() < since));
        let half_life_secs = rules.half_life_days.map(|days| days * 86_400.0);
        let readings = Readings { half_life_secs, ..Readings::new(&seen[from..]) };
        for kind in rules.models.trained().filter(|kind| kind.is_cheap()) {
            if !self.is_training_due(kind) {
                continue;
            }
            // If the training fails, the state keeps the model that it has.
            if let Ok(model) = kind.train(readings, self.kind(), periodicities)
                && let Some(known) = &mut self.alternatives
            {
                known.set_trained(kind, model, day);
            }
        }
    }
}
