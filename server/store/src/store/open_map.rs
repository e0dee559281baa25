//! Opening a map: the newest checkpoint that can be trusted, and the log after it.
//!
//! Invariant: the log is read to its end and checked before anything is repaired.

use std::{
    path::Path,
    sync::{Arc, PoisonError, atomic::Ordering},
};

use tidemap_map::{snapshot::MapSnapshot, spec::MapSpec};

use super::{MapEntry, OpenStore, OpenedMap, Source, Store, index_repair::IndexState};
use crate::{
    MapId,
    checkpoint::{Checkpoints, Memory, UnreadCheckpoint},
    disk::Disk,
    error::{OpenError, Repair, open_io},
    failure::ReadFailure,
    folders,
    index::RowsState,
    list_file::{self, Unlisted},
    log::{
        Log,
        recovery::{Expectation, Read, Recovered, read, repair},
        replay::Replay,
        segment_path, segment_position,
        writer::LogWriter,
    },
    map_log::MapLog,
};

/// The newest snapshot, and the damage found elsewhere.
struct Newest {
    snapshot: Option<MapSnapshot>,
    source: Source,
    /// The newest position that a checkpoint or the index has.
    known: u64,
    unread: Vec<UnreadCheckpoint>,
    index: IndexState,
}

/// The stored data of a map, as a start reads it before anything is repaired.
pub(crate) struct StoredMap {
    newest: Newest,
    /// The first event that is replayed.
    replay_from: u64,
    log: Read,
}

impl StoredMap {
    /// The newest snapshot, with the segments of the log that are replayed, the first record that is, and the last one.
    pub(crate) fn into_parts(self) -> (Option<MapSnapshot>, Vec<u64>, u64, u64) {
        let end = self.log.cursor.position - 1;
        (self.newest.snapshot, self.log.segments, self.replay_from, end)
    }
}

/// Reads a map: its newest checkpoint that can be read, and its log. `rows` is what the index holds of it. A start and
/// a check call this, so that they agree. Changes nothing.
///
/// # Errors
/// The map cannot be opened.
pub(crate) fn read_map(
    checkpoints: &Checkpoints<'_>,
    spec: &MapSpec,
    memory: Memory,
    rows: Result<RowsState, ReadFailure>,
) -> Result<StoredMap, OpenError> {
    let newest = newest_snapshot(checkpoints, spec, memory, rows)?;
    let replay_from = newest.snapshot.as_ref().map_or(1, |snapshot| snapshot.replay_from.max(1));
    let folder = checkpoints.folder.with_file_name("log");
    check_beginning(checkpoints.disk, &folder, &newest)?;
    let expected = Expectation { map: checkpoints.map.0, replay_from, known: newest.known, is_listed: true };
    let log = read(checkpoints.disk, &folder, &expected)?;
    Ok(StoredMap { newest, replay_from, log })
}

/// The newest good checkpoint, and whether the index has its rows. Changes nothing.
fn newest_snapshot(
    checkpoints: &Checkpoints<'_>,
    spec: &MapSpec,
    memory: Memory,
    rows: Result<RowsState, ReadFailure>,
) -> Result<Newest, OpenError> {
    let names = checkpoints.positions().map_err(|error| no_checkpoints(&checkpoints.folder, error))?;
    let (snapshot, unread) = checkpoints.load(spec, memory).map_err(open_io(&checkpoints.folder))?;
    let mut known = names.last().copied().unwrap_or(0);
    if let Ok(RowsState::Whole { position, .. }) = &rows {
        known = known.max(*position);
    }
    let index = IndexState::of(rows, snapshot.as_ref());
    let source = if snapshot.is_some() { Source::Checkpoint } else { Source::Log };
    Ok(Newest { snapshot, source, known, unread, index })
}

/// Why the folder of checkpoints cannot be listed.
fn no_checkpoints(folder: &Path, error: std::io::Error) -> OpenError {
    if error.kind() != std::io::ErrorKind::NotFound {
        return open_io(folder)(error);
    }
    let reason = "it is missing, with the checkpoints of the map. If there is no backup, make an empty folder of this \
                  name: the map is then made of its log, if that is whole from record 1 on"
        .to_owned();
    OpenError::Damaged { file: folder.to_owned(), reason }
}

/// Without a snapshot the log must start at its first record, because a deleted beginning exists only in
/// checkpoints.
fn check_beginning(disk: &dyn Disk, folder: &Path, newest: &Newest) -> Result<(), OpenError> {
    if newest.snapshot.is_some() {
        return Ok(());
    }
    let names = disk.list(folder).map_err(open_io(folder))?;
    match names.iter().find_map(|name| segment_position(name)) {
        Some(first) if first > 1 && !newest.unread.is_empty() => {
            let file = folder.with_file_name("checkpoints");
            let refused = newest.unread.iter().map(UnreadCheckpoint::failure).find_map(|failure| match failure {
                ReadFailure::Disk(reason) => Some(reason.clone()),
                ReadFailure::Damaged(_) => None,
            });
            if let Some(reason) = refused {
                return Err(OpenError::Io { file, source: std::io::Error::other(reason) });
            }
            let reasons: Vec<String> = newest.unread.iter().map(|unread| unread.failure().to_string()).collect();
            Err(OpenError::Damaged {
                file,
                reason: format!(
                    "none of its files can be read ({}), and the log begins at record {first}, because what was \
                     before is in them",
                    reasons.join("; ")
                ),
            })
        }
        _ => Ok(()),
    }
}

