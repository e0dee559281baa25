//! The readings of earlier updates of a map in memory, as history files contain them.
//!
//! Invariant: readings are kept as the updates learned them, and are never changed.

use std::sync::Arc;

use tidemap_map::{
    history::HistoryPiece,
    training::{ReadingsRequest, StateReadings},
};
use tidemap_model::Sample;

/// The pieces of history, one for each update.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReadingsInMemory(Vec<Arc<HistoryPiece>>);

impl ReadingsInMemory {
    /// Keeps the readings that an update learned.
    pub(crate) fn keep(&mut self, learned: impl IntoIterator<Item = Arc<HistoryPiece>>) {
        self.0.extend(learned);
    }
}

impl StateReadings for ReadingsInMemory {
    fn readings(&self, wanted: &[ReadingsRequest]) -> Result<Vec<Vec<Sample>>, String> {
        let readings_of = |wanted: &ReadingsRequest| {
            let of_state = |piece: &Arc<HistoryPiece>| {
                piece
                    .states
                    .iter()
                    .find(|(id, _)| *id == wanted.state)
                    .map_or_else(Vec::new, |(_, found)| found.clone())
            };
            let mut found: Vec<Sample> = self.0.iter().flat_map(of_state).collect();
            found.retain(|sample| sample.utc_nanos >= wanted.from_nanos);
            found.sort_by_key(|sample| sample.utc_nanos);
            found
        };
        Ok(wanted.iter().map(readings_of).collect())
    }
}
