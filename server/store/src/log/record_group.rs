//! Records that were written together, and points between records.
//!
//! Invariant: what [`RecordGroup::events`] gives was checked: headers, bodies, positions and chain.

use tidemap_layout::log::FIRST_CHAIN;
use tidemap_map::event::Event;

use crate::log::frame::{Cursor, next_frame};

/// A point in a log: behind the record of a position, with the chain that the next record must have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LogPoint {
    /// Position of the last record before the point; 0 at the beginning.
    pub position: u64,
    /// The chain there.
    pub chain: u32,
}

impl LogPoint {
    /// The beginning of every log.
    pub const BEGINNING: LogPoint = LogPoint { position: 0, chain: FIRST_CHAIN };
}

/// Records that were written together, as they stand in a segment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordGroup {
    /// The point at which the records begin.
    pub before: LogPoint,
    /// The point at which the records end.
    pub after: LogPoint,
    /// The records as frames.
    pub frames: Vec<u8>,
}

impl RecordGroup {
    /// Number of the records.
    #[must_use]
    pub fn records(&self) -> u64 {
        self.after.position - self.before.position
    }

    /// The events of the frames, all of which are checked.
    ///
    /// # Errors
    /// The fault of a frame.
    pub fn events(&self) -> Result<Vec<(u64, Event)>, &'static str> {
        let mut events = Vec::new();
        let mut cursor = Cursor { offset: 0, position: self.before.position + 1, chain: self.before.chain };
        while let Some(frame) = next_frame(&self.frames, &mut cursor).map_err(|bad| bad.reason)? {
            if u64::from(frame.header.group_index) != events.len() as u64 {
                return Err("the record has another place in its group than it should");
            }
            events.push((frame.header.position, frame.event()?));
        }
        if (cursor.position, cursor.chain) != (self.after.position + 1, self.after.chain) || events.is_empty() {
            return Err("the group does not end at its stated position");
        }
        Ok(events)
    }
}
