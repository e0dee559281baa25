//! One open history file: its table of contents and random access to its parts.
//!
//! Invariant: a part that is read has passed its checksum and lies where the table states, or the error names the file.

use std::{
    io,
    path::{Path, PathBuf},
};

use tidemap_layout::{
    file::{FILE_HEADER_LENGTH, FileHeader, HISTORY_MAGIC, RECORD_HEADER_LENGTH, RecordKind, TRAILER_LENGTH, Trailer},
    history::{END_LENGTH, End},
};

use crate::{
    disk::{Disk, DiskReader},
    error::HistoryError,
    failure::ReadFailure,
    record_file::{RecordReader, anywhere},
};

/// An open history file. It stays readable after it was deleted.
pub(super) struct HistoryFile {
    pub(super) file: Box<dyn DiskReader>,
    path: PathBuf,
    pub(super) end: End,
    /// The checksum in its trailer.
    pub(super) total_crc: u32,
}

impl HistoryFile {
    pub(super) fn open(disk: &dyn Disk, path: &Path, map: u32, generation: u64) -> Result<HistoryFile, HistoryError> {
        let io_error = |source: io::Error| HistoryError::Io { file: path.to_owned(), source };
        let damaged = |reason: &str| HistoryError::Damaged { file: path.to_owned(), reason: reason.to_owned() };
        let file = disk.read_anywhere(path).map_err(io_error)?;
        let length = disk.length(path).map_err(io_error)?;
        let rest = (RECORD_HEADER_LENGTH + END_LENGTH + TRAILER_LENGTH) as u64;
        let Some(end) = length.checked_sub(rest) else { return Err(damaged("it is cut off")) };
        let mut bytes = [0; FILE_HEADER_LENGTH];
        file.read_exact_at(&mut bytes, 0).map_err(io_error)?;
        let header = FileHeader::decode(&bytes).ok_or_else(|| damaged("its header is not valid"))?;
        if header != (FileHeader { magic: HISTORY_MAGIC, map, position: generation }) {
            return Err(damaged("its header is that of another file"));
        }
        let mut trailer = [0; TRAILER_LENGTH];
        file.read_exact_at(&mut trailer, length - TRAILER_LENGTH as u64).map_err(io_error)?;
        let trailer = Trailer::decode(&trailer).ok_or_else(|| damaged("its end is not valid"))?;
        let (payload, _) = anywhere::raw(&*file, RecordKind::End, end).map_err(|failure| unread(path, failure))?;
        let end = End::decode(&payload).ok_or_else(|| damaged("its end is not valid"))?;
        Ok(HistoryFile { file, path: path.to_owned(), end, total_crc: trailer.total_crc })
    }

    /// A record that cannot be read.
    pub(super) fn unread(&self, failure: ReadFailure) -> HistoryError {
        unread(&self.path, failure)
    }

    pub(super) fn damaged(&self, reason: impl Into<String>) -> HistoryError {
        HistoryError::Damaged { file: self.path.clone(), reason: reason.into() }
    }

    pub(super) fn to_nanos(&self) -> i64 {
        self.end.to_nanos
    }

    /// Whether it may have observations from one instant up to another.
    pub(super) fn overlaps(&self, from_nanos: i64, to_nanos: i64) -> bool {
        self.end.from_nanos < to_nanos && self.end.to_nanos >= from_nanos
    }
}

/// The reason why a file is of no use: its contents are damaged, or the disk does not give it.
fn unread(path: &Path, failure: ReadFailure) -> HistoryError {
    let file = path.to_owned();
    match failure {
        ReadFailure::Damaged(reason) => HistoryError::Damaged { file, reason },
        ReadFailure::Disk(reason) => HistoryError::Io { file, source: io::Error::other(reason) },
    }
}

/// Reads a new file back and checks that its bytes are those written, and that its records end correctly.
pub(super) fn verify(disk: &dyn Disk, path: &Path, map: u32, generation: u64, trailer: Trailer) -> Result<(), String> {
    let mut reader = RecordReader::open(disk, path, HISTORY_MAGIC, map)?;
    if reader.header.position != generation {
        return Err("the content differs".to_owned());
    }
    let mut buffer = Vec::new();
    loop {
        let kind = reader.next_kind()?;
        reader.raw(kind, &mut buffer)?;
        if kind == RecordKind::End {
            break;
        }
    }
    if reader.finish()? == trailer { Ok(()) } else { Err("the content differs".to_owned()) }
}
