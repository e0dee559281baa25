//! Tests observations and scans as a stream sends them: the ones taken, skipped and refused, and the errors that end
//! the stream.

use tidemap_proto::{
    convert::{columns::encode, observe::observations_from_wire, reports::reports_from_wire, scans::scans_from_wire},
    v1::{self, PointCloud, Scan, scan::Content},
};

use super::*;
use crate::protocol::ReportBatch;

/// Takes messages in the form of the wire.
pub(crate) trait TakeSent {
    fn take_sent(&mut self, batch: v1::ObservationBatch) -> Result<Option<ObservationBatch>, IntakeError>;
    fn begin_sent_scans(&mut self, batch: v1::ScanBatch) -> Result<bool, IntakeError>;
    fn take_sent_reports(&mut self, batch: v1::ReportBatch) -> Result<Option<ReportBatch>, IntakeError>;
}

impl TakeSent for Intake {
    fn take_sent(&mut self, batch: v1::ObservationBatch) -> Result<Option<ObservationBatch>, IntakeError> {
        self.take(observations_from_wire(batch)?)
    }

    fn begin_sent_scans(&mut self, batch: v1::ScanBatch) -> Result<bool, IntakeError> {
        self.begin_scans(scans_from_wire(batch)?)
    }

    fn take_sent_reports(&mut self, batch: v1::ReportBatch) -> Result<Option<ReportBatch>, IntakeError> {
        self.take_reports(reports_from_wire(&batch)?)
    }
}

fn message(first: u64, names: &[&str], indices: &[u32], times: &[i64], values: &[f64]) -> v1::ObservationBatch {
    let names = names.iter().map(|name| (*name).to_owned()).collect();
    v1::ObservationBatch { first_sequence: first, observations: Some(encode(times, indices, values, names)) }
}

fn set_kinds(message: &mut v1::ObservationBatch, kinds: &[v1::StateKind]) {
    let columns = message.observations.as_mut().expect("there are some");
    columns.new_kinds = kinds.iter().map(|&kind| kind.into()).collect();
}

fn limits(batch: usize, table: usize) -> IntakeLimits {
    IntakeLimits { batch, table, scans: ScanLimits { batch_scans: 8, points: 1000, tiles: 4 } }
}

fn intake() -> Intake {
    Intake::new(0, 0, limits(4, 3), None)
}

#[test]
fn numbers_go_up_by_one_and_known_ones_are_skipped() {
    let mut intake = intake();
    let batch = intake.take_sent(message(1, &["a"], &[0, 0], &[1, 2], &[0.0, 1.0])).expect("fine").expect("new");
    assert_eq!((batch.span.first, batch.span.last), (1, 2));
    assert!(intake.take_sent(message(1, &[], &[0, 0], &[1, 2], &[0.0, 1.0])).expect("fine").is_none());
    let batch = intake.take_sent(message(2, &[], &[0, 0], &[2, 3], &[1.0, 0.5])).expect("fine").expect("new");
    assert_eq!((batch.span.first, batch.span.last, batch.times_nanos.as_slice()), (3, 3, [3].as_slice()));
    let leap = intake.take_sent(message(5, &[], &[0], &[1], &[0.0]));
    assert_eq!(leap.expect_err("a gap"), IntakeError::OutOfSequence { got: 5, expected: 4 });
    assert!(intake.take_sent(message(0, &[], &[0], &[1], &[0.0])).is_err());
}

/// Observations of one state at times 1, 2, … with the given values, from a sequence number.
fn values(first: u64, values: &[f64]) -> v1::ObservationBatch {
    let times: Vec<i64> = (first as i64..).take(values.len()).collect();
    message(first, &["a"], &vec![0; values.len()], &times, values)
}

