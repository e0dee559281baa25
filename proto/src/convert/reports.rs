//! Reports of robots: traversals, sightings and runs of tasks.
//!
//! Invariant: an invalid report is refused on its own; it uses up its sequence number.

use std::ops::RangeInclusive;

use tidemap_map::{
    ids::RefusalReason,
    report::{Report, ReportError},
    site::Site,
    task::TaskRun,
};

use super::{
    InvalidField, OverLimit,
    sequences::sequences_from_wire,
    sightings::{self, sighting_from_wire, sighting_refusal},
    task_runs::{self, task_run_from_wire},
    traversals::{self, refusal_of, traversal_from_wire, unknown_edge},
};
use crate::v1::{self, report::Report as Content};

/// Maximum number of sightings of one message: each may be an observation of thousands of landmarks.
pub const SIGHTINGS_MAX: usize = 64;
/// Maximum number of bytes of all texts of one message of reports: a record of the log has a bounded length and
/// contains a text up to three times, in the names of two states and in a failure.
pub const BATCH_TEXT_BYTES_MAX: usize = 4 << 20;
/// Maximum number of bytes of a run of a task on the wire in addition to its texts, and of the report around it.
const RUN_BYTES_EXTRA: usize = 64;
/// Maximum number of bytes of a report on the wire in addition to what it is of.
const REPORT_BYTES_EXTRA: usize = 12;

/// Reports of one message.
#[derive(Clone, Debug)]
pub struct ReportMessage {
    /// Sequence numbers of the reports.
    pub sequences: RangeInclusive<u64>,
    /// The reports; at least one.
    pub reports: Vec<SentReport>,
}

/// A report as sent, checked as far as this is possible without the map.
#[derive(Clone, Debug)]
pub struct SentReport {
    /// Time at which the report begins, nanoseconds UTC.
    pub time_nanos: i64,
    /// The report, or why it is refused: the reason for programs, and the reason in words.
    pub checked: Result<Report, (RefusalReason, String)>,
    /// Bytes of its texts.
    pub text_bytes: usize,
    /// The bytes that `Welcome.content_crc` covers.
    pub content: Vec<u8>,
    /// Whether it is of a sighting.
    is_sighting: bool,
}

impl SentReport {
    fn from_wire(sent: &v1::Report) -> Self {
        let mut content = Vec::new();
        append_content(sent, &mut content);
        let (time_nanos, checked) = match &sent.report {
            Some(Content::Traversal(sent)) => (sent.start_nanos, traversal_from_wire(sent).map(Report::Traversal)),
            Some(Content::Sighting(sent)) => (sent.time_nanos, sighting_from_wire(sent).map(Report::Sighting)),
            Some(Content::TaskRun(sent)) => (sent.start_nanos, task_run_from_wire(sent).map(Report::TaskRun)),
            None => {
                let text = "the report is empty: expected a traversal, a sighting or a run of a task";
                (0, Err((RefusalReason::Value, text.to_owned())))
            }
        };
        Self { time_nanos, checked, text_bytes: text_bytes(sent), content, is_sighting: is_sighting(sent) }
    }

    /// A run of a task that was not sent as one of a stream.
    #[must_use]
    pub fn of_run(run: TaskRun) -> Self {
        let mut content = Vec::new();
        task_runs::append_run(&run, &mut content);
        let text_bytes = run.name.to_string().len() + run.reason.len();
        let time_nanos = run.start_nanos;
        Self { time_nanos, checked: Ok(Report::TaskRun(run)), text_bytes, content, is_sighting: false }
    }

    /// Bytes of its observations in the log, at most; see [`Report::log_bytes`].
    fn log_bytes(&self, site: &Site) -> usize {
        self.checked.as_ref().map_or(0, |report| report.log_bytes(site))
    }
}

/// Reports of one message.
///
/// # Errors
/// There are none, or a first sequence number of 0.
pub fn reports_from_wire(batch: &v1::ReportBatch) -> Result<ReportMessage, InvalidField> {
    ReportMessage::new(batch.first_sequence, batch.reports.iter().map(SentReport::from_wire).collect())
}

impl ReportMessage {
    /// Reports with these sequence numbers.
    ///
    /// # Errors
    /// There are none, or a first sequence number of 0.
    pub fn new(first_sequence: u64, reports: Vec<SentReport>) -> Result<Self, InvalidField> {
        let sequences = sequences_from_wire(first_sequence, reports.len())?;
        if reports.is_empty() {
            return Err(InvalidField::new("reports.reports", "missing: send at least 1"));
        }
        Ok(Self { sequences, reports })
    }

    /// Checks how many reports there are. `observations`: the limit of the observations of a message, of which a
    /// traversal is two, and a run of a task as well.
    ///
    /// # Errors
    /// [`OverLimit`]
    pub fn check_count(&self, observations: usize) -> Result<(), OverLimit> {
        let sightings = self.reports.iter().filter(|report| report.is_sighting).count();
        let others = self.reports.len() - sightings;
        let what = "observations of one message, traversals and runs of tasks counted as two each";
        // One report always fits.
        let (got, max) = (others.saturating_mul(2), observations.max(2));
        OverLimit::check(what, got, max, "setting max_batch_observations")?;
        OverLimit::check("sightings of one message", sightings, SIGHTINGS_MAX, "the protocol")
    }

