//! What rows of changes and events stand for, against a naive reading off at each instant.

use proptest::prelude::*;

use super::*;

const S: i64 = NANOS_PER_SEC;

fn changes(max_secs: u32, step_secs: u32) -> Reporting {
    Reporting::Changes(Hold::new(max_secs, step_secs).expect("valid"))
}

fn events(max_secs: u32, step_secs: u32) -> Reporting {
    Reporting::Events(Hold::new(max_secs, step_secs).expect("valid"))
}

fn rows(rows: &[(i64, Option<f64>)]) -> Vec<Row> {
    rows.iter().map(|&(secs, value)| (secs * S, value)).collect()
}

fn read(reporting: Reporting, given: &[(i64, Option<f64>)], horizon_secs: i64) -> Vec<(i64, f64)> {
    reporting.readings(rows(given), horizon_secs * S).map(|(nanos, value)| (nanos / S, value)).collect()
}

#[test]
fn a_stated_hold_is_never_lengthened() {
    let said = |max, step| StatedReporting::new(RowKind::Changes, max, step);
    let found = |max, step| said(max, step).map(StatedReporting::for_new);
    assert_eq!(found(None, None), Ok(Reporting::Changes(Hold::OF_CHANGES)));
    // Values that hold for less than the usual step are learned as often as they hold.
    assert_eq!(found(Some(60), None), Ok(changes(60, 60)));
    assert!(said(Some(60), None).is_ok_and(|said| said.fits(said.for_new())));
    assert_eq!(found(Some(60), Some(300)), Err(InvalidHold::Max { max_secs: 60, step_secs: 300 }.into()));
    assert_eq!(found(Some(0), None), Err(InvalidHold::Max { max_secs: 0, step_secs: 1 }.into()));
}

#[test]
fn a_value_holds_until_the_next_row() {
    let door = [(95, Some(0.0)), (310, Some(1.0)), (405, None), (600, Some(1.0))];
    let expected = [(100, 0.0), (200, 0.0), (300, 0.0), (400, 1.0), (600, 1.0), (700, 1.0)];
    assert_eq!(read(changes(3_600, 100), &door, 800), expected);
}

#[test]
fn a_value_holds_no_longer_than_it_may() {
    assert_eq!(read(changes(250, 100), &[(100, Some(1.0))], 10_000), [(100, 1.0), (200, 1.0), (300, 1.0)]);
}

#[test]
fn events_are_counted_by_step_and_their_absence_counts_too() {
    let rows = [(30, Some(1.0)), (70, Some(1.0)), (130, Some(2.0)), (450, None), (700, Some(1.0))];
    let expected = [(0, 2.0), (100, 2.0), (200, 0.0), (300, 0.0), (700, 1.0)];
    assert_eq!(read(events(1_000, 100), &rows, 820), expected);
    // After the longest hold nothing is known; a step that has not ended is not counted.
    assert_eq!(read(events(100, 100), &[(10, Some(1.0))], 1_000), [(0, 1.0), (100, 0.0)]);
    assert_eq!(read(events(1_000, 100), &[(10, Some(1.0)), (110, Some(1.0))], 150), [(0, 1.0)]);
}

#[test]
fn samples_are_the_readings_that_they_are() {
    let rows = [(5, Some(1.0)), (7, Some(0.0))];
    assert_eq!(read(Reporting::Samples, &rows, 0), [(5, 1.0), (7, 0.0)]);
}

#[test]
fn rows_that_come_late_are_readings_and_earlier_ones_hold_up_to_what_was_learned() {
    let reporting = changes(3_600, 100);
    let (first, learned) = LearnedRows::default().learn(reporting, rows(&[(1_000, Some(1.0))]), 1_500 * S);
    assert_eq!(first.count(), 5);
    assert_eq!((learned.first_nanos, learned.next_nanos), (Some(1_000 * S), 1_500 * S));
    let more = rows(&[(750, Some(0.0)), (1_130, Some(0.0)), (1_450, Some(0.0))]);
    let (second, learned) = learned.learn(reporting, more, 1_700 * S);
    let found: Vec<(i64, f64)> = second.map(|(nanos, value)| (nanos / S, value)).collect();
    assert_eq!(found, [(800, 0.0), (900, 0.0), (1_130, 0.0), (1_500, 0.0), (1_600, 0.0)]);
    assert_eq!((learned.rows, learned.first_nanos), (4, Some(800 * S)));
}