#[test]
fn known_numbers_with_other_content_end_the_stream() {
    let mut first = intake();
    let before = first.take_sent(values(1, &[0.0, 1.0])).expect("fine").expect("new");
    let after = first.take_sent(values(3, &[0.25, 0.5])).expect("fine").expect("new");
    let marks = || {
        let mark = |batch: &ObservationBatch| ContentMark { sequence: batch.span.last, crc: batch.span.content_crc };
        vec![mark(&before), mark(&after)]
    };
    let again = || Intake::new(4, after.span.content_crc, limits(9, 9), None).with_known_content(marks());
    // Equal content is accepted in any division into parts, and with new observations behind it.
    for parts in [&[4][..], &[2, 2], &[1, 3], &[1, 1, 1, 1]] {
        let (mut stream, mut next) = (again(), 1);
        for &part in parts {
            let sent = &[0.0, 1.0, 0.25, 0.5][next - 1..][..part];
            assert!(stream.take_sent(values(next as u64, sent)).is_ok(), "{parts:?}");
            next += part;
        }
    }
    let more = again().take_sent(values(3, &[0.25, 0.5, 1.0])).expect("fine").expect("new");
    assert_eq!((more.span.first, more.span.last), (5, 5));
    // A different value, time or name is found at the next known CRC.
    let differs = |first, last| IntakeError::DataMismatch { first, last, next: 5 };
    assert_eq!(again().take_sent(values(1, &[0.0, 0.5, 0.25, 0.5])).expect_err("other"), differs(1, 2));
    assert_eq!(again().take_sent(values(3, &[0.25, 1.0, 0.0])).expect_err("other"), differs(3, 4));
    assert_eq!(again().take_sent(values(1, &[0.0, 1.0, 0.5, 0.5])).expect_err("other"), differs(3, 4));
    let name = message(3, &["b"], &[0, 0], &[3, 4], &[0.25, 0.5]);
    assert_eq!(again().take_sent(name).expect_err("other"), differs(3, 4));
    let mut parts = again();
    parts.take_sent(values(3, &[0.5])).expect("not known yet");
    assert_eq!(parts.take_sent(values(4, &[0.5])).expect_err("other"), differs(3, 4));
    // This also holds within the same stream.
    assert_eq!(first.take_sent(values(3, &[0.0, 0.5])).expect_err("other"), differs(3, 4));
    // A repetition that begins where no CRC is known is skipped as before.
    assert!(again().take_sent(values(2, &[0.5])).is_ok());
}

#[test]
fn the_crc_depends_on_content_alone() {
    let mut whole = intake();
    let whole = whole.take_sent(message(1, &["a", "b"], &[0, 1, 0], &[1, 2, 3], &[0.0, 1.0, 0.5]));
    let mut parts = intake();
    parts.take_sent(message(1, &["b", "a"], &[1, 0], &[1, 2], &[0.0, 1.0])).expect("fine");
    let parts = parts.take_sent(message(2, &[], &[0, 1], &[2, 3], &[1.0, 0.5]));
    assert_eq!(
        whole.expect("fine").expect("new").span.content_crc,
        parts.expect("fine").expect("new").span.content_crc
    );
    let by_hand = [("a", 1i64, 0f64), ("b", 2, 1.0), ("a", 3, 0.5)].iter().fold(0, |crc, (name, time, value)| {
        let crc = crc32c::crc32c_append(crc, name.as_bytes());
        crc32c::crc32c_append(crc32c::crc32c_append(crc, &time.to_le_bytes()), &value.to_le_bytes())
    });
    let mut again = intake();
    let again = again.take_sent(message(1, &["a", "b"], &[0, 1, 0], &[1, 2, 3], &[0.0, 1.0, 0.5]));
    assert_eq!(again.expect("fine").expect("new").span.content_crc, by_hand);
}

