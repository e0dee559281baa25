//! Erasing states from a map, or some of their observations, so that no file holds anything of them.
//!
//! 1. Where only a part is erased, the history is read: what cannot be erased exactly is refused, with nothing changed,
//!    and the states that have learned it are learned anew. Then the order is written to the file `ERASE` in the map's
//!    folder. From here on the erasure is completed, by this process or by the next start, unless this process can take
//!    the order back.
//! 2. The map is written again to a folder beside, `NUMBER.erasing`, without the states: the newest checkpoint, the log
//!    from where that needs it, and every history file of states. Positions of the log and the producers' sequences
//!    stay as they are, so that an erased observation still counts as acknowledged.
//! 3. The folder is renamed to `NUMBER.erased`. Before, the map has its states; from here on, it does not have them.
//! 4. The map's folder is renamed to `NUMBER.replaced`, and the new one takes its place. A start does both, if they
//!    have not been done.
//! 5. The index is written to a new folder without the rows of the map, and indexes that were set aside are removed.
//!    Then `NUMBER.replaced` is removed, with the order. A start repeats this while that folder is there.
//!
//! A backup detects by the count in `ERASURES` that its copy of the map is from before the erasure, and makes a new
//! copy.
//!
//! Invariant: at every moment the map is whole in exactly one of the folders that a start uses.

use std::{
    io::{self, Read as _},
    path::{Path, PathBuf},
    sync::Arc,
};

use tidemap_layout::lists::{
    CheckpointList, ERASE_FILE, ERASURES_FILE, ErasureCount, ErasureOrder, FileList, HISTORY_FILE,
};
use tidemap_map::{erasure::StateErasure, history::HistoryPiece, ids::StateId, snapshot::MapSnapshot, spec::MapSpec};

use crate::{
    MapId,
    checkpoint::{Checkpoints, Memory},
    disk::Disk,
    error::{AppendError, EraseError, OpenError, Repair, StoreError, open_io, store_io},
    folders,
    history::History,
    index::Index,
    list_file::{self, Unlisted},
    log::{
        frame::EncodedEvent,
        recovery::{self, Expectation},
        replay::Replay,
        writer::{LogWriter, create_log},
    },
    options::StoreOptions,
};

mod part;

pub(crate) const ERASING_SUFFIX: &str = ".erasing";
pub(crate) const ERASED_SUFFIX: &str = ".erased";
const REPLACED_SUFFIX: &str = ".replaced";

/// Events that are written to the new log at once.
const EVENTS_AT_ONCE: usize = 256;
/// Bytes that are copied at once.
const COPIED_BYTES: usize = 1 << 20;

/// A map whose files are written again.
pub(crate) struct Rewrite<'a> {
    pub(crate) disk: &'a Arc<dyn Disk>,
    pub(crate) directory: &'a Path,
    pub(crate) options: &'a StoreOptions,
    pub(crate) map: MapId,
    pub(crate) spec: &'a MapSpec,
}

pub(crate) fn beside(directory: &Path, map: MapId, suffix: &str) -> PathBuf {
    folders::with_suffix(&folders::map_folder(directory, map), suffix)
}

