//! Tests the properties of `civil.rs`, against a naive oracle where there is one.

use super::*;

const HOUR_NANOS: i64 = 3600 * NANOS_PER_SEC;

fn day(text: &str) -> LocalDay {
    let date: jiff::civil::Date = text.parse().unwrap();
    let since = Offset::UTC.to_timestamp(date.to_datetime(Time::midnight())).unwrap();
    LocalDay((since.as_second() / SECS_PER_DAY) as i32)
}

fn utc(text: &str) -> i64 {
    text.parse::<Timestamp>().unwrap().as_nanosecond() as i64
}

#[track_caller]
fn check_midnight(zone: &str, date: &str, expected: &str) {
    let found = Zone::named(zone).unwrap().midnight_nanos(day(date));
    assert_eq!(found, utc(expected), "{zone} {date}: {}", Timestamp::from_nanosecond(found.into()).unwrap());
}

#[track_caller]
fn check_day_hours(zone: &str, date: &str, hours: i64) {
    let zone = Zone::named(zone).unwrap();
    let LocalDay(today) = day(date);
    let length = zone.midnight_nanos(LocalDay(today + 1)) - zone.midnight_nanos(LocalDay(today));
    assert_eq!(length, hours * HOUR_NANOS, "{} {date}", zone.name());
}

#[test]
fn days_are_shown_as_dates() {
    for date in ["1970-01-01", "2000-02-29", "2016-03-27", "2100-03-01", "2262-04-11"] {
        assert_eq!(day(date).to_string(), date);
    }
    assert_eq!(LocalDay(-1).to_string(), "1969-12-31");
    assert_eq!(LocalDay(i32::MIN).to_string(), "-5877641-06-23");
    assert_eq!(LocalDay(i32::MAX).to_string(), "5881580-07-11");
}

#[test]
fn names_are_found_whatever_their_case_and_others_refused() {
    assert_eq!(Zone::named("europe/LONDON").unwrap().name(), "Europe/London");
    assert_eq!(Zone::named("Europe/London"), Zone::named("europe/london"));
    assert_eq!(Zone::named("UTC").unwrap(), Zone::utc());
    for name in ["", "Europe/Lincoln", "Etc/Unknown", "../../etc/passwd"] {
        assert_eq!(Zone::named(name), Err(UnknownZone { name: name.to_owned() }));
    }
    let message = Zone::named("Mars/Base").unwrap_err().to_string();
    assert_eq!(message, "unknown time zone \"Mars/Base\"; expected an IANA name such as Europe/London");
}

#[test]
fn london_changes_its_clocks() {
    let london = Zone::named("Europe/London").unwrap();
    assert_eq!(london.offset_secs(utc("2016-03-27T00:59:59Z")), 0);
    assert_eq!(london.offset_secs(utc("2016-03-27T01:00:00Z")), 3600);
    assert_eq!(london.offset_secs(utc("2016-10-30T00:59:59Z")), 3600);
    assert_eq!(london.offset_secs(utc("2016-10-30T01:00:00Z")), 0);
    check_midnight("Europe/London", "2016-03-27", "2016-03-27T00:00:00Z");
    check_midnight("Europe/London", "2016-03-28", "2016-03-27T23:00:00Z");
    check_day_hours("Europe/London", "2016-03-26", 24);
    check_day_hours("Europe/London", "2016-03-27", 23);
    check_day_hours("Europe/London", "2016-10-30", 25);
    assert_eq!(london.day_of(utc("2016-06-01T22:59:59Z")), day("2016-06-01"));
    assert_eq!(london.day_of(utc("2016-06-01T23:00:00Z")), day("2016-06-02"));
}

#[test]
fn a_skipped_midnight_is_the_moment_of_the_jump() {
    check_midnight("America/Sao_Paulo", "2017-10-15", "2017-10-15T03:00:00Z");
    check_day_hours("America/Sao_Paulo", "2017-10-15", 23);
    check_midnight("Africa/Cairo", "2014-08-01", "2014-07-31T22:00:00Z");
    check_midnight("Africa/Cairo", "2023-04-28", "2023-04-27T22:00:00Z");
    // Clocks went from 23:30 and from 23:00 straight to midnight.
    check_midnight("Asia/Pyongyang", "2018-05-05", "2018-05-04T15:00:00Z");
    check_midnight("America/Nuuk", "2024-03-31", "2024-03-31T01:00:00Z");
    // Samoa skipped 30 December 2011.
    check_midnight("Pacific/Apia", "2011-12-30", "2011-12-30T10:00:00Z");
    check_midnight("Pacific/Apia", "2011-12-31", "2011-12-30T10:00:00Z");
}

