//! The observations of many states at once: each history file is opened once for all of them.
//!
//! Invariant: the observations of a state are those that [`History::state`] returns.

use tidemap_map::training::ReadingsRequest;
use tidemap_model::Sample;

use super::{History, Part, table::Table};
use crate::error::HistoryError;

/// The history files of named states of a map, with the times that each covers.
#[derive(Clone, Debug)]
pub struct StateFiles {
    history: History,
    /// Generation and greatest time, ascending by generation.
    files: Vec<(u64, i64)>,
}

impl History {
    /// The files of named states, to read many states. Files that are written later are not included.
    ///
    /// # Errors
    /// [`HistoryError`] names the file that cannot be read.
    pub fn state_files(&self) -> Result<StateFiles, HistoryError> {
        let mut files = Vec::new();
        for generation in self.generations(Part::States)? {
            match self.open_if_there(generation, Part::States, i64::MIN, i64::MAX) {
                Ok(Some(file)) => files.push((generation, file.to_nanos())),
                Ok(None) => {}
                // Only a state whose times it covers lacks it.
                Err(HistoryError::Missing { to_nanos, .. }) => files.push((generation, to_nanos)),
                Err(error) => return Err(error),
            }
        }
        Ok(StateFiles { history: self.clone(), files })
    }
}

impl StateFiles {
    /// The observations of each of the states from an instant on, in the order of `wanted`, each ascending by time; of
    /// equal times in order of arrival. A file that was deleted since is left out.
    ///
    /// # Errors
    /// [`HistoryError`] names the file that cannot be read.
    pub fn readings(&self, wanted: &[ReadingsRequest]) -> Result<Vec<Vec<Sample>>, HistoryError> {
        let mut found = vec![Vec::new(); wanted.len()];
        let Some(earliest) = wanted.iter().map(|wanted| wanted.from_nanos).min() else { return Ok(found) };
        // The order is that of the tables, which are read record by record.
        let mut order: Vec<usize> = (0..wanted.len()).collect();
        order.sort_by_key(|&index| wanted[index].state);
        for &(generation, to_nanos) in &self.files {
            if to_nanos < earliest {
                continue;
            }
            let file = self.history.open_if_there(generation, Part::States, earliest, i64::MAX)?;
            let Some(file) = file else { continue };
            let mut table = Table::new(&file);
            for &index in &order {
                let ReadingsRequest { state, from_nanos } = wanted[index];
                if to_nanos < from_nanos {
                    continue;
                }
                let found = &mut found[index];
                table.samples(state, |sample| {
                    if sample.utc_nanos >= from_nanos {
                        found.push(sample);
                    }
                })?;
            }
        }
        for found in &mut found {
            found.sort_by_key(|sample: &Sample| sample.utc_nanos);
        }
        Ok(found)
    }
}