/// Removes a folder that may not be there.
pub(crate) fn remove_folder(disk: &dyn Disk, folder: &Path) -> io::Result<()> {
    match disk.remove_folder(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Copies a file; its content is durable when this returns, its name is not.
fn copy(disk: &dyn Disk, from: &Path, to: &Path) -> Result<(), StoreError> {
    let mut reader = disk.read(from).map_err(store_io(from))?;
    let mut writer = disk.create(to).map_err(store_io(to))?;
    let mut bytes = vec![0; COPIED_BYTES];
    loop {
        let count = reader.read(&mut bytes).map_err(store_io(from))?;
        if count == 0 {
            return writer.sync().map_err(store_io(to));
        }
        writer.append(bytes.get(..count).unwrap_or_default()).map_err(store_io(to))?;
    }
}

/// Number of erasures in the map in a folder.
pub(crate) fn count(disk: &dyn Disk, folder: &Path) -> io::Result<u64> {
    let damaged = |reason| io::Error::new(io::ErrorKind::InvalidData, reason);
    match list_file::read::<ErasureCount>(disk, &folder.join(ERASURES_FILE)) {
        Ok(known) => Ok(known.count),
        Err(Unlisted::Absent) => Ok(0),
        Err(Unlisted::Damaged(reason)) => Err(damaged(format!("{ERASURES_FILE}: {reason}"))),
        Err(Unlisted::Io(error)) => Err(error),
    }
}

/// The data that has been read before a map is written again.
pub(crate) struct Prepared {
    snapshot: Option<MapSnapshot>,
    erasure: StateErasure,
    pub(crate) erased: Erased,
}

/// The amount of erased data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Erased {
    /// States of which something is erased, each axis of a vector counted.
    pub states: u64,
    /// Observations, where only a part of a state's was to be erased.
    pub observations: u64,
}

impl Rewrite<'_> {
    /// Reads what is needed to write the map again, and changes nothing.
    ///
    /// # Errors
    /// [`EraseError`], also where the order cannot be carried out exactly.
    pub(crate) fn prepare(&self, order: &ErasureOrder) -> Result<Prepared, EraseError> {
        let snapshot = self.newest()?;
        let states: Vec<StateId> = order.states.iter().copied().map(StateId).collect();
        let Some(part) = &order.part else {
            let erased = Erased { states: states.len() as u64, observations: 0 };
            return Ok(Prepared { snapshot, erasure: StateErasure::new(states), erased });
        };
        let (erasure, erased) = self.part(snapshot.as_ref(), states, part)?;
        Ok(Prepared { snapshot, erasure, erased })
    }

    /// Writes the map without what is to be erased, up to the moment from which on it is erased.
    pub(crate) fn run(&self, prepared: Prepared) -> Result<(), EraseError> {
        let Prepared { snapshot, mut erasure, .. } = prepared;
        let new = beside(self.directory, self.map, ERASING_SUFFIX);
        let old = folders::map_folder(self.directory, self.map);
        let disk = &**self.disk;
        remove_folder(disk, &new).map_err(store_io(&new))?;
        disk.create_folder(&new).map_err(store_io(&new))?;
        copy(disk, &old.join("MAP"), &new.join("MAP"))?;
        let count = count(disk, &old).map_err(store_io(old.join(ERASURES_FILE)))?.saturating_add(1);
        list_file::replace(disk, &new.join(ERASURES_FILE), &ErasureCount { count }).map_err(store_io(&new))?;

        let (position, replay_from) =
            snapshot.as_ref().map_or((0, 1), |snapshot| (snapshot.position, snapshot.replay_from));
        for entry in self.events(position, replay_from.max(1))? {
            erasure.note(&entry?.1);
        }
        self.write_checkpoint(&new, &mut erasure, snapshot)?;
        self.write_log(&new, &mut erasure, position, replay_from.max(1))?;
        self.write_history(&new, &erasure)?;
        disk.sync_folder(&new).map_err(store_io(&new))?;
        let erased = beside(self.directory, self.map, ERASED_SUFFIX);
        disk.rename(&new, &erased).map_err(store_io(&erased))?;
        let maps = folders::maps_folder(self.directory);
        disk.sync_folder(&maps).map_err(store_io(maps))?;
        Ok(())
    }

    fn newest(&self) -> Result<Option<MapSnapshot>, OpenError> {
        let folder = folders::checkpoints_folder(self.directory, self.map);
        let checkpoints = Checkpoints { disk: &**self.disk, folder: folder.clone(), map: self.map };
        let StoreOptions { tile_cache_bytes: tile_bytes, spectrum_cache_bytes: spectrum_bytes, .. } = *self.options;
        let (snapshot, _) =
            checkpoints.load(self.spec, Memory { tile_bytes, spectrum_bytes }).map_err(open_io(folder))?;
        Ok(snapshot)
    }

    fn write_checkpoint(
        &self,
        new: &Path,
        erasure: &mut StateErasure,
        snapshot: Option<MapSnapshot>,
    ) -> Result<(), EraseError> {
        let folder = new.join("checkpoints");
        self.disk.create_folder(&folder).map_err(store_io(&folder))?;
        let checkpoints = Checkpoints { disk: &**self.disk, folder: folder.clone(), map: self.map };
        checkpoints.list(&CheckpointList::default())?;
        if let Some(snapshot) = snapshot {
            checkpoints.save(self.spec, &erasure.snapshot(snapshot), 1)?;
        }
        Ok(self.disk.sync_folder(&folder).map_err(store_io(folder))?)
    }

    fn write_log(
        &self,
        new: &Path,
        erasure: &mut StateErasure,
        known: u64,
        replay_from: u64,
    ) -> Result<(), EraseError> {
        let replay = self.events(known, replay_from)?;
        let checkpoints = Checkpoints { disk: &**self.disk, folder: new.join("checkpoints"), map: self.map };
        checkpoints.begin_log(replay_from)?;
        let new_folder = new.join("log");
        let cursor = create_log(&**self.disk, &new_folder, self.map.0, replay_from).map_err(store_io(&new_folder))?;
        let segment_bytes = self.options.segment_bytes;
        let writer = LogWriter::open(self.disk, new_folder.clone(), self.map.0, replay_from, cursor, segment_bytes);
        let mut writer = writer.map_err(store_io(&new_folder))?;
        let mut events = Vec::new();
        for entry in replay {
            let (position, event) = entry?;
            let event = EncodedEvent::encode(&erasure.event(position, event)).map_err(AppendError::InvalidEvent)?;
            events.push(event);
            if events.len() >= EVENTS_AT_ONCE {
                writer.write(&events)?;
                writer.sync()?;
                events.clear();
            }
        }
        writer.write(&events)?;
        writer.sync()?;
        Ok(self.disk.sync_folder(&new_folder).map_err(store_io(new_folder))?)
    }

    /// The events of the log that are still needed, from the record `replay_from` on.
    fn events(&self, known: u64, replay_from: u64) -> Result<Replay, EraseError> {
        let folder = folders::log_folder(self.directory, self.map);
        let expected = Expectation { map: self.map.0, replay_from, known, is_listed: true };
        let read = recovery::read(&**self.disk, &folder, &expected)?;
        let end = read.cursor.position - 1;
        Ok(Replay::new(Arc::clone(self.disk), folder, read.segments, replay_from, end))
    }

    fn history(&self) -> History {
        let folder = folders::history_folder(self.directory, self.map);
        History::at(Arc::clone(self.disk), folder, self.map)
    }

    fn write_history(&self, new: &Path, erasure: &StateErasure) -> Result<(), EraseError> {
        list_file::replace(&**self.disk, &new.join(HISTORY_FILE), &FileList::default()).map_err(store_io(new))?;
        let written = History::at(Arc::clone(self.disk), new.join("history"), self.map);
        let rewrite = |piece: &HistoryPiece| erasure.piece(piece);
        written.write_again(&self.history(), &rewrite, &copy)
    }
}

