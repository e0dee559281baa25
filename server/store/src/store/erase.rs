//! Erasing states, or some of their observations, from a map that is open.
//!
//! Invariant: the map's log is closed before its files are written again. After an error the map is as it was, or it is
//! set aside and the next start completes the erasure.

use std::{io, path::Path, sync::PoisonError};

use tidemap_layout::lists::{ERASE_FILE, ErasedPart, ErasureOrder};
use tidemap_map::{erasure::Selection, ids::StateId};

use super::Store;
use crate::{
    MapId,
    erasure::{ERASED_SUFFIX, ERASING_SUFFIX, Erased, Rewrite, beside, clean, remove_folder, swap, with},
    error::{EraseError, StoreError, store_io},
    folders, list_file,
};

const UNFINISHED: &str = "an erasure has begun and could not be completed. Check the disk and restart the daemon, which \
                          completes it";

impl Store {
    /// Erases states from a map, whose log is closed by this: history, checkpoints, log and index hold nothing of them
    /// afterwards, nor do later backups. The ids of the states after them go down. The map can be opened again when
    /// this returns, also after an error.
    ///
    /// # Errors
    /// [`EraseError`]. But for [`EraseError::Index`], either the map is as it was, or it is no longer in
    /// [`Self::maps`] and the next start completes the erasure.
    pub fn erase_states(&self, map: MapId, states: &[StateId]) -> Result<Erased, EraseError> {
        let mut states: Vec<u32> = states.iter().map(|state| state.0).collect();
        states.sort_unstable();
        self.erase(map, &ErasureOrder { states, part: None })
    }

    /// Erases the selected observations from a map, as [`Self::erase_states`] does; the models of their states are
    /// learned anew from the history. A state of which nothing is left is erased. `forgets`: the sequences of the
    /// selected producers begin anew, which must be named, and states of which nothing is left stay, untrained.
    ///
    /// # Errors
    /// [`EraseError`]. After [`EraseError::NotErasable`] and [`EraseError::HasScans`] the map is as it was; else as
    /// [`Self::erase_states`].
    pub fn erase_part(&self, map: MapId, selection: &Selection, forgets: bool) -> Result<Erased, EraseError> {
        let states = selection.states.iter().flatten().map(|state| state.0).collect();
        let producers = selection.producers.iter().flatten().map(|producer| producer.0).collect();
        let (from_nanos, to_nanos) = (selection.from_nanos, selection.to_nanos);
        self.erase(map, &ErasureOrder { states, part: Some(ErasedPart { from_nanos, to_nanos, producers, forgets }) })
    }

    fn erase(&self, map: MapId, order: &ErasureOrder) -> Result<Erased, EraseError> {
        let inner = self.inner();
        let unknown = || EraseError::Store(StoreError::UnknownMap(map));
        let entry = inner.entry(map).ok_or_else(unknown)?;
        let _busy = entry.busy.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = inner.close_log(map).ok_or_else(unknown)?;
        let (disk, directory) = (&inner.disk, &inner.directory);
        let file = folders::map_folder(directory, map).join(ERASE_FILE);
        let rewrite = Rewrite { disk, directory, options: inner.options(), map, spec: entry.spec() };
        let prepared = rewrite.prepare(order)?;
        let erased = prepared.erased;
        let rewritten = list_file::replace(&**disk, &file, order)
            .map_err(|error| store_io(&file)(error).into())
            .and_then(|()| rewrite.run(prepared));
        if let Err(error) = rewritten {
            let is_erased = with(&**disk, directory, ERASED_SUFFIX).is_ok_and(|maps| maps.contains(&map));
            if is_erased || !self.take_back(map, &file) {
                inner.set_aside(map, UNFINISHED);
            }
            return Err(error);
        }
        swap(&**disk, directory, map).inspect_err(|_| inner.set_aside(map, UNFINISHED))?;
        clean(&**disk, directory, &mut inner.index(), map).map(|()| erased)
    }

    /// Takes an order back and removes what was written; whether the map is as before.
    fn take_back(&self, map: MapId, file: &Path) -> bool {
        let (disk, directory) = (&*self.inner().disk, &self.inner().directory);
        // The order first: while it is there, the next start repeats the erasure.
        let removed = match disk.remove(file) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => disk.sync_folder(&folders::map_folder(directory, map)),
        };
        let erasing = beside(directory, map, ERASING_SUFFIX);
        if let Err(error) = remove_folder(disk, &erasing) {
            tracing::warn!(map = map.0, %error, "an unfinished erasure takes space until the next start");
        }
        removed.is_ok()
    }
}
