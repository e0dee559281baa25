//! The store: one data directory, its maps, and the thread that writes their logs.
//!
//! Invariant: at most one process has a directory open, and nothing is written before its format is known.

use std::{
    collections::BTreeMap,
    fmt, io,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
};

use tidemap_layout::lists::{Loss, MAPS_FILE};
use tidemap_map::{snapshot::MapSnapshot, spec::MapSpec, update::SpectrumRoom};

use crate::{
    MapId,
    checkpoint::{Checkpoints, spectra},
    committer::{CommitFollower, Committer, SyncStats},
    disk::Disk,
    error::{AppendError, HistoryError, OpenError, Repair, StoreError, store_io},
    folders,
    history::History,
    index::Index,
    lock::Lock,
    log::{Log, replay::Replay, writer::LogWriter},
    losses,
    map_log::MapLog,
    options::StoreOptions,
    trouble::Trouble,
};

pub(crate) mod catalogue;
mod contents;
mod erase;
pub(crate) mod index_repair;
pub(crate) mod lists;
pub(crate) mod map_copy;
pub(crate) mod open;
pub(crate) mod open_map;
mod save;

pub use catalogue::SetAside;
pub use contents::{IndexContents, IndexedRows};

/// An open data directory. Clones are handles of the same store; the last one closes it.
#[derive(Clone)]
pub struct Store {
    inner: Arc<OpenStore>,
}

impl fmt::Debug for Store {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Store").field("directory", &self.inner.directory).finish_non_exhaustive()
    }
}

pub(crate) struct OpenStore {
    pub(crate) directory: PathBuf,
    pub(crate) disk: Arc<dyn Disk>,
    options: StoreOptions,
    store_id: String,
    is_new: bool,
    repairs: Vec<Repair>,
    /// The maps. The lock is held for a look-up, and while a map is created so that no two maps get the same number.
    maps: Mutex<Maps>,
    /// The lock is held while the index is read or written: by opening, saving and deleting maps, never by appends.
    index: Mutex<Index>,
    /// The lock is held while a backup is made.
    pub(crate) backup: Mutex<()>,
    pub(crate) committer: Arc<Committer>,
    thread: Mutex<Option<JoinHandle<()>>>,
    /// The last field, so that it is released after everything else is closed.
    _lock: Option<Arc<Lock>>,
}

pub(crate) struct Maps {
    pub(crate) entries: BTreeMap<MapId, MapEntry>,
    set_aside: BTreeMap<MapId, SetAside>,
    next: u32,
}

/// One map.
#[derive(Clone)]
pub(crate) struct MapEntry {
    spec: Arc<MapSpec>,
    pub(crate) log: Option<Arc<Log>>,
    /// The lock is held while the map is opened, saved, copied or deleted.
    pub(crate) busy: Arc<Mutex<()>>,
}

impl MapEntry {
    pub(crate) fn new(spec: MapSpec) -> MapEntry {
        MapEntry { spec: Arc::new(spec), log: None, busy: Arc::default() }
    }

    /// The fixed properties of the map.
    pub(crate) fn spec(&self) -> &MapSpec {
        &self.spec
    }
}

/// The source of the snapshot of an opened map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Source {
    /// The map is new and empty.
    Empty,
    /// A checkpoint.
    Checkpoint,
    /// There is no snapshot: the whole log is replayed.
    Log,
}

impl Source {
    /// Name of the source, for the log.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Empty => "empty",
            Self::Checkpoint => "checkpoint",
            Self::Log => "log",
        }
    }
}

/// A map that is open for appending.
pub struct OpenedMap {
    /// The log, to which events are appended.
    pub log: MapLog,
    /// The map as of its newest snapshot.
    pub snapshot: Option<MapSnapshot>,
    /// The source of the snapshot.
    pub source: Source,
    /// The events from the snapshot's `replay_from` to the end of the log.
    pub replay: Replay,
    /// The repairs that were made.
    pub repairs: Vec<Repair>,
}