/// Puts the new folder of a map in the place of the old one.
pub(crate) fn swap(disk: &dyn Disk, directory: &Path, map: MapId) -> Result<(), StoreError> {
    let [folder, erased, replaced] = ["", ERASED_SUFFIX, REPLACED_SUFFIX].map(|suffix| match suffix {
        "" => folders::map_folder(directory, map),
        suffix => beside(directory, map, suffix),
    });
    let maps = folders::maps_folder(directory);
    let names = disk.list(&maps).map_err(store_io(&maps))?;
    let is_there = |path: &Path| path.file_name().is_some_and(|name| names.iter().any(|known| name == known.as_str()));
    if is_there(&folder) {
        remove_folder(disk, &replaced).map_err(store_io(&replaced))?;
        disk.rename(&folder, &replaced).map_err(store_io(&folder))?;
    }
    disk.rename(&erased, &folder).map_err(store_io(&erased))?;
    disk.sync_folder(&maps).map_err(store_io(maps))
}

/// Removes what an erasure has replaced.
pub(crate) fn clean(disk: &dyn Disk, directory: &Path, index: &mut Index, map: MapId) -> Result<(), EraseError> {
    index.erase(map.0).map_err(|failure| EraseError::Index { reason: failure.to_string() })?;
    let replaced = beside(directory, map, REPLACED_SUFFIX);
    remove_folder(disk, &replaced).map_err(store_io(replaced))?;
    let maps = folders::maps_folder(directory);
    Ok(disk.sync_folder(&maps).map_err(store_io(maps))?)
}

