//! Writing groups of records to the newest segment of a log.
//!
//! Invariant: the file holds valid records up to `length` and, behind that, at most one group that is not durable yet,
//! or that a shared log has not accepted yet. A group that cannot be written is cut off again. If that fails too,
//! nothing more is written.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use tidemap_layout::{
    lists::{NEWEST_FILE, NewestSegment},
    log::{FIRST_CHAIN, SEGMENT_HEADER_LENGTH, SegmentHeader},
};

use crate::{
    disk::{Disk, DiskFile},
    error::{AppendError, is_disk_full},
    list_file,
    log::{
        frame::{Cursor, EncodedEvent},
        segment_path,
    },
};

/// The newest segment of a log, open for appending.
pub(crate) struct LogWriter {
    disk: Arc<dyn Disk>,
    folder: PathBuf,
    map: u32,
    segment_bytes: u64,
    file: Box<dyn DiskFile>,
    path: PathBuf,
    /// Position of the segment's first record.
    first_position: u64,
    length: u64,
    next_position: u64,
    chain: u32,
    /// Length, next position and chain once the group that was written is kept.
    written: Option<(u64, u64, u32)>,
    buffer: Vec<u8>,
}

impl LogWriter {
    /// Opens a log to append behind its last record.
    pub(crate) fn open(
        disk: &Arc<dyn Disk>,
        folder: PathBuf,
        map: u32,
        newest: u64,
        cursor: Cursor,
        segment_bytes: u64,
    ) -> std::io::Result<LogWriter> {
        let path = segment_path(&folder, newest);
        Ok(LogWriter {
            file: disk.open(&path)?,
            disk: Arc::clone(disk),
            folder,
            map,
            segment_bytes,
            path,
            first_position: newest,
            length: cursor.offset as u64,
            next_position: cursor.position,
            chain: cursor.chain,
            written: None,
            buffer: Vec::new(),
        })
    }

    /// Position of the last durable record.
    pub(crate) fn end(&self) -> u64 {
        self.next_position - 1
    }

    /// Chain behind the last durable record.
    pub(crate) fn chain(&self) -> u32 {
        self.chain
    }

    /// The frames of the group that was written last.
    pub(crate) fn written_frames(&self) -> &[u8] {
        &self.buffer
    }

    /// Chain behind the group that was written and is not kept yet.
    pub(crate) fn written_chain(&self) -> u32 {
        self.written.map_or(self.chain, |(.., chain)| chain)
    }

    /// Bytes of the newest segment that are durable.
    pub(crate) fn durable_bytes(&self) -> u64 {
        self.length
    }

    /// First position of the newest segment, which is durable with its name.
    pub(crate) fn segment(&self) -> u64 {
        self.first_position
    }

    fn poisoned(path: &Path, error: &std::io::Error) -> AppendError {
        AppendError::Poisoned { file: path.to_owned(), reason: error.to_string() }
    }

    /// Writes a group behind the last durable record. [`AppendError::DiskFull`] leaves the log as it was.
    pub(crate) fn write(&mut self, group: &[EncodedEvent]) -> Result<(), AppendError> {
        self.make_room()?;
        self.buffer.clear();
        self.buffer.reserve(group.iter().map(EncodedEvent::frame_length).sum());
        let (mut position, mut chain) = (self.next_position, self.chain);
        for (index, event) in group.iter().enumerate() {
            // The committer's queue bounds a group far below the limit of u32.
            chain = event.write(position, index as u32, chain, &mut self.buffer);
            position += 1;
        }
        self.append_buffer(position, chain)
    }

    /// Writes the frames of a group that another daemon has made behind the last durable record, which they follow.
    /// `position` and `chain` are those behind the group. Errors as [`Self::write`].
    pub(crate) fn write_frames(&mut self, frames: &[u8], position: u64, chain: u32) -> Result<(), AppendError> {
        self.make_room()?;
        self.buffer.clear();
        self.buffer.extend_from_slice(frames);
        self.append_buffer(position, chain)
    }

    /// Begins a segment where the newest is long enough.
    fn make_room(&mut self) -> Result<(), AppendError> {
        if self.length >= self.segment_bytes && self.length > SEGMENT_HEADER_LENGTH as u64 {
            self.begin_segment()?;
        }
        Ok(())
    }

