//! The copy that a store gives of a map that is in use.
//!
//! Checkpoints and segments are opened before anything is read, so that they stay readable when the map is saved
//! meanwhile. Files of the history are opened one after the other, because there may be many: one that was deleted
//! meanwhile ends the copy with an error.
//!
//! Invariant: only durable data is given, and the log reaches from the first record that the checkpoint needs to the
//! end as it was at the beginning.

use std::{
    collections::VecDeque,
    path::{Path, PathBuf},
    sync::{Arc, PoisonError},
};

use tidemap_layout::{
    file::{CHECKPOINT_MAGIC, RecordKind},
    map as layout,
};

use super::{COPY_PART_BYTES, CopiedFile, CopyError, CopyPart, CopyTotal, cut_off};
use crate::{
    MapId, Store,
    checkpoint::Checkpoints,
    disk::{Disk, DiskReader},
    error::{HistoryError, OpenError, open_io},
    folders,
    log::{segment_path, segment_position},
    record_file::RecordReader,
    store::{MapEntry, OpenStore},
};

/// A file that is to be given.
struct GivenFile {
    name: String,
    path: PathBuf,
    length: u64,
    /// Opened when its turn comes, where it was not opened before.
    reader: Option<Box<dyn DiskReader>>,
}

/// The files of a map, to be given part by part. Reading it waits for the disk.
pub struct CopySource {
    disk: Arc<dyn Disk>,
    files: VecDeque<GivenFile>,
    offset: u64,
    total: CopyTotal,
}

impl Store {
    /// The data that another store needs to have an open map as it is now. Saves go on meanwhile.
    ///
    /// # Errors
    /// [`CopyError`].
    pub fn copy_source(&self, map: MapId) -> Result<CopySource, CopyError> {
        let inner = self.inner();
        let entry = inner.entry(map).ok_or(OpenError::UnknownMap(map))?;
        // Nothing is saved or deleted meanwhile, so that the opened files belong together.
        let _busy = entry.busy.lock().unwrap_or_else(PoisonError::into_inner);
        let checkpoint = newest_checkpoint(&inner.checkpoints(map))?;
        let mut files = VecDeque::new();
        if let Some((path, _)) = &checkpoint {
            files.push_back(open(&*inner.disk, CopiedFile::Checkpoint, path.clone(), None)?);
        }
        let needed = checkpoint.map(|(_, replay_from)| replay_from);
        files.extend(segments(inner, map, &entry, needed)?);
        let history = inner.history(map);
        for file in history.listed()?.files {
            let path = history.folder.join(&file.name);
            let name = name(CopiedFile::History, &path);
            files.push_back(GivenFile { name, path, length: file.length, reader: None });
        }
        let total =
            CopyTotal { files: files.len() as u64, bytes: files.iter().map(|file: &GivenFile| file.length).sum() };
        Ok(CopySource { disk: Arc::clone(&inner.disk), files, offset: 0, total })
    }
}

fn name(kind: CopiedFile, path: &Path) -> String {
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    format!("{}/{file}", kind.folder())
}

/// The newest checkpoint, with the record from which on it needs the log; `None`: there is none.
fn newest_checkpoint(checkpoints: &Checkpoints<'_>) -> Result<Option<(PathBuf, u64)>, CopyError> {
    let positions = checkpoints.positions().map_err(open_io(&checkpoints.folder))?;
    let found = positions.iter().rev().find_map(|&position| {
        let path = checkpoints.path(position);
        let mut reader = RecordReader::open(checkpoints.disk, &path, CHECKPOINT_MAGIC, checkpoints.map.0).ok()?;
        let snapshot = reader.record::<layout::Snapshot>(RecordKind::Snapshot).ok()?;
        Some((path, snapshot.replay_from.max(1)))
    });
    Ok(found)
}

fn open(disk: &dyn Disk, kind: CopiedFile, path: PathBuf, length: Option<u64>) -> Result<GivenFile, OpenError> {
    let reader = disk.read_anywhere(&path).map_err(open_io(&path))?;
    let length = match length {
        Some(length) => length,
        None => disk.length(&path).map_err(open_io(&path))?,
    };
    Ok(GivenFile { name: name(kind, &path), path, length, reader: Some(reader) })
}

/// The segments from the one on that a checkpoint needs, as far as they are durable; without a checkpoint all.
fn segments(inner: &OpenStore, map: MapId, entry: &MapEntry, needed: Option<u64>) -> Result<Vec<GivenFile>, CopyError> {
    let log = entry.log.as_ref().ok_or(OpenError::UnknownMap(map))?;
    let (newest, durable) = {
        let writer = log.writer.lock().unwrap_or_else(PoisonError::into_inner);
        let writer = writer.as_ref().ok_or(OpenError::UnknownMap(map))?;
        (writer.segment(), writer.durable_bytes())
    };
    let folder = folders::log_folder(&inner.directory, map);
    let names = inner.disk.list(&folder).map_err(open_io(&folder))?;
    // A segment that was created after the newest one was read from the writer is left out.
    let present = names.iter().filter_map(|name| segment_position(name)).filter(|&first| first <= newest);
    let present: Vec<u64> = present.collect();
    let begin = present.iter().rposition(|&first| first <= needed.unwrap_or(1));
    let begin = begin.ok_or_else(|| CopyError::NoCheckpoint(folder.clone()))?;
    let given = present[begin..].iter().map(|&first| {
        let length = (first == newest).then_some(durable);
        Ok(open(&*inner.disk, CopiedFile::Segment, segment_path(&folder, first), length)?)
    });
    given.collect()
}

impl CopySource {
    /// The total amount of data that is given.
    #[must_use]
    pub fn total(&self) -> CopyTotal {
        self.total
    }

    fn read_part(&mut self) -> Result<Option<CopyPart>, CopyError> {
        let Some(file) = self.files.front_mut() else { return Ok(None) };
        let io_error = |source| HistoryError::Io { file: file.path.clone(), source };
        let reader = match &file.reader {
            Some(reader) => reader,
            None => file.reader.insert(self.disk.read_anywhere(&file.path).map_err(io_error)?),
        };
        let rest = file.length.checked_sub(self.offset).ok_or_else(cut_off).map_err(io_error)?;
        let mut bytes = vec![0; usize::try_from(rest).unwrap_or(usize::MAX).min(COPY_PART_BYTES)];
        reader.read_exact_at(&mut bytes, self.offset).map_err(io_error)?;
        let is_last = bytes.len() as u64 == rest;
        let part = CopyPart { name: file.name.clone(), offset: self.offset, bytes, is_last };
        self.offset += part.bytes.len() as u64;
        if is_last {
            self.files.pop_front();
            self.offset = 0;
        }
        Ok(Some(part))
    }
}

impl Iterator for CopySource {
    type Item = Result<CopyPart, CopyError>;

    fn next(&mut self) -> Option<Self::Item> {
        let part = self.read_part();
        if part.is_err() {
            self.files.clear();
        }
        part.transpose()
    }
}
