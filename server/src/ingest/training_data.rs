//! What updates have folded in of named states, from history files and from what no save has kept yet, for the update that
//! fits models to it.
//!
//! Invariant: each reading is given once, and the same ones in the same order whether they are in files or not: so an update
//! that is run again after a crash fits the same models.

use std::sync::{Arc, OnceLock};

use tidemap_map::{
    history::HistoryPiece,
    refit::{StateReadings, WantedReadings},
};
use tidemap_model::Sample;
use tidemap_store::{History, StateFiles};

#[cfg(test)]
mod tests;

/// What the updates before one have folded in.
#[derive(Debug)]
pub(super) struct TrainingData {
    /// The generations that are not in `unsaved`.
    stored: History,
    /// Its files, once they have been asked for.
    files: OnceLock<Result<StateFiles, String>>,
    /// Ascending by generation.
    unsaved: Vec<Arc<HistoryPiece>>,
}

impl TrainingData {
    /// What the updates before `generation` have folded in. `unsaved`: all that no save has kept yet; what is older is in
    /// files.
    #[must_use]
    pub(super) fn before(generation: u64, history: History, mut unsaved: Vec<Arc<HistoryPiece>>) -> Self {
        unsaved.retain(|piece| piece.generation < generation);
        unsaved.sort_by_key(|piece| piece.generation);
        unsaved.dedup_by_key(|piece| piece.generation);
        // A save that is running or has failed may have written some of the others already.
        let stored_before = unsaved.first().map_or(generation, |piece| piece.generation);
        Self { stored: history.before(stored_before), files: OnceLock::new(), unsaved }
    }
}

impl StateReadings for TrainingData {
    fn readings(&self, wanted: &[WantedReadings]) -> Result<Vec<Vec<Sample>>, String> {
        let files = self.files.get_or_init(|| self.stored.state_files().map_err(|error| error.to_string()));
        let files = files.as_ref().map_err(String::clone)?;
        let mut found = files.readings(wanted).map_err(|error| error.to_string())?;
        for (wanted, found) in wanted.iter().zip(&mut found) {
            for piece in &self.unsaved {
                let at = piece.states.binary_search_by_key(&wanted.state, |(state, _)| *state).ok();
                let samples = at.and_then(|at| piece.states.get(at)).map_or(&[][..], |(_, samples)| samples);
                found.extend(samples.iter().filter(|sample| sample.utc_nanos >= wanted.from_nanos));
            }
            // Stable: of equal times those of earlier updates come first.
            found.sort_by_key(|sample| sample.utc_nanos);
        }
        Ok(found)
    }
}
