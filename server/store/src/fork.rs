//! Forks: records of this disk that a shared log does not have. They are set aside in a file of their own, and the log
//! is cut back to what both have.
//!
//! Invariant: a record is cut off only when the file that holds it is durable. A fork stays until an operator removes
//! it, or, if it has a single group, until the map has all of it.

use std::{
    io,
    path::{Path, PathBuf},
    sync::{Arc, PoisonError},
};

use tidemap_layout::{
    cluster::FORKS_FOLDER,
    lists::{NEWEST_FILE, NewestSegment},
    log::{SEGMENT_HEADER_LENGTH, SegmentHeader},
};
use tidemap_map::event::Event;

use crate::{
    MapId, Store,
    disk::{Disk, read_all},
    error::{OpenError, StoreError, open_io, shown, store_io},
    folders, list_file,
    log::{
        frame::{Cursor, next_frame},
        segment_path, segment_position,
    },
};

/// Records that were set aside.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fork {
    /// Name of the fork, which [`Store::fork_events`] and [`Store::remove_fork`] take.
    pub name: String,
    /// Position of its first record.
    pub first: u64,
    /// Position of its last record.
    pub last: u64,
    /// Number of its groups. A single one may never have been acknowledged: the daemon ended, or lost the log, while it
    /// was decided about.
    pub groups: usize,
}

/// Why a fork cannot be set aside. Nothing is cut off then.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the fields are named in the message")]
pub enum ForkError {
    /// The map cannot be made of what would be left.
    #[error(
        "{} holds no checkpoint up to position {common}, and its log begins behind it: the map needs the checkpoint of \
         another daemon",
        shown(.folder)
    )]
    NothingLeft { folder: PathBuf, common: u64 },
    /// A file cannot be read, or is damaged.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A file cannot be written.
    #[error(transparent)]
    Store(#[from] StoreError),
}

fn damaged(file: &Path, reason: &str) -> OpenError {
    OpenError::Damaged { file: file.to_owned(), reason: reason.to_owned() }
}

/// The place where the log is cut: segment, offset and the frames behind.
struct Cut {
    segment: u64,
    offset: u64,
    chain: u32,
    frames: Vec<u8>,
    later: Vec<u64>,
}

fn find_cut(disk: &dyn Disk, folder: &Path, common: u64) -> Result<Option<Cut>, OpenError> {
    let names = disk.list(folder).map_err(open_io(folder))?;
    let segments: Vec<u64> = names.iter().filter_map(|name| segment_position(name)).collect();
    let Some(start) = segments.iter().rposition(|&first| first <= common + 1) else { return Ok(None) };
    let first = segments[start];
    let file = segment_path(folder, first);
    let bytes = read_all(disk, &file).map_err(open_io(&file))?;
    let header = SegmentHeader::decode(&bytes).ok_or_else(|| damaged(&file, "its header is not valid"))?;
    let mut cursor = Cursor { offset: SEGMENT_HEADER_LENGTH, position: first, chain: header.chain };
    while cursor.position <= common {
        match next_frame(&bytes, &mut cursor) {
            Ok(Some(_)) => {}
            // The log ends before: nothing is to be cut.
            Ok(None) => return Ok(None),
            Err(bad) => return Err(damaged(&file, bad.reason)),
        }
    }
    let mut frames = bytes.get(cursor.offset..).unwrap_or_default().to_vec();
    let later = segments[start + 1..].to_vec();
    for &segment in &later {
        let file = segment_path(folder, segment);
        let bytes = read_all(disk, &file).map_err(open_io(&file))?;
        frames.extend_from_slice(bytes.get(SEGMENT_HEADER_LENGTH..).unwrap_or_default());
    }
    Ok(Some(Cut { segment: first, offset: cursor.offset as u64, chain: cursor.chain, frames, later }))
}

/// The records of the file of a fork, and the number of its groups.
fn read_fork(disk: &dyn Disk, file: &Path) -> Result<(Vec<(u64, Event)>, usize), OpenError> {
    let bytes = read_all(disk, file).map_err(open_io(file))?;
    let header = SegmentHeader::decode(&bytes).ok_or_else(|| damaged(file, "its header is not valid"))?;
    let mut cursor = Cursor { offset: SEGMENT_HEADER_LENGTH, position: header.first_position, chain: header.chain };
    let (mut events, mut groups) = (Vec::new(), 0);
    while let Some(frame) = next_frame(&bytes, &mut cursor).map_err(|bad| damaged(file, bad.reason))? {
        groups += usize::from(frame.header.group_index == 0);
        events.push((frame.header.position, frame.event().map_err(|reason| damaged(file, reason))?));
    }
    Ok((events, groups))
}

/// Reads the fork in a file that was set aside.
pub(crate) fn fork_in(disk: &dyn Disk, folder: &Path, name: String) -> Result<Fork, OpenError> {
    let (events, groups) = read_fork(disk, &folder.join(&name))?;
    let position = |event: Option<&(u64, Event)>| event.map_or(0, |&(position, _)| position);
    Ok(Fork { name, first: position(events.first()), last: position(events.last()), groups })
}

