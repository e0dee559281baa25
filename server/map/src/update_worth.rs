//! Judges whether an update of a map is worth it, from an extract of the pending observations.
//!
//! Invariant: only readings that the view's generation has not learned are judged.

use tidemap_model::{Sample, UpdateWorth};

use crate::{history::Reading, ids::StateId, row_samples::RequestedReadings, view::MapView};

#[cfg(test)]
mod tests;

impl MapView {
    /// The expected gain from learning pending observations of states, for all of these states together: see
    /// [`UpdateWorth`]. At most `readings_max` readings of a state are judged, because rows of changes represent many.
    #[must_use]
    pub fn update_worth(&self, pending: Vec<(StateId, Vec<Reading>)>, readings_max: usize) -> UpdateWorth {
        let requested = RequestedReadings { within_nanos: i64::MIN..i64::MAX, at_most: readings_max };
        let mut sample = self.sample_maker();
        let mut worth = UpdateWorth::default();
        for (state, observations) in pending {
            let readings = self.pending_readings(state, observations, &requested);
            let samples: Vec<Sample> = readings.iter().map(|&(nanos, value)| sample(nanos, value)).collect();
            if let Some(of_state) = UpdateWorth::of_state(self.model(state), &self.spec().periodicities, &samples) {
                worth.add(&of_state);
            }
        }
        worth
    }
}
