//! The contract of the simulated office: it is reproducible, follows the wall clock, and its robots stop irregularly.

use jiff::{Timestamp, civil::date};
use tidemap_sim::Office;

const MINUTE_NANOS: i64 = 60 * 1_000_000_000;
const DAY_MINUTES: i64 = 24 * 60;

fn office(seed: u64) -> Office {
    Office::new(seed, "Europe/London").expect("a zone of the database")
}

fn state(office: &Office, name: &str) -> usize {
    office.states().iter().position(|&state| state == name).expect("a state of the office")
}

fn nanos(text: &str) -> i64 {
    let time: Timestamp = text.parse().expect("a time");
    i64::try_from(time.as_nanosecond()).expect("a time that i64 holds")
}

/// Mean local hour at which the first person is in `office-1`, over the working days of a week.
fn first_open_hour(office: &Office, monday: jiff::civil::Date) -> f64 {
    let zone = jiff::tz::TimeZoneDatabase::bundled().get("Europe/London").expect("a zone of the database");
    let door = state(office, "office-1-door");
    let mut hours = Vec::new();
    for weekday in 0..5 {
        let day = monday.checked_add(jiff::Span::new().days(weekday)).expect("a date");
        let midnight = day.to_zoned(zone.clone()).expect("a date").timestamp().as_nanosecond();
        let midnight = i64::try_from(midnight).expect("a time that i64 holds");
        let open = (0..DAY_MINUTES).find(|minute| office.truth(door, midnight + minute * MINUTE_NANOS) > 0.5);
        hours.extend(open.map(|minute| minute as f64 / 60.0).filter(|&hour| hour < 12.0));
    }
    hours.iter().sum::<f64>() / hours.len() as f64
}

#[test]
fn a_seed_gives_one_office() {
    let (from, to) = (nanos("2025-03-03T00:00:00Z"), nanos("2025-03-10T00:00:00Z"));
    let seen = |seed| office(seed).visits(0, from, to).collect::<Vec<_>>();
    assert_eq!(seen(7), seen(7));
    assert_ne!(seen(7), seen(8));
}

#[test]
fn unknown_zones_are_named() {
    let error = Office::new(1, "Europe/Lundon").expect_err("there is no such zone");
    assert!(error.to_string().contains("Europe/Lundon"));
}

#[test]
fn routines_hold_on_the_wall_clock_across_summer_time() {
    let office = office(3);
    // Clocks went forward on Sunday 30 March 2025: the same local hour is another hour UTC.
    let before = first_open_hour(&office, date(2025, 3, 24));
    let after = first_open_hour(&office, date(2025, 3, 31));
    assert!((7.5..8.75).contains(&before), "before: {before}");
    assert!((7.5..8.75).contains(&after), "after: {after}");
}

#[test]
fn weekends_are_quiet_and_constant_doors_are_constant() {
    let office = office(5);
    let saturday = nanos("2025-04-05T00:00:00Z");
    for minute in 0..DAY_MINUTES {
        let time = saturday + minute * MINUTE_NANOS;
        assert!(office.truth(state(&office, "kitchen"), time) < 0.5);
        assert!(office.truth(state(&office, "entrance-door"), time) < 0.5);
        assert!(office.truth(state(&office, "corridor-door"), time) > 0.5);
    }
}

#[test]
fn the_weekly_meeting_is_on_tuesdays() {
    let office = office(5);
    let meeting = state(&office, "meeting-room");
    let mean_at = |first: &str| {
        let first = nanos(first);
        (0..20).map(|week| office.truth(meeting, first + week * 7 * DAY_MINUTES * MINUTE_NANOS)).sum::<f64>() / 20.0
    };
    // Winter time only, so that UTC is the wall clock.
    assert!(mean_at("2024-11-05T10:45:00Z") > 0.8);
    assert!(mean_at("2024-11-06T10:45:00Z") < 0.4);
}

#[test]
fn the_random_door_has_no_daily_rhythm() {
    let office = office(11);
    let door = state(&office, "storage-door");
    let start = nanos("2025-01-06T00:00:00Z");
    for hour in 0..24 {
        let time = |day: i64| start + (day * DAY_MINUTES + hour * 60 + 1) * MINUTE_NANOS;
        let mean = (0..400).map(|day| office.truth(door, time(day))).sum::<f64>() / 400.0;
        assert!((0.3..0.5).contains(&mean), "at {hour} h: {mean}");
    }
}

#[test]
fn visits_are_ordered_sparse_irregular_and_true() {
    let office = office(2);
    let (from, to) = (nanos("2025-03-24T00:00:00Z"), nanos("2025-04-07T00:00:00Z"));
    for robot in 0..office.robots().len() {
        let seen: Vec<_> = office.visits(robot, from, to).collect();
        assert!(seen.len() > 500, "{} observations", seen.len());
        assert!(seen.iter().all(|&(time, state, value)| {
            (from..to).contains(&time) && office.truth(state, time).to_bits() == value.to_bits()
        }));
        assert!(seen.windows(2).all(|pair| (pair[0].0, pair[0].1) < (pair[1].0, pair[1].1)));
        let mut gaps: Vec<i64> = seen.windows(2).map(|pair| pair[1].0 - pair[0].0).filter(|&gap| gap > 0).collect();
        gaps.sort_unstable();
        let (low, high) = (gaps[gaps.len() / 10], gaps[gaps.len() * 9 / 10]);
        assert!(high > 4 * low, "gaps from {low} to {high} ns are too regular");
        assert!(gaps.last().is_some_and(|&gap| gap > 40 * MINUTE_NANOS), "there are breaks for charging");
    }
}

#[test]
fn windows_that_touch_add_up() {
    let office = office(4);
    let times = ["2025-03-29T07:30:00Z", "2025-03-30T13:11:00Z", "2025-04-01T22:30:00Z"].map(nanos);
    let whole: Vec<_> = office.visits(0, times[0], times[2]).collect();
    let mut parts: Vec<_> = office.visits(0, times[0], times[1]).collect();
    parts.extend(office.visits(0, times[1], times[2]));
    assert_eq!(whole, parts);
    assert!(!whole.is_empty());
}

#[test]
fn any_zone_of_the_database_will_do() {
    let office = Office::new(1, "Asia/Kathmandu").expect("a zone of the database");
    // 08:30 UTC is 14:15 there, on a working day.
    let open: f64 = (1..4).map(|state| office.truth(state, nanos("2025-03-19T08:30:00Z"))).sum();
    assert!(open > 0.5);
}
