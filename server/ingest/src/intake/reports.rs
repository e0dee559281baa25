//! The reports of one stream.
//!
//! Invariant: as for observations. The map's writer checks whether the map has an edge or a landmark, because it has
//! the site.

use tidemap_map::{event::SequenceSpan, ids::RefusalReason};
use tidemap_proto::convert::{
    OverLimit,
    reports::{BATCH_TEXT_BYTES_MAX, ReportMessage},
};

use super::{
    super::protocol::{RefusedObservation, ReportBatch},
    Intake, IntakeError, early, shortened,
};

impl Intake {
    /// Checks a message of reports. `None`: the message has nothing new.
    ///
    /// # Errors
    /// Errors that end the stream; nothing of the message was taken.
    pub fn take_reports(&mut self, message: ReportMessage) -> Result<Option<ReportBatch>, IntakeError> {
        self.check_sequences(&message.sequences)?;
        self.check_no_open_scan("message", "reports")?;
        message.check_count(self.limits.batch)?;
        let ReportMessage { sequences, reports } = message;
        let (first, last) = sequences.into_inner();
        let bytes = reports.iter().map(|sent| sent.text_bytes).sum();
        let what = "bytes of the names and reasons of one message of reports";
        OverLimit::check(what, bytes, BATCH_TEXT_BYTES_MAX, "the protocol")?;
        let skip = usize::try_from(self.next_sequence - first).unwrap_or(usize::MAX);
        for (sequence, sent) in (first..).zip(reports.iter().take(skip)) {
            self.known.repeated(sequence, |crc| crc32c::crc32c_append(crc, &sent.content))?;
        }
        if last < self.next_sequence {
            return Ok(None);
        }
        let mut batch = ReportBatch {
            span: SequenceSpan { first: self.next_sequence, last, content_crc: 0 },
            ..ReportBatch::default()
        };
        for (sequence, sent) in (self.next_sequence..).zip(reports.into_iter().skip(skip)) {
            self.content_crc = crc32c::crc32c_append(self.content_crc, &sent.content);
            let refused = match sent.checked {
                Ok(_) if sent.time_nanos < self.earliest_nanos => {
                    (RefusalReason::Time, early::refusal(sent.time_nanos))
                }
                Ok(report) => {
                    batch.reports.push((sequence, report));
                    continue;
                }
                Err(refused) => refused,
            };
            let (reason, detail) = (refused.0, shortened(&refused.1));
            batch.refused.push(RefusedObservation { sequence, reason, detail });
        }
        self.next_sequence = last + 1;
        batch.span.content_crc = self.content_crc;
        self.known.took(last, self.content_crc);
        Ok(Some(batch))
    }
}

#[cfg(test)]
mod tests;