#[test]
fn a_wrong_observation_does_not_take_its_neighbours_with_it() {
    let mut intake = Intake::new(10, 7, limits(9, 9), None);
    let values = [0.5, f64::NAN, 1.0, -0.1, 0.0, 1.5, f64::INFINITY];
    let mut sent = message(11, &["a", "b/c"], &[0, 0, 1, 0, 9, 0, 0], &[1, 2, 3, 4, 5, 6, 7], &values);
    set_kinds(&mut sent, &[v1::StateKind::Probability; 2]);
    let batch = intake.take_sent(sent).expect("fine").expect("new");
    assert_eq!(batch.span.last, 17);
    // A NaN may be a row without a value; this depends on the state.
    assert_eq!(batch.kept, [0, 1]);
    assert_eq!((batch.values[0], batch.values[1].is_nan(), batch.values.len()), (0.5, true, 2));
    let reasons: Vec<_> = batch.refused.iter().map(|refused| (refused.sequence, refused.reason)).collect();
    assert_eq!(
        reasons,
        [
            (13, RefusalReason::StateName),
            (14, RefusalReason::Value),
            (15, RefusalReason::StateIndex),
            (16, RefusalReason::Value),
            (17, RefusalReason::Value),
        ]
    );
    assert_eq!(batch.new_names.len(), 2);
}

#[test]
fn the_declared_kind_of_a_state_limits_its_values() {
    let values = [2.5, -3.0, 1e300, 7.0];
    for (kind, kept) in [
        (v1::StateKind::Unspecified, vec![2.5, -3.0, 7.0]),
        (v1::StateKind::Probability, vec![]),
        (v1::StateKind::Continuous, vec![2.5, -3.0, 7.0]),
        (v1::StateKind::Count, vec![7.0]),
    ] {
        let mut sent = message(1, &["a"], &[0; 4], &[1, 2, 3, 4], &values);
        set_kinds(&mut sent, &[kind]);
        let batch = intake().take_sent(sent).expect("fine").expect("new");
        assert_eq!(batch.values, kept, "{kind:?}");
        assert!(batch.refused.iter().all(|refused| refused.reason == RefusalReason::Value), "{batch:?}");
        let shape = batch.new_names[0].as_ref().expect("a valid name").shape;
        assert_eq!(shape.is_none(), kind == v1::StateKind::Unspecified);
    }
    let mut sent = message(1, &["a"], &[0], &[1], &[2.5]);
    set_kinds(&mut sent, &[v1::StateKind::Count]);
    let batch = intake().take_sent(sent).expect("fine").expect("new");
    assert!(batch.refused[0].detail.contains("2.5 is not a count"), "{}", batch.refused[0].detail);
}

#[test]
fn kinds_that_do_not_go_with_the_names_end_the_stream() {
    for kinds in [vec![1, 1], vec![99]] {
        let mut sent = message(1, &["a"], &[0], &[1], &[0.0]);
        sent.observations.as_mut().expect("some").new_kinds = kinds;
        let error = intake().take_sent(sent).expect_err("malformed");
        assert!(
            matches!(&error, IntakeError::Invalid(invalid) if invalid.field == "observations.new_kinds"),
            "{error}"
        );
    }
}

#[test]
fn times_before_1970_are_refused() {
    let mut intake = intake();
    let batch = intake.take_sent(message(1, &["a"], &[0, 0], &[-5, 5], &[0.0, 0.0])).expect("fine").expect("new");
    assert_eq!(batch.refused[0].reason, RefusalReason::Time);
    assert_eq!(batch.kept, [1]);
}

#[test]
fn with_real_clocks_times_before_1990_are_refused_with_a_guess() {
    let mut intake = intake().with_earliest_time(tidemap_map::spec::REAL_CLOCK_MIN_NANOS);
    let times = [1_738_000_000, 1_738_000_000_000_000_000, -1];
    let batch = intake.take_sent(message(1, &["a"], &[0; 3], &times, &[0.0; 3])).expect("fine").expect("new");
    assert_eq!(batch.kept, [1]);
    assert!(batch.refused.iter().all(|refused| refused.reason == RefusalReason::Time), "{batch:?}");
    assert!(batch.refused[0].detail.contains("meant in seconds"), "{}", batch.refused[0].detail);
    assert!(batch.refused[1].detail.contains("before 1970"), "{}", batch.refused[1].detail);
}

