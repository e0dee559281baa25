//! Reading the groups of a log again, with one segment in memory at a time.
//!
//! Invariant: groups come in the order of their positions without a gap, each as it was written, or an error ends them.

use std::{path::Path, path::PathBuf, sync::Arc, vec::IntoIter};

use tidemap_layout::log::{SEGMENT_HEADER_LENGTH, SegmentHeader};

use crate::{
    disk::{Disk, read_all},
    error::{OpenError, open_io},
    log::{
        frame::{Cursor, next_frame},
        record_group::{LogPoint, RecordGroup},
        segment_path, segment_position,
    },
};

/// The groups of a log from one position up to its end as it was when they were opened.
pub struct Groups {
    disk: Arc<dyn Disk>,
    folder: PathBuf,
    /// First positions of the segments still to read.
    segments: IntoIter<u64>,
    segment: Segment,
    from: u64,
    end: u64,
    has_failed: bool,
}

/// A segment that is read.
struct Segment {
    file: PathBuf,
    bytes: Vec<u8>,
    cursor: Cursor,
}

fn corrupt(file: &Path, offset: usize, position: u64, reason: &str) -> OpenError {
    OpenError::CorruptLog { file: file.to_owned(), offset: offset as u64, position, reason: reason.to_owned() }
}

/// First positions of the segments from the one on that holds a record.
fn segments_from(disk: &dyn Disk, folder: &Path, position: u64) -> Result<Option<Vec<u64>>, OpenError> {
    let names = disk.list(folder).map_err(open_io(folder))?;
    let mut segments: Vec<u64> = names.iter().filter_map(|name| segment_position(name)).collect();
    let Some(start) = segments.iter().rposition(|&first| first <= position) else { return Ok(None) };
    segments.drain(..start);
    Ok(Some(segments))
}

impl Segment {
    fn open(disk: &dyn Disk, folder: &Path, first: u64) -> Result<Segment, OpenError> {
        let file = segment_path(folder, first);
        let bytes = read_all(disk, &file).map_err(open_io(&file))?;
        let header = SegmentHeader::decode(&bytes)
            .ok_or_else(|| corrupt(&file, 0, first, "the header of the segment is not valid"))?;
        let cursor = Cursor { offset: SEGMENT_HEADER_LENGTH, position: first, chain: header.chain };
        Ok(Segment { file, bytes, cursor })
    }

    /// The next group up to a position; `None` at the end of the segment.
    fn next_group(&mut self, end: u64) -> Result<Option<RecordGroup>, OpenError> {
        let start = self.cursor;
        while self.cursor.position <= end {
            let mut cursor = self.cursor;
            match next_frame(&self.bytes, &mut cursor) {
                // The first record of the next group.
                Ok(Some(frame)) if frame.header.group_index == 0 && self.cursor.offset > start.offset => break,
                Ok(Some(_)) => self.cursor = cursor,
                Ok(None) => break,
                Err(bad) => return Err(corrupt(&self.file, cursor.offset, cursor.position, bad.reason)),
            }
        }
        let point = |cursor: Cursor| LogPoint { position: cursor.position - 1, chain: cursor.chain };
        let frames = self.bytes.get(start.offset..self.cursor.offset).unwrap_or_default().to_vec();
        let group = RecordGroup { before: point(start), after: point(self.cursor), frames };
        Ok((!group.frames.is_empty()).then_some(group))
    }
}

impl Groups {
    pub(crate) fn open(disk: Arc<dyn Disk>, folder: PathBuf, from: u64, end: u64) -> Result<Groups, OpenError> {
        let lost = || corrupt(&folder, 0, from, "the log no longer holds this record");
        let mut segments = segments_from(&*disk, &folder, from)?.ok_or_else(lost)?.into_iter();
        let first = segments.next().ok_or_else(lost)?;
        let segment = Segment::open(&*disk, &folder, first)?;
        Ok(Groups { disk, folder, segments, segment, from, end, has_failed: false })
    }

    /// The chain that the record at `position`, which is in the log, has.
    pub(crate) fn chain_before(disk: &dyn Disk, folder: &Path, position: u64) -> Result<Option<u32>, OpenError> {
        let Some(segments) = segments_from(disk, folder, position)? else { return Ok(None) };
        let Some(&first) = segments.first() else { return Ok(None) };
        let mut segment = Segment::open(disk, folder, first)?;
        while segment.cursor.position < position {
            match next_frame(&segment.bytes, &mut segment.cursor) {
                Ok(Some(_)) => {}
                Ok(None) => return Ok(None),
                Err(bad) => return Err(corrupt(&segment.file, segment.cursor.offset, position, bad.reason)),
            }
        }
        Ok(Some(segment.cursor.chain))
    }

    fn next_group(&mut self) -> Result<Option<RecordGroup>, OpenError> {
        loop {
            if self.segment.cursor.position > self.end {
                return Ok(None);
            }
            match self.segment.next_group(self.end)? {
                Some(group) if group.after.position >= self.from => return Ok(Some(group)),
                Some(_) => {}
                None => {
                    let position = self.segment.cursor.position;
                    let shorter = || corrupt(&self.segment.file, 0, position, "the log has become shorter");
                    let first = self.segments.next().ok_or_else(shorter)?;
                    self.segment = Segment::open(&*self.disk, &self.folder, first)?;
                }
            }
        }
    }
}

impl Iterator for Groups {
    type Item = Result<RecordGroup, OpenError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.has_failed {
            return None;
        }
        let next = self.next_group();
        self.has_failed = next.is_err();
        next.transpose()
    }
}
