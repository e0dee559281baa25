//! The traversals of one stream.
//!
//! Invariant: as for observations. Whether the map has an edge is checked by its writer, which knows the topology.

use tidemap_map::{event::SequenceSpan, ids::RefusalReason};
use tidemap_proto::convert::{
    OverLimit,
    traversals::{BATCH_TEXT_BYTES_MAX, SentTraversal, TraversalMessage},
};

use super::{
    super::protocol::{RefusedObservation, TraversalBatch},
    Intake, IntakeError, early, shortened,
};

/// Observations per traversal: its success, and its speed.
const OBSERVATIONS_EACH: usize = 2;

impl Intake {
    /// Checks a message of traversals. `None`: nothing of it is new.
    ///
    /// # Errors
    /// Errors that end the stream; nothing of the message was taken.
    pub(crate) fn take_traversals(&mut self, message: TraversalMessage) -> Result<Option<TraversalBatch>, IntakeError> {
        let TraversalMessage { sequences, traversals } = message;
        self.check_sequences(&sequences)?;
        let (first, last) = sequences.into_inner();
        self.check_no_open_scan("traversals", "traversals")?;
        // One always fits.
        let (got, max) = (traversals.len().saturating_mul(OBSERVATIONS_EACH), self.limits.batch.max(OBSERVATIONS_EACH));
        let what = "observations of one message, traversals counted as two each";
        OverLimit::check(what, got, max, "setting max_batch_observations")?;
        let bytes = traversals.iter().map(SentTraversal::text_bytes).sum();
        let what = "bytes of the names and reasons of one message of traversals";
        OverLimit::check(what, bytes, BATCH_TEXT_BYTES_MAX, "the protocol")?;
        let skip = usize::try_from(self.next_sequence - first).unwrap_or(usize::MAX);
        for (sequence, sent) in (first..).zip(traversals.iter().take(skip)) {
            self.rows.clear();
            sent.append_content(&mut self.rows);
            self.known.repeated(sequence, |crc| crc32c::crc32c_append(crc, &self.rows))?;
        }
        if last < self.next_sequence {
            return Ok(None);
        }
        let mut batch = TraversalBatch {
            span: SequenceSpan { first: self.next_sequence, last, content_crc: 0 },
            ..TraversalBatch::default()
        };
        self.rows.clear();
        for (sequence, sent) in (self.next_sequence..).zip(&traversals[skip..]) {
            sent.append_content(&mut self.rows);
            let start_nanos = sent.start_nanos();
            match sent.check() {
                Ok(_) if start_nanos < self.earliest_nanos => {
                    let (reason, detail) = (RefusalReason::Time, shortened(&early::refusal(start_nanos)));
                    batch.refused.push(RefusedObservation { sequence, reason, detail });
                }
                Ok(traversal) => batch.traversals.push((sequence, traversal)),
                Err((reason, detail)) => {
                    batch.refused.push(RefusedObservation { sequence, reason, detail: shortened(&detail) });
                }
            }
        }
        self.content_crc = crc32c::crc32c_append(self.content_crc, &self.rows);
        self.next_sequence = last + 1;
        batch.span.content_crc = self.content_crc;
        self.known.took(last, self.content_crc);
        Ok(Some(batch))
    }
}

#[cfg(test)]
mod tests;
