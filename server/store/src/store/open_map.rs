//! Opening a map: the newest checkpoint that can be trusted, and the log after it.
//!
//! Invariant: the log is read to its end and checked before anything is repaired.

use std::{
    path::Path,
    sync::{Arc, PoisonError, atomic::Ordering},
};

use tidemap_map::{snapshot::MapSnapshot, spec::MapSpec};

use super::{MapEntry, OpenStore, OpenedMap, Source, Store};
use crate::{
    MapId,
    checkpoint::{DamagedCheckpoint, Memory},
    error::{OpenError, Report, open_io},
    folders,
    index::RowsState,
    list_file::{self, Unlisted},
    log::{
        Log,
        recovery::{Expectation, Recovered, recover},
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
    damaged: Vec<DamagedCheckpoint>,
    index: IndexState,
}

/// The repair that the index needs.
enum IndexState {
    /// Nothing.
    Good,
    /// The map must be written again.
    Stale(&'static str),
    /// The index must be replaced as a whole.
    Damaged(String),
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
        let newest = inner.newest_snapshot(map, spec)?;
        let replay_from = newest.snapshot.as_ref().map_or(1, |snapshot| snapshot.replay_from.max(1));
        let folder = folders::log_folder(&inner.directory, map);
        inner.check_beginning(&folder, &newest)?;
        let expected = Expectation { map: map.0, replay_from, known: newest.known, is_listed: true };
        let recovered = recover(&*inner.disk, &folder, &expected)?;
        let (log, replay, mut reports) = inner.open_log(map, &folder, replay_from, recovered)?;

        if let (Some(log), Some(snapshot)) = (inner.entry(map).and_then(|entry| entry.log), &newest.snapshot) {
            log.saved.store(snapshot.position, Ordering::Release);
        }

        let checkpoints = inner.checkpoints(map);
        inner.miss_spares(map, &folder, &mut reports)?;
        checkpoints.remove_leftovers(&mut reports)?;
        inner.history(map).remove_leftovers(&mut reports)?;
        for damaged in newest.damaged {
            reports.push(checkpoints.set_aside(damaged)?);
        }
        inner.repair_index(map, newest.snapshot.as_ref(), newest.index, &mut reports);

        let source = if newest.source == Source::Log && log.end() == 0 { Source::Empty } else { newest.source };
        Ok(OpenedMap { log, snapshot: newest.snapshot, source, replay, reports })
    }
}

impl OpenStore {
    /// Without a snapshot the log must start at its first record, because a deleted beginning exists only in
    /// checkpoints.
    fn check_beginning(&self, folder: &Path, newest: &Newest) -> Result<(), OpenError> {
        if newest.snapshot.is_some() {
            return Ok(());
        }
        let names = self.disk.list(folder).map_err(open_io(folder))?;
        match names.iter().find_map(|name| segment_position(name)) {
            Some(first) if first > 1 && !newest.damaged.is_empty() => {
                let reasons: Vec<&str> = newest.damaged.iter().map(DamagedCheckpoint::reason).collect();
                Err(OpenError::Damaged {
                    file: folder.with_file_name("checkpoints"),
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

    /// Tells what should exist beside what the map was opened from, and is missing. The next save lists it no longer.
    fn miss_spares(&self, map: MapId, log: &Path, reports: &mut Vec<Report>) -> Result<(), OpenError> {
        let (checkpoints, file) = (self.checkpoints(map), self.checkpoints(map).list_path());
        let present = checkpoints.present(log).map_err(open_io(log))?;
        let listed = match checkpoints.listed().map_err(Unlisted::lost) {
            Ok(listed) => listed,
            // The map is whole, whatever else was listed: the newest checkpoint and the log after it are good.
            Err(Ok(reason)) => {
                list_file::replace(&*self.disk, &file, &present).map_err(open_io(&file))?;
                reports.push(Report::ListMade { file, reason });
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
            reports.push(Report::SpareMissing { file });
        }
        Ok(())
    }

    /// The newest good checkpoint, and whether the index has its rows. Changes nothing.
    fn newest_snapshot(&self, map: MapId, spec: &MapSpec) -> Result<Newest, OpenError> {
        let checkpoints = self.checkpoints(map);
        let names = checkpoints.positions().map_err(open_io(&checkpoints.folder))?;
        let found = self.index().check(map.0);
        let memory =
            Memory { tile_bytes: self.options.tile_cache_bytes, spectrum_bytes: self.options.spectrum_cache_bytes };
        let (snapshot, damaged) = checkpoints.load(spec, memory).map_err(open_io(&checkpoints.folder))?;
        let mut known = names.last().copied().unwrap_or(0);
        let index = match found {
            Ok(RowsState::Nothing) if snapshot.is_none() => IndexState::Good,
            Ok(RowsState::Nothing) => IndexState::Stale("it held nothing of this map"),
            Ok(RowsState::Unfinished) => IndexState::Stale("it was being written when the process stopped"),
            Ok(RowsState::Whole { position, generation }) => {
                known = known.max(position);
                match snapshot.as_ref().map(|snapshot| (snapshot.position, snapshot.generation)) {
                    Some(newest) if newest == (position, generation) => IndexState::Good,
                    Some((newest, _)) if newest > position => {
                        IndexState::Stale("it is older than the newest checkpoint")
                    }
                    _ => IndexState::Stale("it is newer than the newest good checkpoint"),
                }
            }
            Err(damage) => IndexState::Damaged(damage),
        };
        let source = if snapshot.is_some() { Source::Checkpoint } else { Source::Log };
        Ok(Newest { snapshot, source, known, damaged, index })
    }

    fn open_log(
        &self,
        map: MapId,
        folder: &Path,
        replay_from: u64,
        recovered: Recovered,
    ) -> Result<(MapLog, Replay, Vec<Report>), OpenError> {
        let Recovered { segments, cursor, progress, reports } = recovered;
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
        Ok((MapLog::new(log, Arc::clone(&self.committer)), replay, reports))
    }

    /// Updates the index to the snapshot in use. An error here only disables the index.
    fn repair_index(&self, map: MapId, snapshot: Option<&MapSnapshot>, state: IndexState, reports: &mut Vec<Report>) {
        let mut index = self.index();
        let reason = match state {
            IndexState::Good => return,
            IndexState::Stale(reason) => reason.to_owned(),
            IndexState::Damaged(damage) => {
                match index.replace() {
                    Ok(folder) => reports.push(Report::IndexSetAside { folder, reason: damage.clone() }),
                    Err(reason) => reports.push(Report::IndexUnavailable { reason }),
                }
                damage
            }
        };
        match snapshot {
            Some(snapshot) if index.is_available() => {
                index.save(map.0, snapshot);
                reports.push(if index.is_available() {
                    Report::IndexRebuilt { map, reason }
                } else {
                    Report::IndexUnavailable { reason: "it cannot be written".to_owned() }
                });
            }
            // Rows of a generation that is no longer known.
            None if index.is_available() => index.purge(map.0),
            _ => {}
        }
    }
}