#[test]
fn durations_that_make_no_sense_are_refused() {
    assert_eq!(Hold::new(3_600, 0), Err(InvalidHold::Step(0)));
    assert_eq!(Hold::new(86_401 * 2, 86_401), Err(InvalidHold::Step(86_401)));
    assert_eq!(Hold::new(299, 300), Err(InvalidHold::Max { max_secs: 299, step_secs: 300 }));
    assert!(Hold::new(366 * 86_400, 60).is_ok());
    assert!(Hold::new(366 * 86_400 + 1, 60).is_err());
    assert!(Hold::new(1_000_000, 1).is_ok());
    assert_eq!(Hold::new(1_000_001, 1), Err(InvalidHold::Readings { max_secs: 1_000_001, step_secs: 1 }));
}

/// The value of changes at an instant, looked up among all rows.
fn naive_change(rows: &[Row], max_nanos: i64, at: i64) -> Option<f64> {
    let (nanos, value) = rows.iter().rfind(|(nanos, _)| *nanos <= at)?;
    value.filter(|_| at - nanos <= max_nanos)
}

/// The number of events of a step.
fn naive_count(rows: &[Row], max_nanos: i64, at: i64, step_nanos: i64) -> Option<f64> {
    let within: Vec<&Row> = rows.iter().filter(|(nanos, _)| (at..at + step_nanos).contains(nanos)).collect();
    let count: f64 = within.iter().filter_map(|(_, events)| *events).sum();
    let is_known = rows.iter().rfind(|(nanos, _)| *nanos < at);
    let is_known = is_known.is_some_and(|(nanos, value)| value.is_some() && at - nanos <= max_nanos);
    let has_event = within.iter().any(|(_, events)| events.is_some());
    let ends = within.last().is_some_and(|(_, events)| events.is_none());
    (has_event || (is_known && !ends)).then_some(count)
}

fn any_rows() -> impl Strategy<Value = Vec<Row>> {
    let row =
        (0_i64..5_000, prop::option::weighted(0.8, 0_u8..3)).prop_map(|(secs, value)| (secs * S, value.map(f64::from)));
    prop::collection::vec(row, 1..40).prop_map(|mut rows| {
        rows.sort_by_key(|(nanos, _)| *nanos);
        rows
    })
}

proptest! {
    #[test]
    fn readings_are_those_of_every_instant(
        rows in any_rows(), step in 1_u32..400, more in 0_u32..2_000, horizon in 0_i64..6_000, is_change: bool,
    ) {
        let hold = Hold::new(step + more, step).expect("valid");
        let reporting = if is_change { Reporting::Changes(hold) } else { Reporting::Events(hold) };
        let (step, last) = (hold.step_nanos(), rows.last().expect("one").0);
        let horizon = (horizon * S).max(last + 1);
        let found: Vec<(i64, f64)> = reporting.readings(rows.clone(), horizon).collect();
        let first = rows[0].0;
        let instants = (0..).map(|index| index * step).take_while(|at| *at < horizon);
        let expected: Vec<(i64, f64)> = if is_change {
            let known = |at| Some((at, naive_change(&rows, hold.max_nanos(), at)?));
            instants.skip_while(|at| *at < first).filter_map(known).collect()
        } else {
            let known = |at| Some((at, naive_count(&rows, hold.max_nanos(), at, step)?));
            instants.take_while(|at| at + step <= horizon).filter_map(known).collect()
        };
        prop_assert_eq!(found, expected);
    }

    #[test]
    fn rows_in_order_give_the_same_readings_however_they_are_divided(
        rows in any_rows(), step in 1_u32..400, more in 0_u32..2_000, cuts in prop::collection::vec(0_i64..6_000, 0..6),
        is_change: bool,
    ) {
        let hold = Hold::new(step + more, step).expect("valid");
        let reporting = if is_change { Reporting::Changes(hold) } else { Reporting::Events(hold) };
        let whole: Vec<(i64, f64)> = reporting.readings(rows.clone(), 6_000 * S).collect();
        let (mut learned, mut left, mut found) = (LearnedRows::default(), rows, Vec::new());
        let mut cuts: Vec<i64> = cuts.into_iter().map(|secs| secs * S).chain([6_000 * S]).collect();
        cuts.sort_unstable();
        for cut in cuts {
            let later = left.split_off(left.partition_point(|(nanos, _)| *nanos < cut));
            let (readings, after) = learned.learn(reporting, left, cut);
            found.extend(readings);
            (learned, left) = (after, later);
        }
        prop_assert_eq!(found, whole);
    }
}
