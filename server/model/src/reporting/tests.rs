//! Tests the readings that rows of changes and events represent, against a naive oracle at each instant.

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
    let stated = |max, step| StatedReporting::new(RowKind::Changes, max, step);
    let found = |max, step| stated(max, step).map(StatedReporting::for_new);
    assert_eq!(found(None, None), Ok(Reporting::Changes(Hold::OF_CHANGES)));
    // Values that hold for less than the default step are learned as often as they hold.
    assert_eq!(found(Some(60), None), Ok(changes(60, 60)));
    assert!(stated(Some(60), None).is_ok_and(|stated| stated.fits(stated.for_new())));
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
    // After the longest hold no value is known; a step that has not ended is not counted.
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

/// The value of changes at an instant, searched among all rows.
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

#[test]
fn a_row_that_is_corrected_before_anything_is_learned_of_it_counts_once() {
    let reporting = Reporting::Changes(Hold::new(29, 8).expect("valid"));
    let rows = vec![(3_619 * S, Some(0.0)), (4_423 * S, Some(0.0))];
    let (_, learned) = LearnedRows::default().learn_before(reporting, rows, 0, 3_620 * S);
    let corrected = [(3_619 * S, None)];
    let counted = learned.readings_before(reporting, &corrected, 0, 7_240 * S);
    let made = learned.learn_before(reporting, corrected.to_vec(), 0, 7_240 * S).0.count();
    assert!(made == 0 && counted <= 7, "{made} readings were counted as {counted}");
}

#[test]
fn a_step_that_has_begun_with_events_counts_when_they_end() {
    let reporting = Reporting::Events(Hold::new(86, 86).expect("valid"));
    let rows = vec![(111 * S, Some(0.0)), (111 * S, None)];
    let (_, learned) = LearnedRows::default().learn_before(reporting, rows, 172 * S, 112 * S);
    let counted = learned.readings_before(reporting, &[(343 * S, None)], 172 * S, 224 * S);
    let made = learned.learn_before(reporting, vec![(343 * S, None)], 172 * S, 224 * S).0.count() as u64;
    assert!(made <= counted, "{made} readings were counted as {counted}");
}

#[test]
fn a_late_row_does_not_end_the_value_of_a_newer_one() {
    let events = Reporting::Events(Hold::new(9, 3).expect("valid"));
    let rows = vec![(3_548 * S, Some(0.0)), (3_642 * S, Some(0.0))];
    let (_, learned) = LearnedRows::default().learn_before(events, rows, 0, 3_549 * S);
    let late = vec![(3_546 * S, None)];
    let counted = learned.readings_before(events, &late, 0, 7_098 * S);
    let made: Vec<i64> = learned.learn_before(events, late, 0, 7_098 * S).0.map(|(nanos, _)| nanos / S).collect();
    assert_eq!(made, [3_546, 3_549, 3_552, 3_555], "the sensor was known to work from 3548 on");
    assert!(counted <= made.len() as u64 + 7, "{counted}");

    let changes = Reporting::Changes(Hold::new(60, 10).expect("valid"));
    let (_, learned) = LearnedRows::default().learn(changes, vec![(0, Some(0.0)), (8 * S, Some(1.0))], 9 * S);
    let (_, learned) = learned.learn(changes, vec![(5 * S, Some(0.0))], 9 * S);
    let (readings, _) = learned.learn(changes, Vec::new(), 30 * S);
    assert_eq!(readings.map(|(_, value)| value).collect::<Vec<_>>(), [1.0, 1.0]);
}

#[test]
fn late_events_count_once_however_long_events_hold() {
    let reporting = Reporting::Events(Hold::new(431, 1).expect("valid"));
    let (_, learned) = LearnedRows::default().learn_before(reporting, vec![(0, None)], 3_207 * S, 2_777 * S);
    let late = [(2_776 * S, Some(0.0))];
    let counted = learned.readings_before(reporting, &late, 3_207 * S, 5_554 * S);
    let made = learned.learn_before(reporting, late.to_vec(), 3_207 * S, 5_554 * S).0.count() as u64;
    assert!(made <= counted && counted <= made + 5, "{made} readings were counted as {counted}");
}

proptest! {
    #[test]
    fn learning_that_stops_on_the_way_goes_on_as_if_it_had_not(
        first in any_rows(), second in any_rows(), step in 1_u32..400, more in 0_u32..2_000, is_change: bool,
        horizon in 0_i64..6_000, stops in prop::collection::vec(0_i64..6_000, 1..5),
    ) {
        let hold = Hold::new(step + more, step).expect("valid");
        let reporting = if is_change { Reporting::Changes(hold) } else { Reporting::Events(hold) };
        // The second rows are later than the horizon of the first.
        let later = horizon.max(5_000) * S;
        let second: Vec<Row> = second.into_iter().map(|(nanos, value)| (nanos + later, value)).collect();
        let (readings, after) = LearnedRows::default().learn(reporting, first.clone(), horizon * S);
        let (more, after) = after.learn(reporting, second.clone(), i64::MIN);
        let at_once: Vec<(i64, f64)> = readings.chain(more).collect();
        let mut stops: Vec<i64> = stops.into_iter().map(|stop| stop * S).collect();
        stops.sort_unstable();
        let (mut found, mut learned) = (Vec::new(), LearnedRows::default());
        for (at, stop) in stops.iter().chain([&i64::MAX]).enumerate() {
            let new = if at == 0 { first.clone() } else { Vec::new() };
            let (readings, next) = learned.learn_before(reporting, new, horizon * S, *stop);
            found.extend(readings);
            learned = next;
            prop_assert!(learned.waiting.iter().all(|(nanos, _)| nanos >= stop));
            prop_assert!(found.iter().all(|(nanos, _)| nanos < stop));
        }
        let (readings, learned) = learned.learn(reporting, second, i64::MIN);
        found.extend(readings);
        prop_assert_eq!(found, at_once);
        prop_assert_eq!(learned, after);
    }

    #[test]
    fn readings_are_counted_from_above_without_being_made(
        first in any_rows(), second in any_rows(), step in 1_u32..400, more in 0_u32..2_000, is_change: bool,
        horizon in 0_i64..6_000, stop in 0_i64..12_000,
    ) {
        let hold = Hold::new(step + more, step).expect("valid");
        let reporting = if is_change { Reporting::Changes(hold) } else { Reporting::Events(hold) };
        let (_, learned) = LearnedRows::default().learn_before(reporting, first, horizon * S, stop / 2 * S);
        let counted = learned.readings_before(reporting, &second, horizon * S, stop * S);
        let rows = (learned.waiting.len() + second.len()) as u64;
        let made = learned.learn_before(reporting, second, horizon * S, stop * S).0.count() as u64;
        prop_assert!(made <= counted && counted <= made + 2 * rows + 3, "{made} readings were counted as {counted}");
    }

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