/// Names in the folder of all maps with a suffix.
pub(crate) fn with(disk: &dyn Disk, directory: &Path, suffix: &str) -> Result<Vec<MapId>, OpenError> {
    let maps = folders::maps_folder(directory);
    let names = disk.list(&maps).map_err(open_io(&maps))?;
    Ok(names.iter().filter_map(|name| folders::map_number(name.strip_suffix(suffix)?)).collect())
}

/// Runs before the maps are listed: completes erasures whose new folder is complete, and removes those that are not.
pub(crate) fn complete(
    disk: &dyn Disk,
    directory: &Path,
    index: &mut Index,
    repairs: &mut Vec<Repair>,
) -> Result<(), OpenError> {
    for map in with(disk, directory, ERASED_SUFFIX)? {
        swap(disk, directory, map).map_err(|error| error.opening(&folders::maps_folder(directory)))?;
        repairs.push(Repair::ErasureCompleted { map });
    }
    for map in with(disk, directory, REPLACED_SUFFIX)? {
        clean_at_start(disk, directory, index, map);
    }
    for map in with(disk, directory, ERASING_SUFFIX)? {
        let file = beside(directory, map, ERASING_SUFFIX);
        disk.remove_folder(&file).map_err(open_io(&file))?;
        repairs.push(Repair::LeftoverRemoved { file });
    }
    Ok(())
}

/// The erasure that was ordered and is not complete, if there is one.
///
/// # Errors
/// The file of the order is damaged or cannot be read.
pub(crate) fn read_order(disk: &dyn Disk, directory: &Path, map: MapId) -> Result<Option<ErasureOrder>, OpenError> {
    let file = folders::map_folder(directory, map).join(ERASE_FILE);
    match list_file::read::<ErasureOrder>(disk, &file) {
        Ok(order) => Ok(Some(order)),
        Err(Unlisted::Absent) => Ok(None),
        Err(Unlisted::Damaged(reason)) => Err(OpenError::Damaged { file, reason: reason.to_owned() }),
        Err(Unlisted::Io(error)) => Err(open_io(file)(error)),
    }
}

/// Runs after the maps are listed: repeats an erasure that was ordered. An error sets the map aside.
pub(crate) fn repeat(
    disk: &Arc<dyn Disk>,
    directory: &Path,
    options: &StoreOptions,
    index: &mut Index,
    map: MapId,
    spec: &MapSpec,
    repairs: &mut Vec<Repair>,
) -> Result<(), EraseError> {
    let Some(order) = read_order(&**disk, directory, map)? else { return Ok(()) };
    let rewrite = Rewrite { disk, directory, options, map, spec };
    rewrite.run(rewrite.prepare(&order)?)?;
    swap(&**disk, directory, map)?;
    repairs.push(Repair::ErasureCompleted { map });
    clean_at_start(&**disk, directory, index, map);
    Ok(())
}

fn clean_at_start(disk: &dyn Disk, directory: &Path, index: &mut Index, map: MapId) {
    if let Err(error) = clean(disk, directory, index, map) {
        tracing::error!(map = map.0, %error, "what was erased is still on the disk; tried again at the next start");
    }
}