impl Store {
    /// Opens a map: finds its newest snapshot, reads its log to the end, and removes leftovers of an interruption.
    ///
    /// # Errors
    /// [`OpenError`]. The map's log has not been changed then.
    pub fn open_map(&self, map: MapId, spec: &MapSpec) -> Result<OpenedMap, OpenError> {
        let inner = &*self.inner;
        let entry = inner.maps().entries.get(&map).cloned().ok_or(OpenError::UnknownMap(map))?;
        // Only one caller may open the map: recovery must not read a log that is being written.
        let _busy = entry.busy.lock().unwrap_or_else(PoisonError::into_inner);
        if inner.maps().entries.get(&map).ok_or(OpenError::UnknownMap(map))?.log.is_some() {
            return Err(OpenError::AlreadyOpen(map));
        }
        let rows = inner.index().check(map.0);
        let memory =
            Memory { tile_bytes: inner.options.tile_cache_bytes, spectrum_bytes: inner.options.spectrum_cache_bytes };
        let StoredMap { newest, replay_from, log } = read_map(&inner.checkpoints(map), spec, memory, rows)?;
        let folder = folders::log_folder(&inner.directory, map);
        let recovered = repair(&*inner.disk, &folder, log)?;
        let (log, replay, mut repairs) = inner.open_log(map, &folder, replay_from, recovered)?;

        if let (Some(log), Some(snapshot)) = (inner.entry(map).and_then(|entry| entry.log), &newest.snapshot) {
            log.saved.store(snapshot.position, Ordering::Release);
        }

        let checkpoints = inner.checkpoints(map);
        inner.miss_spares(map, &folder, &mut repairs)?;
        checkpoints.remove_leftovers(&mut repairs)?;
        inner.history(map).remove_leftovers(&mut repairs)?;
        for unread in newest.unread {
            let repair = checkpoints.set_aside(unread)?;
            if let Repair::CheckpointNotRead { file, reason } = &repair {
                let within = file.strip_prefix(&inner.directory).unwrap_or(file).to_owned();
                inner.committer.watch.damaged(within, Some(reason.clone()));
            }
            repairs.push(repair);
        }
        inner.repair_index(map, newest.snapshot.as_ref(), newest.index, &mut repairs);

        let source = if newest.source == Source::Log && log.end() == 0 { Source::Empty } else { newest.source };
        Ok(OpenedMap { log, snapshot: newest.snapshot, source, replay, repairs })
    }
}

impl OpenStore {
    /// Reports files that should exist beside those from which the map was opened, and are missing. The next save lists
    /// them no longer.
    fn miss_spares(&self, map: MapId, log: &Path, repairs: &mut Vec<Repair>) -> Result<(), OpenError> {
        let (checkpoints, file) = (self.checkpoints(map), self.checkpoints(map).list_path());
        let present = checkpoints.present(log).map_err(open_io(log))?;
        let listed = match checkpoints.listed().map_err(Unlisted::lost) {
            Ok(listed) => listed,
            // The map is whole, whatever else was listed: the newest checkpoint and the log after it are good.
            Err(Ok(reason)) => {
                list_file::replace(&*self.disk, &file, &present).map_err(open_io(&file))?;
                repairs.push(Repair::ListMade { file, reason });
                return Ok(());
            }
            Err(Err(error)) => return Err(open_io(file)(error)),
        };
        let is_missing = |position: &&u64| !present.checkpoints.contains(position);
        let missing = listed.checkpoints.iter().filter(is_missing).map(|&position| checkpoints.path(position));
        let first = Some(listed.first_record).filter(|&first| first < present.first_record);
        for file in missing.chain(first.map(|first| segment_path(log, first))) {
            let within = file.strip_prefix(&self.directory).unwrap_or(&file).to_owned();
            self.committer.watch.damaged(within, Some("it is missing".to_owned()));
            repairs.push(Repair::SpareMissing { file });
        }
        Ok(())
    }

    fn open_log(
        &self,
        map: MapId,
        folder: &Path,
        replay_from: u64,
        recovered: Recovered,
    ) -> Result<(MapLog, Replay, Vec<Repair>), OpenError> {
        let Recovered { segments, cursor, progress, repairs } = recovered;
        let newest = segments.last().copied().unwrap_or(1);
        let writer = LogWriter::open(&self.disk, folder.to_owned(), map.0, newest, cursor, self.options.segment_bytes)
            .map_err(open_io(folder))?;
        let end = writer.end();
        let log = Arc::new(Log::new(map.0, writer, progress));
        let mut maps = self.maps();
        let entry: &mut MapEntry = maps.entries.get_mut(&map).ok_or(OpenError::UnknownMap(map))?;
        entry.log = Some(Arc::clone(&log));
        drop(maps);
        let replay = Replay::new(Arc::clone(&self.disk), folder.to_owned(), segments, replay_from, end);
        Ok((MapLog::new(log, Arc::clone(&self.committer)), replay, repairs))
    }
}
