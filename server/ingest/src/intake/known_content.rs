//! The content that a stream's key has sent before, to compare it with repeated observations.
//!
//! Invariant: observations that are repeated in order, from a sequence number with a known running CRC, are compared at
//! every later number with a known CRC. All other repeated observations are skipped without a comparison.

use std::collections::VecDeque;

use tidemap_map::snapshot::{CONTENT_MARKS_MAX, ContentMark};

use super::IntakeError;

#[derive(Debug, Default)]
pub(super) struct KnownContent {
    /// The known CRCs, ascending by sequence number. The CRC before the first observation, 0, is always known.
    marks: VecDeque<ContentMark>,
    /// The last repeated observations: the number at which the comparison began, and the CRC so far.
    repeated: Option<(u64, ContentMark)>,
}

impl KnownContent {
    pub(super) fn new(marks: Vec<ContentMark>) -> Self {
        Self { marks: marks.into(), repeated: None }
    }

    /// Records that new observations were taken.
    pub(super) fn took(&mut self, sequence: u64, crc: u32) {
        if self.marks.back().is_some_and(|newest| newest.sequence >= sequence) {
            return;
        }
        if self.marks.len() >= CONTENT_MARKS_MAX {
            self.marks.pop_front();
        }
        self.marks.push_back(ContentMark { sequence, crc });
    }

    fn at(&self, sequence: u64) -> Option<ContentMark> {
        let place = self.marks.binary_search_by_key(&sequence, |mark| mark.sequence);
        place.ok().map(|place| self.marks[place]).or((sequence == 0).then(ContentMark::default))
    }

    /// Compares a repeated observation. `append` returns the CRC after the observation, from the CRC before it.
    ///
    /// # Errors
    /// [`IntakeError::DataMismatch`].
    pub(super) fn repeated(&mut self, sequence: u64, append: impl FnOnce(u32) -> u32) -> Result<(), IntakeError> {
        let before = sequence.saturating_sub(1);
        let running = self.repeated.filter(|(_, mark)| mark.sequence == before);
        let Some((start, mark)) = running.or_else(|| self.at(before).map(|mark| (sequence, mark))) else {
            return Ok(());
        };
        let crc = append(mark.crc);
        let known = self.at(sequence);
        if known.is_some_and(|known| known.crc != crc) {
            let next = self.marks.back().map_or(sequence, |newest| newest.sequence) + 1;
            return Err(IntakeError::DataMismatch { first: start, last: sequence, next });
        }
        // Content that was compared and is equal counts as known from here on.
        let start = if known.is_some() { sequence + 1 } else { start };
        self.repeated = Some((start, ContentMark { sequence, crc }));
        Ok(())
    }
}