impl fmt::Debug for OpenedMap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut shown = f.debug_struct("OpenedMap");
        shown.field("source", &self.source).field("repairs", &self.repairs).finish_non_exhaustive()
    }
}

/// Bytes on the disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// The map's log.
    pub log_bytes: u64,
    /// The map's checkpoints.
    pub checkpoint_bytes: u64,
    /// The map's history.
    pub history_bytes: u64,
}

impl OpenStore {
    pub(crate) fn maps(&self) -> MutexGuard<'_, Maps> {
        self.maps.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The number of a new map. It is not used again even if its creation fails: part of the map may be left.
    pub(crate) fn take_number(&self) -> MapId {
        let mut maps = self.maps();
        let map = MapId(maps.next);
        maps.next += 1;
        drop(maps);
        // A map whose folder was moved away by hand may have had this number and left records in the index.
        self.index().purge(map.0);
        map
    }

    pub(crate) fn entry(&self, map: MapId) -> Option<MapEntry> {
        self.maps().entries.get(&map).cloned()
    }

    pub(crate) fn options(&self) -> &StoreOptions {
        &self.options
    }

    /// Closes the log of a map, whose writer has stopped; appends are refused until the map is opened again.
    pub(crate) fn close_log(&self, map: MapId) -> Option<MapEntry> {
        let mut maps = self.maps();
        let entry = maps.entries.get_mut(&map)?;
        let log = entry.log.take();
        let closed = entry.clone();
        drop(maps);
        if let Some(log) = log {
            // Blocks the committer, which may be writing.
            *log.writer.lock().unwrap_or_else(PoisonError::into_inner) = None;
        }
        Some(closed)
    }

    /// Sets a map aside until the next start.
    pub(crate) fn set_aside(&self, map: MapId, reason: &str) {
        let mut maps = self.maps();
        if let Some(entry) = maps.entries.remove(&map) {
            let name = Some(entry.spec.name.as_str().to_owned());
            maps.set_aside.insert(map, SetAside { id: map, name, reason: reason.to_owned() });
        }
    }

    /// The maps that can be used.
    pub(crate) fn entries(&self) -> Vec<(MapId, MapEntry)> {
        self.maps().entries.iter().map(|(&map, entry)| (map, entry.clone())).collect()
    }

    /// All maps, also those that are set aside.
    pub(crate) fn known(&self) -> Vec<MapId> {
        let maps = self.maps();
        maps.entries.keys().chain(maps.set_aside.keys()).copied().collect()
    }

    pub(crate) fn index(&self) -> MutexGuard<'_, Index> {
        self.index.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn history(&self, map: MapId) -> History {
        let folder = folders::history_folder(&self.directory, map);
        History::at(Arc::clone(&self.disk), folder, map)
    }

    pub(crate) fn checkpoints(&self, map: MapId) -> Checkpoints<'_> {
        Checkpoints { disk: &*self.disk, folder: folders::checkpoints_folder(&self.directory, map), map }
    }

    /// Deletes a map whose folder has the name of a deleted one.
    fn finish_deletion(&self, map: MapId) -> Result<(), StoreError> {
        let maps = folders::maps_folder(&self.directory);
        self.disk.sync_folder(&maps).map_err(store_io(maps))?;
        // Held, because a creation changes the same list.
        let maps = self.maps();
        catalogue::change_list(&*self.disk, &self.directory, |list| list.maps.retain(|(number, _)| *number != map.0))?;
        drop(maps);
        self.index().purge(map.0);
        self.committer.watch.saved(map, None);
        catalogue::remove_deleted(&*self.disk, &self.directory, map)
    }

    fn close(&self) {
        self.committer.close();
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        // A completion may hold the last handle; the committer's thread cannot join itself.
        if let Some(thread) = thread.filter(|thread| thread.thread().id() != std::thread::current().id())
            && thread.join().is_err()
        {
            tracing::error!("the committer's thread has panicked");
        }
        self.index().close();
    }
}

impl Drop for OpenStore {
    fn drop(&mut self) {
        self.close();
    }
}