#[test]
fn a_repeated_midnight_counts_from_its_first() {
    // Clocks went from 01:00 back to 00:00.
    check_midnight("America/Havana", "2016-11-06", "2016-11-06T04:00:00Z");
    check_day_hours("America/Havana", "2016-11-06", 25);
    // Clocks went from 00:01 back to 23:01 of the day before.
    check_midnight("America/St_Johns", "2006-10-29", "2006-10-29T02:30:00Z");
    // Clocks went from 24:00 back to 23:00, so the date begins once, an hour later.
    check_midnight("America/Sao_Paulo", "2018-02-18", "2018-02-18T03:00:00Z");
    check_day_hours("America/Sao_Paulo", "2018-02-17", 25);
}

#[test]
fn times_saturate_at_both_ends() {
    for name in ["UTC", "Pacific/Kiritimati", "America/Los_Angeles"] {
        let zone = Zone::named(name).unwrap();
        assert_eq!(zone.offset_secs(i64::MIN), zone.offset_secs(0));
        assert!(zone.day_of(i64::MAX) <= day("2262-04-12"));
        assert_eq!(zone.midnight_nanos(LocalDay(i32::MIN)), 0);
        assert_eq!(zone.midnight_nanos(LocalDay(i32::MAX)), i64::MAX);
        assert_eq!(zone.midnight_nanos(LocalDay(-1)), 0);
        let mut cache = zone.offset_cache();
        assert_eq!(cache.offset_secs(i64::MAX), zone.offset_secs(i64::MAX));
        assert_eq!(cache.offset_secs(i64::MIN), zone.offset_secs(0));
    }
    let utc_zone = Zone::utc();
    assert_eq!(utc_zone.day_of(utc("2038-01-19T03:14:08Z")), day("2038-01-19"));
    assert_eq!(utc_zone.midnight_nanos(day("2106-02-07")), utc("2106-02-07T00:00:00Z"));
}

proptest::proptest! {
    #[test]
    fn cache_and_midnights_agree_with_the_zone(
        which in 0_usize..6,
        moments in proptest::collection::vec(0..=i64::MAX, 1..30),
    ) {
        let names =
            ["UTC", "Europe/London", "America/Sao_Paulo", "Africa/Casablanca", "Australia/Lord_Howe", "Asia/Kathmandu"];
        let zone = Zone::named(names[which]).unwrap();
        let mut cache = zone.offset_cache();
        for start in moments {
            for utc_nanos in [start, start.saturating_add(HOUR_NANOS), start.saturating_add(90 * 24 * HOUR_NANOS)] {
                proptest::prop_assert_eq!(cache.offset_secs(utc_nanos), zone.offset_secs(utc_nanos));
                let today = zone.day_of(utc_nanos);
                let midnight = zone.midnight_nanos(today);
                proptest::prop_assert!(midnight <= utc_nanos);
                // Civil time saturates in the last day of i64, in the year 2262.
                let is_last_day = utc_nanos > i64::MAX - 24 * HOUR_NANOS;
                proptest::prop_assert!(zone.midnight_nanos(LocalDay(today.0 + 1)) > utc_nanos || is_last_day);
                if midnight > 0 {
                    proptest::prop_assert_eq!(zone.day_of(midnight), today);
                    proptest::prop_assert!(zone.day_of(midnight - 1) < today);
                }
            }
        }
    }
}

#[test]
fn dates_are_read_as_they_are_shown() {
    for day in [0, -1, 16_861, 20_512, 59, 2_932_896] {
        assert_eq!(LocalDay::parse(&LocalDay(day).to_string()), Some(LocalDay(day)), "{day}");
    }
    assert_eq!(LocalDay::parse("2016-02-29"), Some(LocalDay(16_860)));
    for wrong in
        ["", "2015-02-29", "2016-13-01", "20160229", "2016-2-29", "2016-02-29T00:00", " 2016-02-29", "tomorrow"]
    {
        assert_eq!(LocalDay::parse(wrong), None, "{wrong:?}");
    }
}
