//! Tests which periods are candidates, and times as points on circles.

use super::*;

const WEEK_NANOS: i64 = 7 * DAY_NANOS;

fn days(count: i64) -> impl Iterator<Item = i64> {
    (0..=count * 24).map(|hour| hour * 3_600 * NANOS_PER_SEC)
}

fn period(cycle_nanos: i64, divisor: u32) -> HypertimePeriod {
    HypertimePeriod { cycle_nanos, divisor }
}

#[test]
fn a_month_and_a_year_are_candidates_beside_a_week_when_the_readings_hold_them() {
    let others = |span_days: i64| {
        let candidates = Candidates::new(&Periodicities::default(), days(span_days));
        candidates.others().iter().map(|period| (period.secs() / 86_400.0).round()).collect::<Vec<f64>>()
    };
    assert_eq!(others(29), Vec::<f64>::new());
    assert_eq!(others(31), [30.0]);
    assert_eq!(others(362), [365.0, 30.0]);
}

#[test]
fn the_candidates_of_a_map_are_its_own() {
    let year = Periodicities::harmonics(365 * DAY_NANOS, 1_000).expect("in range");
    let candidates = Candidates::new(&year, days(800));
    let found: Vec<u32> = candidates.of_cycle().map(|period| period.divisor).collect();
    assert_eq!(found, (1..=365).collect::<Vec<u32>>(), "a year to a day");
    assert!(candidates.others().is_empty(), "a year and a month are among them");
    assert_eq!(candidates.slots(), 8_760);

    let week = Candidates::new(&Periodicities::default(), days(20));
    assert_eq!(week.of_cycle().count(), 84);
    assert_eq!(week.slots(), 2_016);

    let list = Periodicities::list(vec![DAY_NANOS, WEEK_NANOS, 2 * DAY_NANOS]).expect("in range");
    let list = Candidates::new(&list, days(20));
    assert_eq!(list.of_cycle().map(|period| period.divisor).collect::<Vec<u32>>(), [1, 7]);
    assert_eq!(list.others(), [period(2 * DAY_NANOS, 1)]);
}

#[test]
fn readings_hold_a_period_that_their_span_and_a_gap_fill() {
    let monthly = (0..12).map(|month| month * 2_629_746 * NANOS_PER_SEC);
    let candidates = Candidates::new(&Periodicities::default(), monthly);
    assert!(candidates.holds(period(CALENDAR_NANOS[1], 1)), "twelve monthly bins hold a year");
    assert!(!candidates.holds(period(WEEK_NANOS, 1)), "and no week");
    let hourly = Candidates::new(&Periodicities::default(), days(7));
    assert!(hourly.holds(period(WEEK_NANOS, 84)) && hourly.holds(period(WEEK_NANOS, 1)));
    assert!(!hourly.holds(period(2 * WEEK_NANOS, 1)));
}

#[test]
fn a_time_is_in_the_same_place_of_a_circle_after_its_period() {
    let candidates = Candidates::new(&Periodicities::default(), days(7));
    let at = |civil_nanos: i64| {
        let mut point = Vec::new();
        project(civil_nanos, &[period(WEEK_NANOS, 7), period(WEEK_NANOS, 84)], &mut point);
        point
    };
    for civil in [0, -1, 1_700_000_000_123_456_789, i64::MIN, i64::MAX - WEEK_NANOS] {
        let (now, next_day) = (at(civil), at(civil + DAY_NANOS));
        for (a, b) in now.iter().zip(&next_day) {
            assert!((a - b).abs() < 1e-9, "{civil}: {now:?}, {next_day:?}");
        }
        assert!(candidates.slot(civil) < candidates.slots());
    }
    for slot in [0, 1, 700, 2_015] {
        assert_eq!(candidates.slot(candidates.middle_nanos(slot)), slot);
    }
}