#[test]
fn limits_are_errors_and_nothing_is_taken() {
    let mut intake = intake();
    let over = intake.take_sent(message(1, &["a"], &[0; 5], &[0; 5], &[0.0; 5])).expect_err("5 observations");
    assert!(matches!(over, IntakeError::Limit(OverLimit { got: Some(5), max: 4, .. })), "{over}");
    assert!(over.to_string().contains("max_batch_observations"), "{over}");
    let over = intake.take_sent(message(1, &["a", "b", "c", "d"], &[0], &[0], &[0.0])).expect_err("4 names");
    assert!(matches!(over, IntakeError::Limit(OverLimit { got: Some(4), max: 3, .. })), "{over}");
    assert!(intake.take_sent(v1::ObservationBatch { first_sequence: 1, observations: None }).is_err());
    let batch = intake.take_sent(message(1, &["a"], &[0], &[0], &[0.0])).expect("fine").expect("new");
    assert_eq!(batch.span.first, 1);
    let edge = intake.take_sent(message(u64::MAX, &[], &[0], &[0], &[0.0]));
    assert!(matches!(edge, Err(IntakeError::OutOfSequence { .. })));
}

#[test]
fn the_bytes_of_a_table_are_bounded() {
    let mut intake = intake();
    // The name is too long to be valid, but it is kept.
    let long = "x".repeat(TABLE_BYTES_MIN / 2);
    for sequence in 1..=2 {
        let batch = intake.take_sent(message(sequence, &[&long], &[0], &[0], &[0.0])).expect("fine").expect("new");
        assert_eq!(batch.refused[0].reason, RefusalReason::StateName);
    }
    let over = intake.take_sent(message(3, &["a"], &[0], &[0], &[0.0])).expect_err("full");
    assert!(matches!(over, IntakeError::Limit(OverLimit { got: Some(got), max, .. }) if got == max + 1), "{over}");
    assert!(intake.take_sent(message(3, &[], &[0], &[0], &[0.0])).is_ok());
}

#[test]
fn names_alone_are_handed_over_without_observations() {
    let mut intake = intake();
    intake.take_sent(message(1, &["a"], &[0], &[1], &[0.0])).expect("fine");
    let batch = intake.take_sent(message(1, &["b"], &[0], &[1], &[0.0])).expect("fine").expect("names");
    assert!(batch.span.is_empty());
    assert_eq!((batch.new_names.len(), batch.values.len()), (1, 0));
}

fn wide() -> GridSpec {
    GridSpec::new(1.0)
}

fn clouds(first: u64, points: &[f32], count: usize) -> v1::ScanBatch {
    let cloud = PointCloud { xyz_m: points.to_vec(), ..PointCloud::default() };
    let scan = Scan { content: Some(Content::Cloud(cloud)) };
    v1::ScanBatch {
        first_sequence: first,
        time_deltas: vec![0; count],
        scans: vec![scan; count],
        ..v1::ScanBatch::default()
    }
}

#[test]
fn a_few_long_rays_are_much_work_and_end_parcels() {
    let scans = ScanLimits { batch_scans: 8, points: 1000, tiles: 100_000 };
    let limits = IntakeLimits { scans, ..limits(4, 3) };
    let mut intake = Intake::new(0, 0, limits, Some(&wide()));
    assert!(!intake.begin_sent_scans(clouds(1, &[50.0, 0.0, 0.0], 2)).expect("fine"));
    assert_eq!(intake.next_scans().expect("fine").expect("scans").span.last, 2);
    assert!(intake.begin_sent_scans(clouds(3, &[30_000.0, 0.0, 0.0], 1)).expect("fine"));
    assert_eq!(intake.next_scans().expect("fine").expect("scans").scans.len(), 1);
    assert!(intake.next_scans().expect("fine").is_none());
    // Each of these scans is more than half of the maximum of a batch.
    let points = [11_000.0, 0.0, 0.0].repeat(1000);
    assert!(intake.begin_sent_scans(clouds(4, &points, 3)).expect("fine"));
    let lasts: Vec<u64> =
        std::iter::from_fn(|| intake.next_scans().expect("fine").map(|batch| batch.span.last)).collect();
    assert_eq!(lasts, [5, 6]);
    // The parts of a scan are taken together.
    let part = |continues| v1::ScanBatch { continues, ..clouds(7, &[9_000.0, 0.0, 0.0], 1) };
    assert!(!intake.begin_sent_scans(part(true)).expect("fine"));
    assert!(intake.next_scans().expect("fine").is_none());
    assert!(intake.begin_sent_scans(part(false)).expect("fine"));
    assert_eq!(intake.next_scans().expect("fine").expect("scans").scans.len(), 1);
}