    fn append_buffer(&mut self, position: u64, chain: u32) -> Result<(), AppendError> {
        match self.file.append(&self.buffer) {
            Ok(()) => {
                self.written = Some((self.length + self.buffer.len() as u64, position, chain));
                Ok(())
            }
            Err(error) if is_disk_full(&error) => {
                // Synced before the next group is written, so that bytes of both cannot mix on the disk.
                let cut = self.file.truncate(self.length).and_then(|()| self.file.sync());
                Err(cut.map_or_else(|error| Self::poisoned(&self.path, &error), |()| AppendError::DiskFull))
            }
            Err(error) => Err(Self::poisoned(&self.path, &error)),
        }
    }

    /// Makes the written group durable and keeps it. After an error the content of the disk is unknown.
    pub(crate) fn sync(&mut self) -> Result<(), AppendError> {
        self.sync_written()?;
        self.keep();
        Ok(())
    }

    /// Makes the written group durable; [`Self::keep`] or [`Self::take_back`] decides about it.
    pub(crate) fn sync_written(&mut self) -> Result<(), AppendError> {
        self.file.sync().map_err(|error| Self::poisoned(&self.path, &error))?;
        self.verify()
    }

    /// Cuts the written group off again, durably.
    pub(crate) fn take_back(&mut self) -> Result<(), AppendError> {
        if self.written.take().is_some() {
            let cut = self.file.truncate(self.length).and_then(|()| self.file.sync());
            cut.map_err(|error| Self::poisoned(&self.path, &error))?;
        }
        Ok(())
    }

    /// The written group, which is durable, belongs to the log.
    pub(crate) fn keep(&mut self) {
        if let Some((length, next_position, chain)) = self.written.take() {
            (self.length, self.next_position, self.chain) = (length, next_position, chain);
        }
    }

    /// Checks whether the file is still the one that was written, as long as it was written: the records of a file that
    /// nobody can find again, or that was cut, are lost although the disk has taken them. The check takes microseconds
    /// beside a sync.
    pub(crate) fn verify(&self) -> Result<(), AppendError> {
        let length = self.written.map_or(self.length, |(length, ..)| length);
        match self.file.problem(&self.path, length) {
            Some(reason) => Err(AppendError::Poisoned { file: self.path.clone(), reason: reason.to_owned() }),
            None => Ok(()),
        }
    }

    /// Creates the next segment. All records of the current one are durable.
    fn begin_segment(&mut self) -> Result<(), AppendError> {
        let header = SegmentHeader { map: self.map, first_position: self.next_position, chain: self.chain };
        let path = segment_path(&self.folder, self.next_position);
        let (file, length) = create_segment(&*self.disk, &path, &header).map_err(|error| {
            // Nothing depends on the new file yet: it is created again, or removed when the log is opened.
            if is_disk_full(&error) { AppendError::DiskFull } else { Self::poisoned(&path, &error) }
        })?;
        self.disk.sync_folder(&self.folder).map_err(|error| Self::poisoned(&self.folder, &error))?;
        let newest = NewestSegment { first_position: self.next_position };
        list_file::replace(&*self.disk, &self.folder.join(NEWEST_FILE), &newest).map_err(|error| {
            // The list is the old one, and the segment is created again.
            if is_disk_full(&error) { AppendError::DiskFull } else { Self::poisoned(&self.folder, &error) }
        })?;
        (self.file, self.path, self.length) = (file, path, length);
        self.first_position = header.first_position;
        Ok(())
    }
}

/// Creates a segment; its content is durable afterwards, its name in the folder is not.
fn create_segment(disk: &dyn Disk, path: &Path, header: &SegmentHeader) -> std::io::Result<(Box<dyn DiskFile>, u64)> {
    let mut file = disk.create(path)?;
    file.append(&header.encode())?;
    file.sync()?;
    Ok((file, SEGMENT_HEADER_LENGTH as u64))
}

/// Creates the first segment of a new log, which begins with the record at `first_position`. Returns where that goes.
pub(crate) fn create_log(disk: &dyn Disk, folder: &Path, map: u32, first_position: u64) -> std::io::Result<Cursor> {
    disk.create_folder(folder)?;
    let header = SegmentHeader { map, first_position, chain: FIRST_CHAIN };
    create_segment(disk, &segment_path(folder, first_position), &header)?;
    list_file::replace(disk, &folder.join(NEWEST_FILE), &NewestSegment { first_position })?;
    Ok(Cursor { offset: SEGMENT_HEADER_LENGTH, position: first_position, chain: FIRST_CHAIN })
}
