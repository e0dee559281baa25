//! The training data of named states for an update that trains models: from history files, and from history that no
//! save has stored yet.
//!
//! Invariant: each reading is returned once, and in the same order whether it is in a file or not. So an update that is
//! repeated after a crash trains the same models.

use std::sync::{Arc, OnceLock};

use tidemap_map::{
    history::HistoryPiece,
    training::{ReadingsRequest, StateReadings},
};
use tidemap_model::Sample;
use tidemap_store::{History, StateFiles};

#[cfg(test)]
mod tests;

/// The readings that earlier updates have learned.
#[derive(Debug)]
pub(super) struct TrainingData {
    /// The generations that are not in `unsaved`.
    stored: History,
    /// The files of the stored history, opened at the first request.
    files: OnceLock<Result<StateFiles, String>>,
    /// The unsaved history, ascending by generation.
    unsaved: Vec<Arc<HistoryPiece>>,
}

impl TrainingData {
    /// The readings that updates before `generation` have learned. `unsaved`: history that no save has stored; the rest
    /// is in files.
    pub(super) fn before(generation: u64, history: History, mut unsaved: Vec<Arc<HistoryPiece>>) -> Self {
        unsaved.retain(|piece| piece.generation < generation);
        unsaved.sort_by_key(|piece| piece.generation);
        unsaved.dedup_by_key(|piece| piece.generation);
        // A running or failed save may already have written some of the unsaved pieces.
        let stored_before = unsaved.first().map_or(generation, |piece| piece.generation);
        Self { stored: history.before(stored_before), files: OnceLock::new(), unsaved }
    }
}

impl StateReadings for TrainingData {
    fn readings(&self, wanted: &[ReadingsRequest]) -> Result<Vec<Vec<Sample>>, String> {
        let files = self.files.get_or_init(|| self.stored.state_files().map_err(|error| error.to_string()));
        let files = files.as_ref().map_err(String::clone)?;
        let mut found = files.readings(wanted).map_err(|error| error.to_string())?;
        for (wanted, found) in wanted.iter().zip(&mut found) {
            for piece in &self.unsaved {
                let at = piece.states.binary_search_by_key(&wanted.state, |(state, _)| *state).ok();
                let samples = at.and_then(|at| piece.states.get(at)).map_or(&[][..], |(_, samples)| samples);
                found.extend(samples.iter().filter(|sample| sample.utc_nanos >= wanted.from_nanos));
            }
            // The sort is stable: ties keep the order of the updates.
            found.sort_by_key(|sample| sample.utc_nanos);
        }
        Ok(found)
    }
}
