//! Reports of robots about places of the topological map, as a stream sends them: traversals and sightings.
//!
//! Invariant: an invalid report is refused on its own; it uses up its sequence number.

use std::ops::RangeInclusive;

use tidemap_map::{ids::RefusalReason, sighting::PlaceReport};

use super::{
    InvalidField, OverLimit,
    sequences::sequences_from_wire,
    sightings::{self, SIGHTINGS_MAX, sighting_from_wire},
    traversals::{self, work_from_wire},
};
use crate::v1;

/// Reports of one message.
#[derive(Clone, Debug)]
pub struct ReportMessage {
    /// Sequence numbers of the reports.
    pub sequences: RangeInclusive<u64>,
    /// The reports as sent; at least one.
    pub reports: Vec<SentReport>,
}

/// Traversals of one message.
///
/// # Errors
/// There are none, or a first sequence number of 0.
pub fn traversals_from_wire(batch: v1::TraversalBatch) -> Result<ReportMessage, InvalidField> {
    let reports = batch.traversals.into_iter().map(SentReport::Traversal).collect();
    message("traversals.traversals", batch.first_sequence, reports)
}

/// Sightings of one message.
///
/// # Errors
/// There are none, or a first sequence number of 0.
pub fn sightings_from_wire(batch: v1::SightingBatch) -> Result<ReportMessage, InvalidField> {
    let reports = batch.sightings.into_iter().map(SentReport::Sighting).collect();
    message("sightings.sightings", batch.first_sequence, reports)
}

fn message(field: &str, first_sequence: u64, reports: Vec<SentReport>) -> Result<ReportMessage, InvalidField> {
    let sequences = sequences_from_wire(first_sequence, reports.len())?;
    if reports.is_empty() {
        return Err(InvalidField::new(field, "missing: send at least 1"));
    }
    Ok(ReportMessage { sequences, reports })
}

impl ReportMessage {
    /// Checks how many reports there are. `observations`: the limit of the observations of a message, of which a
    /// traversal is two.
    ///
    /// # Errors
    /// [`OverLimit`]
    pub fn check_count(&self, observations: usize) -> Result<(), OverLimit> {
        let count = |sightings: bool| self.reports.iter().filter(|report| report.is_sighting() == sightings).count();
        let what = "observations of one message, traversals counted as two each";
        // One always fits.
        let (got, max) = (count(false).saturating_mul(2), observations.max(2));
        OverLimit::check(what, got, max, "setting max_batch_observations")?;
        OverLimit::check("sightings of one message", count(true), SIGHTINGS_MAX, "the protocol")
    }
}

impl ReportMessage {
    /// The message in parts of at most `bytes_max`, as `bytes_of` counts them; a part has at least one report.
    #[must_use]
    pub fn parts(self, bytes_max: usize, bytes_of: impl Fn(&SentReport) -> usize) -> Vec<ReportMessage> {
        let mut parts: Vec<ReportMessage> = Vec::new();
        let (mut bytes, mut sequence) = (0_usize, *self.sequences.start());
        for report in self.reports {
            let more = bytes_of(&report);
            match parts.last_mut() {
                Some(part) if bytes.saturating_add(more) <= bytes_max => {
                    bytes += more;
                    part.sequences = *part.sequences.start()..=sequence;
                    part.reports.push(report);
                }
                _ => {
                    bytes = more;
                    parts.push(ReportMessage { sequences: sequence..=sequence, reports: vec![report] });
                }
            }
            sequence = sequence.saturating_add(1);
        }
        parts
    }
}

/// A report as sent, not checked.
#[derive(Clone, Debug)]
pub enum SentReport {
    /// A robot travelled an edge or did a task, or tried to.
    Traversal(v1::Traversal),
    /// A robot looked for the landmarks of a place.
    Sighting(v1::Sighting),
}

impl SentReport {
    fn is_sighting(&self) -> bool {
        matches!(self, Self::Sighting(_))
    }

    /// When it begins, nanoseconds UTC.
    #[must_use]
    pub fn time_nanos(&self) -> i64 {
        match self {
            Self::Traversal(traversal) => traversal.start_nanos,
            Self::Sighting(sighting) => sighting.time_nanos,
        }
    }

    /// Bytes of its texts.
    #[must_use]
    pub fn text_bytes(&self) -> usize {
        match self {
            Self::Traversal(traversal) => traversals::text_bytes(traversal),
            Self::Sighting(sighting) => sightings::text_bytes(sighting),
        }
    }

    /// Appends the bytes that `Welcome.content_crc` covers.
    pub fn append_content(&self, bytes: &mut Vec<u8>) {
        match self {
            Self::Traversal(traversal) => traversals::append_content(traversal, bytes),
            Self::Sighting(sighting) => sightings::append_content(sighting, bytes),
        }
    }

    /// The checked report. Whether the place exists is not checked.
    ///
    /// # Errors
    /// The reason for programs, and the reason in words.
    pub fn check(&self) -> Result<PlaceReport, (RefusalReason, String)> {
        match self {
            Self::Traversal(traversal) => work_from_wire(traversal),
            Self::Sighting(sighting) => sighting_from_wire(sighting).map(PlaceReport::Sighting),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_the_message_in_order_and_none_is_too_large_but_for_one_report() {
        let sighting = |number: i64| v1::Sighting { time_nanos: number, ..v1::Sighting::default() };
        let batch = v1::SightingBatch { first_sequence: 7, sightings: (1..=5).map(sighting).collect() };
        let message = sightings_from_wire(batch).expect("valid");
        // Of 3, 3, 9, 1 and 1 bytes.
        let bytes = |report: &SentReport| [3, 3, 9, 1, 1][report.time_nanos() as usize - 1];
        let parts: Vec<_> = message
            .parts(6, bytes)
            .into_iter()
            .map(|part| (part.sequences, part.reports.iter().map(SentReport::time_nanos).collect::<Vec<_>>()))
            .collect();
        assert_eq!(parts, [(7..=8, vec![1, 2]), (9..=9, vec![3]), (10..=11, vec![4, 5])]);
    }
}
