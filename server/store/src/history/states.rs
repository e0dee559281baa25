//! The observations of many states at once: each history file is opened once for all of them.
//!
//! Invariant: the observations of a state are those that [`History::state`] returns.

use tidemap_map::refit::ReadingsRequest;
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
        for generation in self.generations(Part::States).map_err(|error| self.list_error(error))? {
            if let Some(file) = self.open_if_there(generation, Part::States)? {
                files.push((generation, file.to_nanos()));
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
        // In the order of the tables, which are read record by record.
        let mut order: Vec<usize> = (0..wanted.len()).collect();
        order.sort_by_key(|&index| wanted[index].state);
        for &(generation, to_nanos) in &self.files {
            if to_nanos < earliest {
                continue;
            }
            let Some(file) = self.history.open_if_there(generation, Part::States)? else { continue };
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
