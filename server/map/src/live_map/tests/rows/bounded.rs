//! Tests rows that represent more readings than one update learns: several updates learn them as one update would.

use super::{late::KeptHome, *};
use tidemap_grid::spec::Retention;

const DOOR: StateId = StateId(0);
const DAYS: i64 = 14;

fn changes() -> Reporting {
    Reporting::Changes(hold(7 * DAY, 5 * MINUTE))
}

/// A door whose office hours have arrived, with observations of its producer until the end of the last day.
fn arrived(reporting: Reporting) -> KeptHome {
    let kind = if matches!(reporting, Reporting::Events(_)) { StateKind::Count } else { StateKind::Probability };
    let mut home = KeptHome::new(kind, reporting, Retention::Forever);
    home.home.observe(&office_hours(DAYS), HOUR);
    home
}

#[test]
fn several_updates_learn_what_one_would() {
    let end = MONDAY + DAYS * DAY;
    for reporting in [changes(), Reporting::Events(hold(7 * DAY, HOUR)), Reporting::Changes(hold(DAY, 7 * MINUTE))] {
        let mut at_once = arrived(reporting);
        assert_eq!(at_once.update_bounded(end, u64::MAX), None);
        for readings_max in [0, 300, 1_000] {
            let mut in_parts = arrived(reporting);
            let (mut updates, mut learned_to) = (1, MONDAY);
            while let Some(to_nanos) = in_parts.update_bounded(end, readings_max) {
                assert!(to_nanos > learned_to, "each update learns a day or more");
                assert_eq!(to_nanos % DAY, 0, "up to a local midnight");
                (updates, learned_to) = (updates + 1, to_nanos);
                let view = in_parts.home.map.publish();
                let waiting = office_hours(DAYS).iter().filter(|(nanos, _)| *nanos >= to_nanos).count() as u64;
                assert_eq!((view.waiting_rows(), view.pending(), view.pending_of(DOOR)), (waiting, waiting, waiting));
            }
            if readings_max == 0 {
                assert_eq!(updates, DAYS, "one local day is always learned");
            }
            assert!(updates > 1 || readings_max == 1_000, "{reporting} in {updates} updates");
            assert_eq!(in_parts.model(), at_once.model(), "{reporting} in {updates} updates");
            assert_eq!(in_parts.home.map.publish().pending(), 0);
        }
    }
}

#[test]
fn what_waits_is_learned_after_a_restart() {
    let end = MONDAY + DAYS * DAY;
    let mut at_once = arrived(changes());
    at_once.update_bounded(end, u64::MAX);
    let mut home = arrived(changes());
    assert_eq!(home.update_bounded(end, 0), Some(MONDAY + DAY));
    home.restart();
    assert_eq!(home.home.map.waiting_rows(), 2 * (DAYS as u64 - 1));
    assert_eq!(home.update_bounded(end, u64::MAX), None);
    assert_eq!(home.model(), at_once.model());
}

#[test]
fn rows_of_before_the_last_update_are_bounded_too() {
    let mut home = KeptHome::new(StateKind::Probability, changes(), Retention::Forever);
    // The map has learned the rows up to this time.
    home.update_bounded(MONDAY + 30 * DAY, u64::MAX);
    home.home.observe(&office_hours(DAYS), 30 * DAY);
    let mut updates = 1;
    while home.update_bounded(MONDAY + 30 * DAY, 300).is_some() {
        updates += 1;
    }
    assert!(updates > DAYS / 2, "{updates}");
    let mut at_once = arrived(changes());
    at_once.update_bounded(MONDAY + 30 * DAY, u64::MAX);
    assert_eq!(home.model(), at_once.model());
}

#[test]
fn rows_that_come_meanwhile_are_learned_in_their_order() {
    let end = MONDAY + DAYS * DAY;
    let mut at_once = arrived(changes());
    at_once.update_bounded(end, u64::MAX);
    let (early, late): (Vec<_>, Vec<_>) = office_hours(DAYS).into_iter().partition(|(_, value)| *value == 1.0);
    let mut home = KeptHome::new(StateKind::Probability, changes(), Retention::Forever);
    home.home.observe(&early, HOUR);
    assert_eq!(home.update_bounded(end, 0), Some(MONDAY + DAY));
    home.home.observe(&late[1..], HOUR);
    home.home.observe(&late[..1], HOUR);
    while home.update_bounded(end, 0).is_some() {}
    // The first row came late, so the state is learned anew, with an equal result in the end.
    assert_eq!(home.model(), at_once.model());
}

#[test]
fn the_readings_of_a_day_are_those_of_the_step() {
    assert_eq!(Reporting::Samples.readings_a_day(), 0);
    assert_eq!(changes().readings_a_day(), 288);
    assert_eq!(Reporting::Events(hold(DAY, 7 * HOUR)).readings_a_day(), 4);
    assert_eq!(arrived(changes()).home.map.row_readings_a_day(), 288);
}