impl Store {
    pub(crate) fn inner(&self) -> &OpenStore {
        &self.inner
    }

    /// Identity of the store. A restored backup may be given a new one.
    pub fn store_id(&self) -> &str {
        &self.inner.store_id
    }

    /// Reads the published data of the newest generation of a map from the index; `None` where it is not there or not
    /// whole. The models of a grid's tiles are read when they are needed. Does not wait for the log.
    #[must_use]
    pub fn published(&self, map: MapId, spec: &MapSpec) -> Option<MapSnapshot> {
        let read = self.inner.index().read(map.0, spec);
        read.unwrap_or_else(|failure| {
            // Opening the map repairs it.
            tracing::debug!(map = map.0, %failure, "the index does not contain what a map publishes");
            None
        })
    }

    /// Whether the store was created when it was opened.
    pub fn is_new(&self) -> bool {
        self.inner.is_new
    }

    /// The losses that were accepted, in the order of their acceptance.
    ///
    /// # Errors
    /// [`OpenError`] where the file of the losses is damaged.
    pub fn losses(&self) -> Result<Vec<Loss>, OpenError> {
        losses::read(&*self.inner.disk, &self.inner.directory)
    }

    /// Checks whether the folder and the logs are still those that are held; if not, nothing is appended any more.
    /// Returns the reason why appends have stopped, if they have. Waits for the disk.
    pub fn verify(&self) -> Option<AppendError> {
        let inner = &*self.inner;
        inner.committer.check_lock();
        for (_, entry) in inner.entries() {
            // A log that is being written is checked by that.
            let Some(log) = &entry.log else { continue };
            let Ok(writer) = log.writer.try_lock() else { continue };
            if let Some(Err(error)) = writer.as_ref().map(LogWriter::verify) {
                inner.committer.poison_with(error);
            }
        }
        inner.committer.poison()
    }

    /// The repairs that were made when the store was opened.
    pub fn repairs(&self) -> &[Repair] {
        &self.inner.repairs
    }

    /// The present trouble of the storage. Does not wait for the disk.
    pub fn trouble(&self) -> Vec<Trouble> {
        self.inner.committer.watch.trouble()
    }

    /// The trouble with the list of all maps, if it is lost: there may have been other maps than those that exist.
    pub fn lost_map_list(&self) -> Option<Trouble> {
        let is_it =
            |trouble: &Trouble| matches!(trouble, Trouble::ListLost { file, .. } if *file == Path::new(MAPS_FILE));
        self.trouble().into_iter().find(is_it)
    }

    /// All maps, by number.
    pub fn maps(&self) -> Vec<(MapId, MapSpec)> {
        self.inner.maps().entries.iter().map(|(&map, entry)| (map, MapSpec::clone(&entry.spec))).collect()
    }

    /// Maps that cannot be used, because their folder is missing or its file MAP is damaged, by number.
    pub fn set_aside(&self) -> Vec<SetAside> {
        self.inner.maps().set_aside.values().cloned().collect()
    }

    /// Creates a map; durable when this returns. The caller makes sure that names are unique.
    ///
    /// # Errors
    /// [`StoreError`]; the map does not exist then.
    pub fn create_map(&self, spec: &MapSpec) -> Result<MapId, StoreError> {
        self.create(spec, None)
    }

    /// Creates a map that is one of a cluster, with its number there; otherwise as [`Self::create_map`].
    ///
    /// # Errors
    /// [`StoreError`]; the map does not exist then.
    pub fn create_shared_map(&self, spec: &MapSpec, uid: u64) -> Result<MapId, StoreError> {
        self.create(spec, Some(uid))
    }

    /// The number in its cluster of a map that is one of a cluster.
    ///
    /// # Errors
    /// [`OpenError`] where the file of it is damaged.
    pub fn shared(&self, map: MapId) -> Result<Option<u64>, OpenError> {
        catalogue::read_shared(&*self.inner.disk, &self.inner.directory, map)
    }

