//! The traversals and sightings of one stream.
//!
//! Invariant: as for observations. Whether the map has an edge or a landmark is checked by its writer, which knows the
//! site.

use tidemap_map::{event::SequenceSpan, ids::RefusalReason};
use tidemap_proto::convert::{
    OverLimit,
    reports::{ReportMessage, SentReport},
    traversals::BATCH_TEXT_BYTES_MAX,
};

use super::{
    super::protocol::{RefusedObservation, ReportBatch},
    Intake, IntakeError, early, shortened,
};

impl Intake {
    /// Checks a message of traversals or sightings. `None`: nothing of it is new.
    ///
    /// # Errors
    /// Errors that end the stream; nothing of the message was taken.
    pub(crate) fn take_reports(&mut self, message: ReportMessage) -> Result<Option<ReportBatch>, IntakeError> {
        self.check_sequences(&message.sequences)?;
        self.check_no_open_scan("message", "traversals and sightings")?;
        message.check_count(self.limits.batch)?;
        let ReportMessage { sequences, reports } = message;
        let (first, last) = sequences.into_inner();
        let bytes = reports.iter().map(SentReport::text_bytes).sum();
        let what = "bytes of the names and reasons of one message of traversals or sightings";
        OverLimit::check(what, bytes, BATCH_TEXT_BYTES_MAX, "the protocol")?;
        let skip = usize::try_from(self.next_sequence - first).unwrap_or(usize::MAX);
        for (sequence, sent) in (first..).zip(reports.iter().take(skip)) {
            self.rows.clear();
            sent.append_content(&mut self.rows);
            self.known.repeated(sequence, |crc| crc32c::crc32c_append(crc, &self.rows))?;
        }
        if last < self.next_sequence {
            return Ok(None);
        }
        let mut batch = ReportBatch {
            span: SequenceSpan { first: self.next_sequence, last, content_crc: 0 },
            ..ReportBatch::default()
        };
        self.rows.clear();
        for (sequence, sent) in (self.next_sequence..).zip(&reports[skip..]) {
            sent.append_content(&mut self.rows);
            let time_nanos = sent.time_nanos();
            match sent.check() {
                Ok(_) if time_nanos < self.earliest_nanos => {
                    let (reason, detail) = (RefusalReason::Time, shortened(&early::refusal(time_nanos)));
                    batch.refused.push(RefusedObservation { sequence, reason, detail });
                }
                Ok(report) => batch.reports.push((sequence, report)),
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