    /// The message in parts whose observations have at most `log_bytes` in the log of a map with this site; a part has
    /// at least one report.
    #[must_use]
    pub fn parts(self, log_bytes: usize, site: &Site) -> Vec<ReportMessage> {
        let mut parts: Vec<ReportMessage> = Vec::new();
        let (mut bytes, mut sequence) = (0_usize, *self.sequences.start());
        for report in self.reports {
            let more = report.log_bytes(site);
            match parts.last_mut() {
                Some(part) if bytes.saturating_add(more) <= log_bytes => {
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

/// Whether a report is of a sighting.
#[must_use]
pub fn is_sighting(sent: &v1::Report) -> bool {
    matches!(sent.report, Some(Content::Sighting(_)))
}

/// Bytes of a report's texts.
fn text_bytes(sent: &v1::Report) -> usize {
    match &sent.report {
        Some(Content::Traversal(sent)) => traversals::text_bytes(sent),
        Some(Content::Sighting(sent)) => sightings::text_bytes(sent),
        Some(Content::TaskRun(sent)) => task_runs::text_bytes(sent),
        None => 0,
    }
}

/// Maximum number of bytes of a report in a message.
#[must_use]
pub fn wire_bytes(sent: &v1::Report) -> usize {
    REPORT_BYTES_EXTRA
        + match &sent.report {
            Some(Content::Traversal(sent)) => traversals::wire_bytes(sent),
            Some(Content::Sighting(sent)) => sightings::wire_bytes(sent),
            Some(Content::TaskRun(sent)) => RUN_BYTES_EXTRA + task_runs::text_bytes(sent),
            None => 0,
        }
}

/// Appends the bytes of a report that `Welcome.content_crc` covers.
pub fn append_content(sent: &v1::Report, bytes: &mut Vec<u8>) {
    match &sent.report {
        Some(Content::Traversal(sent)) => traversals::append_content(sent, bytes),
        Some(Content::Sighting(sent)) => sightings::append_content(sent, bytes),
        Some(Content::TaskRun(sent)) => task_runs::append_content(sent, bytes),
        None => {}
    }
}

/// The refusal of a report.
#[must_use]
pub fn report_refusal(error: &ReportError) -> (RefusalReason, String) {
    match error {
        ReportError::Edge(error) => unknown_edge(error),
        ReportError::Traversal(error) => refusal_of(error),
        ReportError::Sighting(error) => sighting_refusal(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(content: Content) -> v1::Report {
        v1::Report { report: Some(content) }
    }

    fn traversal(start_nanos: i64) -> v1::Report {
        report(Content::Traversal(v1::Traversal {
            from: "hall".to_owned(),
            to: "lab".to_owned(),
            start_nanos,
            end_nanos: start_nanos + 1,
            success: true,
            ..v1::Traversal::default()
        }))
    }

    fn run() -> v1::TaskRun {
        let (kind, node) = ("clean".to_owned(), "hall".to_owned());
        v1::TaskRun { kind, node, start_nanos: 5, end_nanos: 9, ..v1::TaskRun::default() }
    }

    #[test]
    fn a_message_may_have_reports_of_each_kind() {
        let sighting = report(Content::Sighting(v1::Sighting { time_nanos: 7, ..v1::Sighting::default() }));
        let reports = vec![traversal(3), sighting, report(Content::TaskRun(run())), v1::Report::default()];
        let message = reports_from_wire(&v1::ReportBatch { first_sequence: 4, reports }).expect("a message");
        assert_eq!(message.sequences, 4..=7);
        let [traversal, sighting, task_run, empty] = message.reports.as_slice() else { panic!("{message:?}") };
        assert!(matches!(traversal.checked, Ok(Report::Traversal(_))));
        assert!(matches!(task_run.checked, Ok(Report::TaskRun(_))));
        assert_eq!(sighting.checked.as_ref().expect_err("it has no place").0, RefusalReason::Landmark);
        assert_eq!(empty.checked.as_ref().expect_err("it is empty").0, RefusalReason::Value);
        assert_eq!([traversal, sighting, task_run].map(|report| report.time_nanos), [3, 7, 5]);
        message.check_count(6).expect("each but the sighting counts twice");
        message.check_count(5).expect_err("three reports are six observations");
    }

    #[test]
    fn a_run_of_a_request_is_that_of_a_stream() {
        let of_stream = SentReport::from_wire(&report(Content::TaskRun(run())));
        let of_request = SentReport::of_run(task_run_from_wire(&run()).expect("valid"));
        assert_eq!(of_request.content, of_stream.content);
        assert_eq!((of_request.time_nanos, of_request.checked), (of_stream.time_nanos, of_stream.checked));
    }

    #[test]
    fn parts_are_the_message_in_order_and_only_a_single_report_is_too_large() {
        let reports = vec![traversal(1), traversal(2), traversal(3)];
        let message = reports_from_wire(&v1::ReportBatch { first_sequence: 7, reports }).expect("valid");
        let site = Site::default();
        let one = message.reports[0].log_bytes(&site);
        assert!(one > 0);
        let parts = |log_bytes| {
            let parts = message.clone().parts(log_bytes, &site).into_iter();
            parts
                .map(|part| (part.sequences, part.reports.iter().map(|sent| sent.time_nanos).collect::<Vec<_>>()))
                .collect::<Vec<_>>()
        };
        assert_eq!(parts(2 * one), [(7..=8, vec![1, 2]), (9..=9, vec![3])]);
        assert_eq!(parts(1), [(7..=7, vec![1]), (8..=8, vec![2]), (9..=9, vec![3])]);
    }
}
