//! Bringing the index in line with the checkpoints: when a map is opened, and when an index that a full or failing disk
//! had closed can be opened again.
//!
//! Invariant: checkpoints and logs do not depend on it. A failing index is reported, and tried again; it is set aside
//! only where what it holds is damaged.

use std::{sync::PoisonError, time::Instant};

use tidemap_map::snapshot::MapSnapshot;

use super::{MapEntry, OpenStore, Store};
use crate::{
    MapId,
    checkpoint::Memory,
    error::{OpenError, Repair, open_io},
    failure::ReadFailure,
    index::RowsState,
};

/// The memory for data that is only written to the index: none.
const NO_MEMORY: Memory = Memory { tile_bytes: 0, spectrum_bytes: 0 };

/// The repair that the index needs.
pub(super) enum IndexState {
    /// Nothing.
    Good,
    /// The map must be written again.
    Stale(&'static str),
    /// The index cannot be read.
    Failed(ReadFailure),
}

impl IndexState {
    /// Returns what the rows of a map need to agree with its newest good checkpoint.
    pub(super) fn of(rows: Result<RowsState, ReadFailure>, newest: Option<&MapSnapshot>) -> IndexState {
        match rows {
            Ok(RowsState::Nothing) if newest.is_none() => IndexState::Good,
            Ok(RowsState::Nothing) => IndexState::Stale("it had nothing of this map"),
            Ok(RowsState::Unfinished) => IndexState::Stale("it was being written when the process stopped"),
            Ok(RowsState::Whole { position, generation }) => {
                match newest.map(|snapshot| (snapshot.position, snapshot.generation)) {
                    Some(newest) if newest == (position, generation) => IndexState::Good,
                    Some((newest, _)) if newest > position => {
                        IndexState::Stale("it is older than the newest checkpoint")
                    }
                    _ => IndexState::Stale("it is newer than the newest good checkpoint"),
                }
            }
            Err(failure) => IndexState::Failed(failure),
        }
    }
}

impl OpenStore {
    /// Updates the index to the snapshot in use. An error here only disables the index.
    pub(super) fn repair_index(
        &self,
        map: MapId,
        snapshot: Option<&MapSnapshot>,
        state: IndexState,
        repairs: &mut Vec<Repair>,
    ) {
        let mut index = self.index();
        let was_available = index.is_available();
        let reason = match state {
            IndexState::Good => return,
            IndexState::Stale(reason) => reason.to_owned(),
            IndexState::Failed(ReadFailure::Damaged(damage)) => {
                match index.replace() {
                    Ok(folder) => repairs.push(Repair::IndexSetAside { folder, reason: damage.clone() }),
                    Err(failure) => index.fail(failure),
                }
                damage
            }
            IndexState::Failed(failure) => {
                index.fail(failure.clone());
                failure.to_string()
            }
        };
        match snapshot {
            Some(snapshot) if index.is_available() => {
                index.save(map.0, snapshot);
                if index.is_available() {
                    repairs.push(Repair::IndexRebuilt { map, reason });
                }
            }
            // Rows of a generation that is no longer known.
            None if index.is_available() => index.purge(map.0),
            _ => {}
        }
        let failure = index.failure();
        if was_available && let Some(reason) = failure.clone() {
            repairs.push(Repair::IndexUnavailable { reason });
        }
        self.committer.watch.indexed(failure);
    }

    /// Writes what the newest checkpoint of an open map publishes, where the index lacks it.
    fn index_again(&self, map: MapId, entry: &MapEntry, repairs: &mut Vec<Repair>) -> Result<(), OpenError> {
        let _busy = entry.busy.lock().unwrap_or_else(PoisonError::into_inner);
        if !self.maps().entries.contains_key(&map) {
            return Ok(());
        }
        let checkpoints = self.checkpoints(map);
        let (newest, _) = checkpoints.load(&entry.spec, NO_MEMORY).map_err(open_io(&checkpoints.folder))?;
        let rows = self.index().check(map.0);
        self.repair_index(map, newest.as_ref(), IndexState::of(rows, newest.as_ref()), repairs);
        Ok(())
    }
}

impl Store {
    /// Whether [`Self::recover_index`] would try to open the index now. Does not wait for the disk.
    pub fn is_index_recoverable(&self) -> bool {
        // Another thread that holds the index may read or write for long.
        self.inner.index.try_lock().is_ok_and(|index| index.is_retry_due(Instant::now()))
    }

    /// Opens an index again that the disk or the machine had refused, and writes what it lacks of the open maps. Waits
    /// for the disk. Returns what was repaired; nothing where the index is open, or still refused.
    pub fn recover_index(&self) -> Vec<Repair> {
        let inner = &*self.inner;
        let mut repairs = Vec::new();
        let mut index = inner.index();
        let (is_open, replaced) = index.reopen();
        repairs.extend(replaced.map(|(folder, reason)| Repair::IndexSetAside { folder, reason }));
        if !is_open {
            inner.committer.watch.indexed(index.failure());
            return repairs;
        }
        // The index counts as unavailable until it has all its rows. A map that was deleted meanwhile has left its
        // rows.
        let known = inner.known();
        index.purge_unknown(|map| known.contains(&MapId(map)));
        drop(index);
        // A map that is not open is written when it is opened.
        for (map, entry) in inner.entries().into_iter().filter(|(_, entry)| entry.log.is_some()) {
            if let Err(error) = inner.index_again(map, &entry, &mut repairs) {
                tracing::warn!(map = map.0, %error, "the index has nothing of a map until its next save");
            }
        }
        let mut index = inner.index();
        index.has_recovered();
        // The present refusal has been reported when it began.
        repairs.retain(|repair| !matches!(repair, Repair::IndexUnavailable { .. }));
        if index.is_available() {
            repairs.push(Repair::IndexRecovered);
        }
        inner.committer.watch.indexed(index.failure());
        repairs
    }
}