    fn create(&self, spec: &MapSpec, shared: Option<u64>) -> Result<MapId, StoreError> {
        let map = self.inner.take_number();
        let mut maps = self.inner.maps();
        catalogue::create(&*self.inner.disk, &self.inner.directory, map, spec, shared)?;
        maps.entries.insert(map, MapEntry::new(spec.clone()));
        Ok(map)
    }

    /// Deletes a map with all its data; durable when this returns. Its log refuses appends afterwards.
    ///
    /// # Errors
    /// [`StoreError`]. If the map is no longer in [`Self::maps`] afterwards, either it may reappear after a power cut,
    /// or only freeing its space failed, and the next start does that.
    pub fn delete_map(&self, map: MapId) -> Result<(), StoreError> {
        let inner = &*self.inner;
        // Without the list the deletion could not be completed.
        catalogue::read_list(&*inner.disk, &inner.directory)?;
        if inner.maps().set_aside.remove(&map).is_some() {
            match catalogue::mark_deleted(&*inner.disk, &inner.directory, map) {
                // The folder of the map may be what is missing.
                Err(StoreError::Io { source, .. }) if source.kind() == io::ErrorKind::NotFound => {}
                marked => marked?,
            }
            return inner.finish_deletion(map);
        }
        let entry = inner.maps().entries.get(&map).cloned().ok_or(StoreError::UnknownMap(map))?;
        let _busy = entry.busy.lock().unwrap_or_else(PoisonError::into_inner);
        // Checked again: another deletion may have been first.
        if !inner.maps().entries.contains_key(&map) {
            return Err(StoreError::UnknownMap(map));
        }
        {
            // Blocks the committer, which must not create a segment in a folder that has been renamed.
            let mut writer = entry.log.as_ref().map(|log| log.writer.lock().unwrap_or_else(PoisonError::into_inner));
            catalogue::mark_deleted(&*inner.disk, &inner.directory, map)?;
            if let Some(writer) = &mut writer {
                **writer = None;
            }
        }
        inner.maps().entries.remove(&map);
        inner.finish_deletion(map)
    }

    /// Bytes of a map on the disk; folders that cannot be read count as 0.
    pub fn sizes(&self, map: MapId) -> Sizes {
        let inner = &*self.inner;
        let bytes = |folder: &Path| -> io::Result<u64> {
            let names = inner.disk.list(folder)?;
            names.iter().map(|name| inner.disk.length(&folder.join(name))).sum()
        };
        Sizes {
            log_bytes: bytes(&folders::log_folder(&inner.directory, map)).unwrap_or(0),
            checkpoint_bytes: bytes(&folders::checkpoints_folder(&inner.directory, map)).unwrap_or(0),
            history_bytes: bytes(&folders::history_folder(&inner.directory, map)).unwrap_or(0),
        }
    }

    /// The exact observations of a map, as far back as they are kept.
    ///
    /// # Errors
    /// [`HistoryError::UnknownMap`].
    pub fn history(&self, map: MapId) -> Result<History, HistoryError> {
        self.inner.entry(map).ok_or(HistoryError::UnknownMap(map))?;
        Ok(self.inner.history(map))
    }

    /// Memory for the sums of a map's states while an update runs, and the place for others.
    pub fn spectrum_room(&self, map: MapId) -> SpectrumRoom {
        let inner = &*self.inner;
        let folder = folders::checkpoints_folder(&inner.directory, map);
        spectra::room(Arc::clone(&inner.disk), &folder, inner.options.spectrum_cache_bytes)
    }

    /// Lets somebody follow the group commits from now on; one follower only.
    pub fn follow_commits(&self, follower: CommitFollower) {
        self.inner.committer.followed.set(follower);
    }

    /// Durations of fdatasync calls on the logs.
    pub fn sync_stats(&self) -> SyncStats {
        self.inner.committer.sync_stats()
    }

    /// Writes all queued records and closes the logs and the index. Later appends fail. The directory is
    /// free for another process when the last handle is dropped.
    pub fn close(&self) {
        self.inner.close();
    }
}
