//! Days on the wall clock of an office, and the UTC times of their moments.
//!
//! Invariant: within a day, and from day to day, later on the wall clock is never earlier in UTC. Where clocks go
//! forward, times in the skipped hour are at the change; where they go back, times are in the first pass of the hour.

use jiff::{
    SignedDuration, Timestamp, ToSpan,
    civil::{Date, date},
    tz::TimeZone,
};

use crate::people::closed;

/// Day 0: a Thursday.
const EPOCH: Date = date(1970, 1, 1);

const DAY_NANOS: i64 = 86_400 * 1_000_000_000;
const MILLISECOND_NANOS: i64 = 1_000_000;

/// A date.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct CivilDay {
    /// Days since 1970-01-01.
    pub(crate) number: i32,
}

impl CivilDay {
    pub(crate) fn new(date: Date) -> Self {
        Self { number: (date.duration_since(EPOCH).as_hours() / 24) as i32 }
    }

    fn date(self) -> Date {
        EPOCH.saturating_add(self.number.days())
    }

    /// The day `days` later, or earlier if negative.
    pub(crate) fn plus(self, days: i32) -> Self {
        Self { number: self.number + days }
    }

    /// From 0 for Monday to 6 for Sunday.
    pub(crate) fn weekday(self) -> u32 {
        (self.number + 3).rem_euclid(7).unsigned_abs()
    }

    /// Number of the Monday of this week.
    pub(crate) fn monday(self) -> i32 {
        self.number - self.weekday().cast_signed()
    }

    /// Whether people work on this day.
    pub(crate) fn open(self) -> bool {
        !closed(self.date())
    }
}

/// The part of a day with one UTC offset.
#[derive(Clone, Copy, Debug)]
struct Piece {
    from_nanos: i64,
    until_nanos: i64,
    offset_nanos: i64,
}

/// A day with its UTC offsets.
#[derive(Clone, Debug)]
pub(crate) struct ClockDay {
    pub(crate) day: CivilDay,
    /// First instant after the day in nanoseconds UTC.
    pub(crate) end_nanos: i64,
    pieces: Vec<Piece>,
}

impl ClockDay {
    /// The time at which the wall clock shows `millis` after midnight, in nanoseconds UTC.
    pub(crate) fn utc_nanos(&self, millis: i32) -> i64 {
        let shown = i64::from(self.day.number) * DAY_NANOS + i64::from(millis) * MILLISECOND_NANOS;
        for piece in &self.pieces {
            let utc = (shown - piece.offset_nanos).max(piece.from_nanos);
            if utc < piece.until_nanos {
                return utc;
            }
        }
        self.end_nanos
    }
}

/// First instant of a day in nanoseconds UTC.
pub(crate) fn midnight_nanos(zone: &TimeZone, day: CivilDay) -> i64 {
    let start = day.date().to_zoned(zone.clone()).map_or(i128::MAX, |start| start.timestamp().as_nanosecond());
    start.clamp(i64::MIN.into(), i64::MAX.into()) as i64
}

/// The day that contains an instant.
pub(crate) fn day_at(zone: &TimeZone, utc_nanos: i64) -> CivilDay {
    let shown = zone.to_datetime(Timestamp::UNIX_EPOCH + SignedDuration::from_nanos(utc_nanos));
    let mut day = CivilDay::new(shown.date());
    // Clocks that go back across midnight show yesterday again, and a zone can skip a whole day.
    for _ in 0..2 {
        if utc_nanos < midnight_nanos(zone, day) {
            day = day.plus(-1);
        } else if utc_nanos >= midnight_nanos(zone, day.plus(1)) {
            day = day.plus(1);
        }
    }
    day
}

/// A day with its UTC offsets.
pub(crate) fn clock_day(zone: &TimeZone, day: CivilDay) -> ClockDay {
    let (start, end) = (midnight_nanos(zone, day), midnight_nanos(zone, day.plus(1)));
    let first = Timestamp::UNIX_EPOCH + SignedDuration::from_nanos(start);
    let nanos = |offset: jiff::tz::Offset| i64::from(offset.seconds()) * 1_000_000_000;
    let mut pieces = vec![Piece { from_nanos: start, until_nanos: end, offset_nanos: nanos(zone.to_offset(first)) }];
    for change in zone.following(first) {
        let at = (change.timestamp().as_nanosecond()).clamp(i64::MIN.into(), i64::MAX.into()) as i64;
        if at >= end {
            break;
        }
        if let Some(last) = pieces.last_mut() {
            last.until_nanos = at;
        }
        pieces.push(Piece { from_nanos: at, until_nanos: end, offset_nanos: nanos(change.offset()) });
    }
    ClockDay { day, end_nanos: end, pieces }
}

#[cfg(test)]
mod tests {
    use jiff::tz::TimeZoneDatabase;

    use super::*;

    const HOUR_MILLIS: i32 = 3_600_000;

    #[test]
    fn weekdays_and_dates_agree_with_the_calendar() {
        let monday = CivilDay::new(date(2025, 3, 31));
        assert_eq!((monday.weekday(), monday.monday(), monday.open()), (0, monday.number, true));
        assert_eq!((monday.plus(-1).weekday(), monday.plus(-1).open()), (6, false));
        assert_eq!(monday.plus(-1).date(), date(2025, 3, 30));
    }

    #[test]
    fn days_touch_and_their_moments_are_in_order_whatever_clocks_do() {
        for (name, first) in [
            ("Europe/London", date(2025, 3, 28)),
            ("Europe/London", date(2025, 10, 24)),
            ("America/Sao_Paulo", date(2018, 2, 15)),
            ("America/Sao_Paulo", date(2018, 11, 2)),
            ("Pacific/Apia", date(2011, 12, 28)),
            ("Asia/Beirut", date(2022, 3, 25)),
        ] {
            let zone = TimeZoneDatabase::bundled().get(name).expect("a zone of the database");
            let mut last = midnight_nanos(&zone, CivilDay::new(first));
            for days in 0..5 {
                let day = clock_day(&zone, CivilDay::new(first).plus(days));
                for half_hour in 0..48 {
                    let utc = day.utc_nanos(half_hour * HOUR_MILLIS / 2);
                    assert!(utc >= last, "{name}, day {days}, half hour {half_hour}");
                    assert!(utc == day.end_nanos || day_at(&zone, utc) == day.day, "{name}, {days}, {half_hour}");
                    last = utc;
                }
                assert!(last <= day.end_nanos);
            }
        }
    }

    #[test]
    fn the_wall_clock_shows_summer_time() {
        let zone = TimeZoneDatabase::bundled().get("Europe/London").expect("a zone of the database");
        let before = clock_day(&zone, CivilDay::new(date(2025, 3, 29)));
        let change = clock_day(&zone, CivilDay::new(date(2025, 3, 30)));
        let hours = |from: i64, to: i64| (to - from) / (DAY_NANOS / 24);
        assert_eq!(hours(before.utc_nanos(9 * HOUR_MILLIS), change.utc_nanos(9 * HOUR_MILLIS)), 23);
        // 01:30 was left out.
        assert_eq!(change.utc_nanos(HOUR_MILLIS), change.utc_nanos(HOUR_MILLIS * 3 / 2));
    }
}
