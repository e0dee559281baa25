//! Timestamps and durations as i64 nanoseconds.

use std::ops::Range;

use prost_types::{Duration, Timestamp};

use super::InvalidField;

const NANOS: i128 = 1_000_000_000;

/// A time for the wire.
#[must_use]
pub fn timestamp(nanos: i64) -> Timestamp {
    Timestamp { seconds: nanos.div_euclid(1_000_000_000), nanos: nanos.rem_euclid(1_000_000_000) as i32 }
}

/// A duration for the wire.
#[must_use]
pub fn duration(nanos: i64) -> Duration {
    Duration { seconds: nanos / 1_000_000_000, nanos: (nanos % 1_000_000_000) as i32 }
}

/// A time from the wire, in nanoseconds since 1970, from 1970 to 2262.
///
/// # Errors
/// The time is outside this range.
pub fn nanos_from_timestamp(field: &str, timestamp: Timestamp) -> Result<i64, InvalidField> {
    let nanos = i128::from(timestamp.seconds) * NANOS + i128::from(timestamp.nanos);
    i64::try_from(nanos).ok().filter(|nanos| *nanos >= 0).ok_or_else(|| {
        InvalidField::new(field, format!("{} s is outside 1970-01-01 to 2262-04-11 UTC", timestamp.seconds))
    })
}

/// A required time from the wire, in nanoseconds since 1970, from 1970 to 2262.
///
/// # Errors
/// The time is absent or outside this range.
pub fn instant_from_wire(field: &str, timestamp: Option<Timestamp>) -> Result<i64, InvalidField> {
    let missing = || InvalidField::new(field, "name a time, for example 2026-03-21T10:00:00Z");
    nanos_from_timestamp(field, timestamp.ok_or_else(missing)?)
}

/// A time of a reply; `None` if it is absent or outside 1970 to 2262.
#[must_use]
pub fn instant(timestamp: Option<Timestamp>) -> Option<i64> {
    nanos_from_timestamp("", timestamp?).ok()
}

/// A duration of a reply; `None` if it is absent or exceeds i64 nanoseconds.
#[must_use]
pub fn span(duration: Option<Duration>) -> Option<i64> {
    nanos_from_duration("", duration?).ok()
}

/// The interval from `from_time` up to, not including, `to_time`; both are required.
///
/// # Errors
/// A time is absent or outside 1970 to 2262, or the interval is empty.
pub fn interval_from_wire(
    from_time: Option<Timestamp>,
    to_time: Option<Timestamp>,
) -> Result<Range<i64>, InvalidField> {
    let within = instant_from_wire("from_time", from_time)?..instant_from_wire("to_time", to_time)?;
    if within.is_empty() {
        return Err(InvalidField::new("to_time", "it has to be later than from_time"));
    }
    Ok(within)
}

/// A duration from the wire, in nanoseconds.
///
/// # Errors
/// The duration exceeds i64 nanoseconds.
pub fn nanos_from_duration(field: &str, duration: Duration) -> Result<i64, InvalidField> {
    let nanos = i128::from(duration.seconds) * NANOS + i128::from(duration.nanos);
    i64::try_from(nanos).map_err(|_| InvalidField::new(field, format!("{} s is more than 292 years", duration.seconds)))
}

/// A time of a list, in nanoseconds UTC, not before 1970.
///
/// # Errors
/// The time is before 1970.
fn time_from_wire(field: impl Into<String>, nanos: i64) -> Result<i64, InvalidField> {
    if nanos >= 0 { Ok(nanos) } else { Err(InvalidField::new(field, format!("{nanos} ns is before 1970"))) }
}

/// Checks a list of times: at least one, none before 1970.
///
/// # Errors
/// The list is empty, or a time is before 1970.
pub fn times_from_wire(field: &str, times_nanos: &[i64]) -> Result<(), InvalidField> {
    if times_nanos.is_empty() {
        return Err(InvalidField::new(field, "name at least one time"));
    }
    (0..)
        .zip(times_nanos)
        .try_for_each(|(i, &nanos): (usize, _)| time_from_wire(format!("{field}[{i}]"), nanos).map(drop))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instants_survive_the_wire() {
        for nanos in [0, 1, 999_999_999, 1_451_865_600_000_000_000, i64::MAX] {
            assert_eq!(nanos_from_timestamp("t", timestamp(nanos)), Ok(nanos));
            assert_eq!(nanos_from_duration("d", duration(nanos)), Ok(nanos));
        }
    }

    #[test]
    fn a_list_of_times_has_one_and_none_before_1970() {
        assert_eq!(times_from_wire("times_nanos", &[]).expect_err("wrong").field, "times_nanos");
        assert_eq!(times_from_wire("times_nanos", &[1, -1]).expect_err("wrong").field, "times_nanos[1]");
        assert_eq!(times_from_wire("times_nanos", &[1, 0]), Ok(()));
    }

    #[test]
    fn instants_outside_the_range_are_named() {
        for (seconds, nanos) in [(-1, 0), (i64::MAX, 0), (9_223_372_037, 0)] {
            let error = nanos_from_timestamp("until", Timestamp { seconds, nanos }).expect_err("outside");
            assert_eq!(error.field, "until");
            assert!(error.description.contains(&seconds.to_string()), "{error}");
        }
    }
}
