//! Tests traversals as a stream sends them: the ones taken, skipped and refused, and the errors that end the stream.

use tidemap_map::{ids::RefusalReason, report::Report};
use tidemap_proto::{
    convert::{columns::encode, scans::ScanLimits},
    v1::{self, Traversal},
};

use super::*;
use crate::intake::IntakeLimits;
use crate::intake::tests::TakeSent as _;

fn intake(durable: u64) -> Intake {
    let scans = ScanLimits { batch_scans: 8, points: 1000, tiles: 4 };
    Intake::new(durable, 0, IntakeLimits { batch: 9, table: 3, scans }, None)
}

fn trip(from: &str, start_nanos: i64, end_nanos: i64, success: bool) -> Traversal {
    let (from, to, reason) = (from.to_owned(), "Lab".to_owned(), "stuck".to_owned());
    Traversal { from, to, start_nanos, end_nanos, success, reason, ..Traversal::default() }
}

fn message(first_sequence: u64, traversals: &[Traversal]) -> v1::ReportBatch {
    let report = |traversal: &Traversal| v1::Report { report: Some(v1::report::Report::Traversal(traversal.clone())) };
    v1::ReportBatch { first_sequence, reports: traversals.iter().map(report).collect() }
}

#[test]
fn they_share_the_numbers_and_the_crc_of_observations() {
    let mut intake = intake(0);
    let trips = [trip("Hall", 1, 5, true), trip("Hall", 5, 9, false)];
    let batch = intake.take_sent_reports(message(1, &trips)).expect("fine").expect("new");
    assert_eq!((batch.span.first, batch.span.last), (1, 2));
    assert_eq!(batch.reports.iter().map(|(sequence, _)| *sequence).collect::<Vec<_>>(), [1, 2]);
    let bytes = |trip: &Traversal| {
        let tail = [&trip.start_nanos.to_le_bytes()[..], &trip.end_nanos.to_le_bytes(), &[u8::from(trip.success)]];
        [b"edge/Hall/Lab", &tail.concat()[..], b"stuck"].concat()
    };
    assert_eq!(batch.span.content_crc, crc32c::crc32c_append(0, &trips.each_ref().map(bytes).concat()));
    assert!(intake.take_sent_reports(message(1, &trips)).expect("fine").is_none());
    let observations = Some(encode(&[3], &[0], &[1.0], vec!["door".to_owned()]));
    intake.take_sent(v1::ObservationBatch { first_sequence: 3, observations }).expect("fine").expect("new");
    // The second traversal was taken before; the number between belongs to the observation.
    let more = [trips[1].clone(), trip("Hall", 0, 0, false), trip("Hall", 9, 12, true)];
    let other = intake.take_sent_reports(message(2, &more)).expect_err("other content");
    assert_eq!(other, IntakeError::DataMismatch { first: 3, last: 3, next: 4 });
    let batch = intake.take_sent_reports(message(4, &more[2..])).expect("fine").expect("new");
    assert_eq!((batch.span.first, batch.span.last, batch.reports.len()), (4, 4, 1));
    assert_eq!(batch.reports[0].1.time_nanos(), 9);
    let leap = intake.take_sent_reports(message(6, &trips)).expect_err("a gap");
    assert_eq!(leap, IntakeError::OutOfSequence { got: 6, expected: 5 });
}

#[test]
fn a_wrong_traversal_does_not_take_its_neighbours_with_it() {
    let mut intake = intake(10);
    let long = Traversal { reason: "x\n".repeat(500), ..trip("Hall", 1, 2, false) };
    let sent = [trip("a/b", 1, 5, true), long, trip("Hall", 5, 4, false), trip("Hall", 5, 5, true)];
    let batch = intake.take_sent_reports(message(11, &sent)).expect("fine").expect("new");
    let reasons: Vec<_> = batch.refused.iter().map(|refused| (refused.sequence, refused.reason)).collect();
    assert_eq!(reasons, [(11, RefusalReason::Edge), (13, RefusalReason::Time), (14, RefusalReason::Time)]);
    assert!(batch.refused.iter().all(|refused| refused.detail.chars().count() <= 200));
    let [(12, Report::Traversal(taken))] = batch.reports.as_slice() else { panic!("{:?}", batch.reports) };
    assert!(taken.reason.starts_with("x x ") && taken.reason.chars().count() <= 200);
    assert_eq!(batch.span.last, 14);
}

#[test]
fn what_is_no_message_of_traversals_ends_the_stream() {
    assert!(matches!(intake(0).take_sent_reports(message(1, &[])), Err(IntakeError::Invalid(_))));
    assert!(intake(0).take_sent_reports(message(0, &[trip("Hall", 1, 2, true)])).is_err());
    assert!(intake(0).take_sent_reports(message(u64::MAX, &[trip("Hall", 1, 2, true)])).is_err());
    let many = vec![trip("Hall", 1, 2, true); 5];
    let error = intake(0).take_sent_reports(message(1, &many)).expect_err("too many").to_string();
    assert!(error.contains("10 is more than the 9"), "{error}");
    assert!(intake(0).take_sent_reports(message(1, &many[..4])).is_ok());
    let wordy = Traversal { reason: "x".repeat(BATCH_TEXT_BYTES_MAX), ..trip("Hall", 1, 2, false) };
    let error = intake(0).take_sent_reports(message(1, &[wordy])).expect_err("too long").to_string();
    assert!(error.contains("names and reasons"), "{error}");
}
