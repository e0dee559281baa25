//! The table of a history file: the offsets of its states, days and tiles.
//!
//! Invariant: one record of the table is in memory at a time.

use tidemap_layout::{
    file::{RECORD_HEADER_LENGTH, RecordKind},
    history::{ENTRIES_MAX, ENTRY_LENGTH, Entry, StateSamples},
};
use tidemap_map::{history::origins::Origins, ids::StateId};

use tidemap_model::Sample;

use super::file::HistoryFile;
use crate::{
    error::HistoryError,
    record::history::{decode_origins, decode_samples},
    record_file::anywhere,
};

/// The table of an open file.
pub(super) struct Table<'file> {
    file: &'file HistoryFile,
    /// The record that is in memory, and its entries.
    chunk: Option<(u64, Vec<Entry>)>,
}

impl<'file> Table<'file> {
    pub(super) fn new(file: &'file HistoryFile) -> Table<'file> {
        Table { file, chunk: None }
    }

    /// The entries of a record of the table.
    fn chunk(&mut self, number: u64) -> Result<&[Entry], HistoryError> {
        if self.chunk.as_ref().is_none_or(|(known, _)| *known != number) {
            let file = self.file;
            let stride = (RECORD_HEADER_LENGTH + ENTRIES_MAX * ENTRY_LENGTH) as u64;
            let offset = number.checked_mul(stride).and_then(|offset| offset.checked_add(file.end.table));
            let offset = offset.ok_or_else(|| file.damaged("its table is not valid"))?;
            let read = anywhere::raw(&*file.file, RecordKind::Table, offset);
            let (payload, _) = read.map_err(|failure| file.unread(failure))?;
            let (entries, rest) = payload.as_chunks::<ENTRY_LENGTH>();
            let expected = (file.end.entries - number * ENTRIES_MAX as u64).min(ENTRIES_MAX as u64);
            if !rest.is_empty() || entries.len() as u64 != expected {
                return Err(file.damaged("its table does not have its length"));
            }
            self.chunk = Some((number, entries.iter().map(Entry::decode).collect()));
        }
        Ok(self.chunk.as_ref().map_or(&[], |(_, entries)| entries))
    }

    /// The number of the first entry whose key is at least `key`.
    fn place(&mut self, key: u64) -> Result<u64, HistoryError> {
        let (mut low, mut high) = (0, self.file.end.entries.div_ceil(ENTRIES_MAX as u64));
        // The last record whose first key is not above.
        while high - low > 1 {
            let middle = low + (high - low) / 2;
            match self.chunk(middle)?.first() {
                Some(entry) if entry.key <= key => low = middle,
                _ => high = middle,
            }
        }
        if high == 0 {
            return Ok(0);
        }
        let within = self.chunk(low)?.partition_point(|entry| entry.key < key);
        Ok(low * ENTRIES_MAX as u64 + within as u64)
    }

    fn entry(&mut self, number: u64) -> Result<Option<Entry>, HistoryError> {
        if number >= self.file.end.entries {
            return Ok(None);
        }
        let within = usize::try_from(number % ENTRIES_MAX as u64).unwrap_or(usize::MAX);
        Ok(self.chunk(number / ENTRIES_MAX as u64)?.get(within).copied())
    }

    /// The entry of a key.
    pub(super) fn find(&mut self, key: u64) -> Result<Option<Entry>, HistoryError> {
        // Keys are often searched in order, so the next one is often in the same record.
        if let Some((_, entries)) = &self.chunk
            && let Ok(at) = entries.binary_search_by_key(&key, |entry| entry.key)
        {
            return Ok(entries.get(at).copied());
        }
        let number = self.place(key)?;
        Ok(self.entry(number)?.filter(|entry| entry.key == key))
    }

    /// Calls `call` for each entry whose key lies from `from` up to but not including `to`.
    pub(super) fn each(
        &mut self,
        from: u64,
        to: u64,
        mut call: impl FnMut(Entry) -> Result<(), HistoryError>,
    ) -> Result<(), HistoryError> {
        let mut number = self.place(from)?;
        while let Some(entry) = self.entry(number)?.filter(|entry| entry.key < to) {
            call(entry)?;
            number += 1;
        }
        Ok(())
    }

    /// The observations of a state, in order of arrival, with their origins.
    pub(super) fn state(&mut self, id: StateId) -> Result<(Vec<Sample>, Origins), HistoryError> {
        let file = self.file;
        let mut samples = Vec::new();
        let mut origins: Option<Origins> = None;
        self.records(id, |message| {
            samples.extend(decode_samples(message).map_err(|reason| file.damaged(reason))?);
            let later = decode_origins(message).map_err(|reason| file.damaged(reason))?;
            match &mut origins {
                Some(origins) => origins.extend(&later),
                None => origins = Some(later),
            }
            Ok(())
        })?;
        Ok((samples, origins.unwrap_or_default()))
    }

    /// Passes the observations of a state to `take`, in order of arrival.
    pub(super) fn samples(&mut self, id: StateId, mut take: impl FnMut(Sample)) -> Result<(), HistoryError> {
        let file = self.file;
        self.records(id, |message| {
            decode_samples(message).map_err(|reason| file.damaged(reason))?.into_iter().for_each(&mut take);
            Ok(())
        })
    }

    fn records(
        &mut self,
        id: StateId,
        mut take: impl FnMut(&StateSamples) -> Result<(), HistoryError>,
    ) -> Result<(), HistoryError> {
        let Some(entry) = self.find(u64::from(id.0))? else { return Ok(()) };
        let file = self.file;
        let mut offset = entry.offset;
        for _ in 0..entry.records {
            let read = anywhere::message::<StateSamples>(&*file.file, RecordKind::StateSamples, offset);
            let (message, next) = read.map_err(|failure| file.unread(failure))?;
            if message.state != id.0 {
                return Err(file.damaged("its table names another state than its records"));
            }
            take(&message)?;
            offset = next;
        }
        Ok(())
    }
}