#[test]
fn without_a_grid_no_tiles_are_handed_over() {
    let mut intake = intake();
    let message = v1::ScanBatch { new_tiles: vec![1, 2, 3], ..clouds(1, &[f32::MAX; 3], 1) };
    assert!(!intake.begin_sent_scans(message).expect("fine"));
    let batch = intake.next_scans().expect("fine").expect("a refusal");
    assert_eq!((batch.new_tiles.len(), batch.refused[0].reason), (0, RefusalReason::NoGrid));
}

#[test]
fn positions_are_taken_whole_or_refused_whole() {
    let vector = i32::from(v1::StateKind::Vector);
    let sent = |first, coordinates: &[f64]| {
        let mut sent = message(first, &["anna", "cell", "door"], &[0, 1, 2, 0], &[1, 2, 3, 4], &[0.0, 0.0, 1.0, 0.0]);
        let columns = sent.observations.as_mut().expect("there are some");
        (columns.new_kinds, columns.new_dimensions) = (vec![vector, vector, 0], vec![2, 3, 0]);
        columns.coordinates = coordinates.to_vec();
        sent
    };
    let coordinates = [1.5, -2.0, 7.0, 8.0, 9.0, 0.25, f64::NAN];
    let intake = || Intake::new(0, 0, limits(8, 3), None);
    let mut first = intake();
    let batch = first.take_sent(sent(1, &coordinates)).expect("fine").expect("new");
    assert_eq!((batch.table_indices.as_slice(), batch.kept.as_slice()), (&[0, 2][..], &[0, 2][..]));
    assert_eq!(batch.positions, [(0, Position::of(&[1.5, -2.0]).expect("two"))]);
    let refused: Vec<_> = batch.refused.iter().map(|refused| (refused.sequence, refused.reason)).collect();
    assert_eq!(refused, [(2, RefusalReason::StateName), (4, RefusalReason::Value)]);
    assert!(batch.refused[1].detail.contains("coordinate y NaN"), "{:?}", batch.refused[1]);
    let mut bytes = Vec::new();
    for (name, time, numbers) in [
        ("anna", 1_i64, &coordinates[..2]),
        ("cell", 2, &coordinates[2..5]),
        ("door", 3, &[1.0]),
        ("anna", 4, &coordinates[5..]),
    ] {
        bytes.extend_from_slice(name.as_bytes());
        bytes.extend_from_slice(&time.to_le_bytes());
        numbers.iter().for_each(|number| bytes.extend_from_slice(&number.to_le_bytes()));
    }
    assert_eq!(batch.span.content_crc, crc32c::crc32c(&bytes));

    // Observations that were taken before are skipped with their coordinates; their names are known.
    let mut again = message(4, &[], &[0, 0], &[4, 5], &[0.0; 2]);
    again.observations.as_mut().expect("there are some").coordinates = vec![0.25, f64::NAN, 3.0, 4.0];
    let batch = first.take_sent(again).expect("fine").expect("new");
    assert_eq!(batch.positions, [(0, Position::of(&[3.0, 4.0]).expect("two"))]);
    // The message has too few coordinates, too many, or coordinates of names that are not vectors.
    for wrong in [&coordinates[1..], &coordinates[..6], &[coordinates.as_slice(), &[0.0]].concat(), &[]] {
        let error = intake().take_sent(sent(1, wrong)).expect_err("malformed");
        assert!(matches!(&error, IntakeError::Invalid(field) if field.field == "observations.coordinates"), "{error}");
    }
    // Seven coordinates and a value count as eight observations.
    let error = Intake::new(0, 0, limits(7, 3), None).take_sent(sent(1, &coordinates)).expect_err("too many");
    assert!(matches!(error, IntakeError::Limit(OverLimit { got: Some(8), max: 7, .. })), "{error}");
}
