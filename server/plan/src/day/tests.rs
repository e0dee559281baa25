//! Days of 23, 24 and 25 hours, and their plans.

use super::*;

const HOUR_NANOS: i64 = 60 * MINUTE_NANOS;

fn london(day: i32, slot_nanos: i64) -> Result<DaySlots, DayError> {
    DaySlots::of(&Zone::named("Europe/London").unwrap(), LocalDay(day), slot_nanos)
}

/// 2016-03-27, when clocks go forward; 2016-10-30, when they go back.
const SPRING: i32 = 16_887;
const AUTUMN: i32 = 17_104;

#[test]
fn a_day_has_as_many_slots_as_it_has_hours() {
    assert_eq!(LocalDay(SPRING).to_string(), "2016-03-27");
    assert_eq!(LocalDay(AUTUMN).to_string(), "2016-10-30");
    for (day, slots) in [(SPRING, 92), (SPRING + 1, 96), (AUTUMN, 100)] {
        let day = london(day, SLOT_NANOS).unwrap();
        assert_eq!(day.count(), slots);
        for slot in 0..slots {
            assert_eq!(day.start_nanos(slot + 1) - day.start_nanos(slot), SLOT_NANOS);
            assert_eq!(day.slot_at(day.start_nanos(slot)), Some(slot));
            assert_eq!(day.middle_nanos(slot) - day.start_nanos(slot), SLOT_NANOS / 2);
        }
        assert_eq!(day.slot_at(day.start_nanos(slots)), None);
        assert_eq!(day.slot_at(day.start_nanos(0) - 1), None);
    }
    // The day after begins where the day ends.
    let next = london(SPRING + 1, SLOT_NANOS).unwrap();
    assert_eq!(london(SPRING, SLOT_NANOS).unwrap().start_nanos(92), next.start_nanos(0));
}

#[test]
fn a_slot_that_does_not_divide_the_day_leaves_a_short_one() {
    let day = london(SPRING, 7 * HOUR_NANOS).unwrap();
    assert_eq!(day.count(), 4);
    assert_eq!(day.start_nanos(4) - day.start_nanos(3), 2 * HOUR_NANOS);
    assert_eq!(day.middle_nanos(3) - day.start_nanos(3), HOUR_NANOS);
    assert_eq!(day.start_nanos(usize::MAX), day.start_nanos(4));
    assert_eq!(london(SPRING, 23 * HOUR_NANOS).unwrap().count(), 1);
}

#[test]
fn what_suits_no_day_is_refused() {
    for slot_nanos in [0, -1, MINUTE_NANOS - 1, 24 * HOUR_NANOS, i64::MAX, i64::MIN] {
        assert!(matches!(london(SPRING, slot_nanos), Err(DayError::Slot { .. })), "{slot_nanos}");
    }
    // Samoa crossed the date line and had no 2011-12-30.
    let apia = Zone::named("Pacific/Apia").unwrap();
    assert_eq!(LocalDay(15_338).to_string(), "2011-12-30");
    assert_eq!(DaySlots::of(&apia, LocalDay(15_338), SLOT_NANOS), Err(DayError::NoSuchDay { day: LocalDay(15_338) }));
    for day in [i32::MIN, i32::MAX, -1] {
        assert!(matches!(london(day, SLOT_NANOS), Err(DayError::NoSuchDay { .. })), "{day}");
    }
    let day = london(SPRING, SLOT_NANOS).unwrap();
    let plan = |places, budget| plan_day(&day, places, |_, _| 1.0, Strategy::MonteCarlo, budget, 1);
    assert_eq!(plan(2, Budget::Visits(93)), Err(StrategyError::Budget { visits: 93, slots: 92 }.into()));
    assert_eq!(plan(0, Budget::Visits(1)), Err(StrategyError::NoPlaces.into()));
    assert_eq!(plan(1_000_000, Budget::Visits(1)), Err(StrategyError::TooMany { slots: 92, places: 1_000_000 }.into()));
}

#[test]
fn a_plan_asks_for_the_middle_of_each_slot_and_reports_its_gain() {
    let day = london(AUTUMN, HOUR_NANOS).unwrap();
    let noon_nanos = day.start_nanos(13);
    let gain = |at_nanos: i64, place: usize| {
        assert_eq!(at_nanos.rem_euclid(HOUR_NANOS), HOUR_NANOS / 2);
        if at_nanos > noon_nanos { 1.0 + place as f64 } else { 0.25 }
    };
    let plan = plan_day(&day, 3, gain, Strategy::Greedy, Budget::Visits(12), 5).unwrap();
    assert_eq!(plan.len(), 25);
    for row in &plan {
        assert_eq!(row.start_nanos, day.start_nanos(row.slot));
        let is_visit = row.slot >= 13;
        assert_eq!(row.location, is_visit.then_some(2));
        assert!((row.information_bits - if is_visit { 3.0 } else { 0.0 }).abs() < 1e-12);
    }
}