/// Names of the files of forks in a folder of them, which may be missing.
pub(crate) fn fork_names(disk: &dyn Disk, folder: &Path) -> io::Result<Vec<String>> {
    match disk.list(folder) {
        Ok(names) => Ok(names.into_iter().filter(|name| name.ends_with(".log")).collect()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(error),
    }
}

impl Store {
    fn forks_folder(&self, map: MapId) -> PathBuf {
        folders::map_folder(&self.inner().directory, map).join(FORKS_FOLDER)
    }

    /// Closes a map whose writer has stopped, sets its records behind `common` aside, and cuts log and checkpoints back
    /// to that position. The map can be opened again afterwards. `None`: there was nothing behind it.
    ///
    /// # Errors
    /// [`ForkError`].
    pub fn set_fork_aside(&self, map: MapId, common: u64) -> Result<Option<Fork>, ForkError> {
        let inner = self.inner();
        let entry = inner.close_log(map).ok_or(StoreError::UnknownMap(map))?;
        let _busy = entry.busy.lock().unwrap_or_else(PoisonError::into_inner);
        let (disk, log) = (&*inner.disk, folders::log_folder(&inner.directory, map));
        let checkpoints = inner.checkpoints(map);
        let positions = checkpoints.positions().map_err(store_io(&checkpoints.folder))?;
        let Some(cut) = find_cut(disk, &log, common)? else {
            return match positions.iter().any(|&position| position > common) {
                true => Err(ForkError::NothingLeft { folder: log, common }),
                false => Ok(None),
            };
        };
        if cut.frames.is_empty() && cut.later.is_empty() {
            return Ok(None);
        }
        let begins_late = inner.disk.list(&log).map_err(store_io(&log))?.iter().find_map(|name| segment_position(name));
        if begins_late.is_some_and(|first| first > 1) && !positions.iter().any(|&position| position <= common) {
            return Err(ForkError::NothingLeft { folder: log, common });
        }
        let fork = self.write_fork(map, common + 1, &cut)?;
        // Unlisted before they are removed.
        let (kept, newer): (Vec<u64>, Vec<u64>) = positions.into_iter().partition(|&position| position <= common);
        checkpoints.keep(kept)?;
        for position in newer {
            let file = checkpoints.path(position);
            disk.remove(&file).map_err(store_io(&file))?;
        }
        let list = log.join(NEWEST_FILE);
        list_file::replace(disk, &list, &NewestSegment { first_position: cut.segment }).map_err(store_io(&list))?;
        // The newest first, so that the log ends with a whole segment at every moment.
        for &segment in cut.later.iter().rev() {
            let file = segment_path(&log, segment);
            disk.remove(&file).and_then(|()| disk.sync_folder(&log)).map_err(store_io(&file))?;
        }
        let file = segment_path(&log, cut.segment);
        let cut_off = disk.open(&file).and_then(|mut open| open.truncate(cut.offset).and_then(|()| open.sync()));
        cut_off.map_err(store_io(&file))?;
        inner.index().purge(map.0);
        Ok(Some(fork))
    }

    /// Writes the file of a fork; durable when this returns.
    fn write_fork(&self, map: MapId, first: u64, cut: &Cut) -> Result<Fork, ForkError> {
        let inner = self.inner();
        let (disk, folder) = (&*inner.disk, self.forks_folder(map));
        match disk.create_folder(&folder) {
            Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => {
                return Err(StoreError::from_io(folder, error).into());
            }
            _ => {}
        }
        let parent = folders::map_folder(&inner.directory, map);
        disk.sync_folder(&parent).map_err(store_io(&parent))?;
        let header = SegmentHeader { map: map.0, first_position: first, chain: cut.chain };
        let mut bytes = header.encode().to_vec();
        bytes.extend_from_slice(&cut.frames);
        // A log may fork more than once at one position. Records that were cut off there before stay.
        let known = disk.list(&folder).map_err(store_io(&folder))?;
        let mut number = 1;
        let name = loop {
            let name = format!("{first:020}-{number}.log");
            let is_known = known.contains(&name);
            if !is_known || read_all(disk, &folder.join(&name)).is_ok_and(|found| found == bytes) {
                break name;
            }
            number += 1;
        };
        let file = folder.join(&name);
        let written = disk.create(&file).and_then(|mut open| open.append(&bytes).and_then(|()| open.sync()));
        written.and_then(|()| disk.sync_folder(&folder)).map_err(store_io(&file))?;
        Ok(fork_in(disk, &folder, name)?)
    }

    /// The forks of a map, in the order of their positions.
    ///
    /// # Errors
    /// [`OpenError`] where a file cannot be read.
    pub fn forks(&self, map: MapId) -> Result<Vec<Fork>, OpenError> {
        let (disk, folder) = (&*self.inner().disk, self.forks_folder(map));
        let names = fork_names(disk, &folder).map_err(open_io(folder.clone()))?;
        names.into_iter().map(|name| fork_in(disk, &folder, name)).collect()
    }

    /// The records of a fork, with the positions that they had.
    ///
    /// # Errors
    /// [`OpenError`] where its file cannot be read.
    pub fn fork_events(&self, map: MapId, fork: &str) -> Result<Vec<(u64, Event)>, OpenError> {
        read_fork(&*self.inner().disk, &self.forks_folder(map).join(fork)).map(|(events, _)| events)
    }

    /// Removes a fork. Records of the fork that the map lacks are lost.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn remove_fork(&self, map: MapId, fork: &str) -> Result<(), StoreError> {
        let (disk, folder) = (Arc::clone(&self.inner().disk), self.forks_folder(map));
        let file = folder.join(fork);
        disk.remove(&file).and_then(|()| disk.sync_folder(&folder)).map_err(store_io(&file))
    }
}
