//! Replaying the events of a log, with one segment in memory at a time.
//!
//! Invariant: events come in the order of their positions without a gap, or an error ends the replay.

use std::{path::PathBuf, sync::Arc, vec::IntoIter};

use tidemap_layout::log::{SEGMENT_HEADER_LENGTH, SegmentHeader};
use tidemap_map::event::Event;

use crate::{
    disk::{Disk, read_all},
    error::{OpenError, open_io},
    log::{
        frame::{Cursor, next_frame},
        segment_path,
    },
};

/// The events of a map from one position up to the end of its log as it was when it was opened.
pub struct Replay {
    disk: Arc<dyn Disk>,
    folder: PathBuf,
    /// First positions of the segments still to read.
    segments: IntoIter<u64>,
    file: PathBuf,
    bytes: Vec<u8>,
    cursor: Cursor,
    /// Position of the first event to return.
    from: u64,
    /// Position of the last event to return.
    end: u64,
    has_failed: bool,
}

impl Replay {
    pub(crate) fn new(disk: Arc<dyn Disk>, folder: PathBuf, segments: Vec<u64>, from: u64, end: u64) -> Replay {
        Replay {
            disk,
            folder,
            segments: segments.into_iter(),
            file: PathBuf::new(),
            bytes: Vec::new(),
            cursor: Cursor { offset: 0, position: 0, chain: 0 },
            from: from.max(1),
            end,
            has_failed: false,
        }
    }

    /// Number of events from the first to the last.
    pub fn records(&self) -> u64 {
        (self.end + 1).saturating_sub(self.from)
    }

    fn corrupt(&self, reason: &str) -> OpenError {
        OpenError::CorruptLog {
            file: self.file.clone(),
            offset: self.cursor.offset as u64,
            position: self.cursor.position,
            reason: reason.to_owned(),
        }
    }

    /// Reads the next segment; `false` where there is none.
    fn next_segment(&mut self) -> Result<bool, OpenError> {
        let Some(first) = self.segments.next() else { return Ok(false) };
        self.file = segment_path(&self.folder, first);
        self.bytes = Vec::new();
        self.bytes = read_all(&*self.disk, &self.file).map_err(open_io(&self.file))?;
        let header =
            SegmentHeader::decode(&self.bytes).ok_or_else(|| self.corrupt("the header of the segment is not valid"))?;
        self.cursor = Cursor { offset: SEGMENT_HEADER_LENGTH, position: first, chain: header.chain };
        Ok(true)
    }

    fn next_event(&mut self) -> Result<Option<(u64, Event)>, OpenError> {
        // Records after the end may be being written.
        while self.cursor.position <= self.end {
            let mut cursor = self.cursor;
            match next_frame(&self.bytes, &mut cursor) {
                Ok(Some(frame)) if frame.header.position < self.from => self.cursor = cursor,
                Ok(Some(frame)) => {
                    let event = frame.event().map_err(|reason| self.corrupt(reason))?;
                    let position = frame.header.position;
                    self.cursor = cursor;
                    return Ok(Some((position, event)));
                }
                Ok(None) => {
                    if !self.next_segment()? {
                        return Err(self.corrupt("the log has become shorter"));
                    }
                }
                Err(bad) => return Err(self.corrupt(bad.reason)),
            }
        }
        Ok(None)
    }
}

impl Iterator for Replay {
    type Item = Result<(u64, Event), OpenError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.has_failed {
            return None;
        }
        let next = self.next_event();
        self.has_failed = next.is_err();
        next.transpose()
    }
}
