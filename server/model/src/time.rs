//! Times and durations as text, and the limits of both.
//!
//! Invariant: a time is i64 nanoseconds UTC since 1970, at least 0. Times are read and written with decimal arithmetic,
//! never with floats, so that every digit is kept. RFC 3339 is read by jiff. Durations are read here: jiff's parser has
//! no fractions of days and weeks and no exponents.

mod decimal;

use decimal::{Decimal, InvalidDecimal};

/// Nanoseconds in a second.
pub const NANOS_PER_SEC: i64 = 1_000_000_000;

/// The shortest half-life: a tenth of a day.
pub const HALF_LIFE_MIN_NANOS: i64 = 8_640 * NANOS_PER_SEC;

/// The longest time after the clock of receipt at which an observation's time is plausible, in nanoseconds.
/// Observations with a later time wait: they change nothing until an update whose cut has passed their time.
pub const FUTURE_MAX_NANOS: i64 = 5 * 60 * NANOS_PER_SEC;

/// The reason why a text is not a valid time.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InvalidTime {
    /// Neither a number nor RFC 3339.
    #[error("{0:?} is not a time: use Unix seconds such as 1458518400.5, or RFC 3339 such as 2016-03-21T00:00:00Z")]
    Malformed(String),
    /// A civil time without a time zone.
    #[error("{0:?} has no time zone: add Z for UTC, or an offset such as +01:00")]
    NoOffset(String),
    /// Before 1970.
    #[error("{0:?} is before 1970: times are counted from 1970-01-01T00:00:00Z")]
    TooEarly(String),
    /// Not representable as i64 nanoseconds.
    #[error("{0:?} is after 2262-04-11T23:47:16Z, the latest possible time{hint}", hint = magnitude_hint(.0))]
    TooLate(String),
    /// More precise than a nanosecond.
    #[error("{0:?} is more precise than a nanosecond: use at most 9 digits after the point")]
    TooFine(String),
}

/// The reason why a text is not a valid duration.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InvalidDuration {
    /// Not a number with a unit.
    #[error("{0:?} is not a duration: use a number and a unit, such as 90s, 15m, 1h or 7d")]
    Malformed(String),
    /// Not above 0.
    #[error("{0:?} is not a duration: it has to be above 0")]
    Zero(String),
    /// Not representable as i64 nanoseconds.
    #[error("{0:?} is too long: at most 292 years (106751d)")]
    TooLong(String),
}

/// A hint for times that were probably given in milliseconds, microseconds or nanoseconds.
fn magnitude_hint(text: &str) -> &'static str {
    match text.bytes().take_while(u8::is_ascii_digit).count() {
        13 => "; in milliseconds? times are in seconds",
        16 => "; in microseconds? times are in seconds",
        19 => "; in nanoseconds? times are in seconds",
        _ => "",
    }
}

fn shown(text: &str) -> String {
    text.chars().take(40).collect()
}

/// Reads Unix seconds (`1458518400`, `1458518400.25`) or RFC 3339 (`2016-03-21T00:00:00Z`, `…+01:00`).
///
/// # Errors
/// [`InvalidTime`], with the text.
///
/// ```
/// assert_eq!(tidemap_model::time::parse_time("1458518400.25"), Ok(1_458_518_400_250_000_000));
/// assert_eq!(tidemap_model::time::parse_time("2016-03-21T01:00:00+01:00"), Ok(1_458_518_400_000_000_000));
/// ```
pub fn parse_time(text: &str) -> Result<i64, InvalidTime> {
    match Decimal::parse(text) {
        Ok(decimal) if decimal.negative && decimal.digits != 0 => Err(InvalidTime::TooEarly(shown(text))),
        Ok(decimal) => decimal.scaled(9).map_err(|why| match why {
            InvalidDecimal::TooFine => InvalidTime::TooFine(shown(text)),
            InvalidDecimal::TooLarge | InvalidDecimal::Malformed => InvalidTime::TooLate(shown(text)),
        }),
        Err(InvalidDecimal::TooLarge) => Err(InvalidTime::TooLate(shown(text))),
        Err(_) => parse_rfc3339(text),
    }
}

fn parse_rfc3339(text: &str) -> Result<i64, InvalidTime> {
    let Ok(timestamp) = text.parse::<jiff::Timestamp>() else {
        let civil = text.parse::<jiff::civil::DateTime>().is_ok() || text.parse::<jiff::civil::Date>().is_ok();
        return Err(if civil { InvalidTime::NoOffset(shown(text)) } else { InvalidTime::Malformed(shown(text)) });
    };
    let nanos = timestamp.as_nanosecond();
    if is_beyond_clock(text, timestamp) {
        return Err(InvalidTime::Malformed(shown(text)));
    }
    if nanos < 0 {
        return Err(InvalidTime::TooEarly(shown(text)));
    }
    i64::try_from(nanos).map_err(|_| InvalidTime::TooLate(shown(text)))
}

/// Whether a text that jiff reads has a second 60 that is no leap second, or an offset of a day or more.
fn is_beyond_clock(text: &str, timestamp: jiff::Timestamp) -> bool {
    let Some((_, clock)) = text.split_once(['T', 't', ' ']) else { return false };
    let (clock, offset) = clock.split_at(clock.find(['+', '-', 'Z', 'z']).unwrap_or(clock.len()));
    let offset_hours = offset.get(1..3).and_then(|hours| hours.parse::<u8>().ok()).unwrap_or(0);
    let has_second_60 = clock.split(':').nth(2).is_some_and(|seconds| seconds.starts_with("60"));
    // The second 60 is read as the second before. Leap seconds are the last of a day in UTC.
    let is_last_of_day = timestamp.as_second().rem_euclid(86_400) == 86_399;
    offset_hours > 23 || (has_second_60 && !is_last_of_day)
}

/// Unix seconds in the shortest exact form: `1458518400`, `1458518400.25`.
pub fn format_secs(nanos: i64) -> String {
    let sign = if nanos < 0 { "-" } else { "" };
    let nanos = nanos.unsigned_abs();
    let per_sec = NANOS_PER_SEC.unsigned_abs();
    let (secs, fraction) = (nanos / per_sec, nanos % per_sec);
    if fraction == 0 {
        return format!("{sign}{secs}");
    }
    let text = format!("{sign}{secs}.{fraction:09}");
    text.trim_end_matches('0').to_owned()
}

/// The time as RFC 3339 in UTC, for people.
pub fn format_rfc3339(nanos: i64) -> String {
    jiff::Timestamp::from_nanosecond(i128::from(nanos)).map_or_else(|_| format_secs(nanos), |time| time.to_string())
}

/// Units of durations, longest first, in nanoseconds.
const UNITS: [(&str, i64); 6] = [
    ("w", 7 * 86_400 * NANOS_PER_SEC),
    ("d", 86_400 * NANOS_PER_SEC),
    ("h", 3_600 * NANOS_PER_SEC),
    ("m", 60 * NANOS_PER_SEC),
    ("ms", 1_000_000),
    ("s", NANOS_PER_SEC),
];

/// Reads a duration such as `90s`, `15m`, `1.5h`, `7d`, `2w` or `250ms`, in nanoseconds.
///
/// # Errors
/// [`InvalidDuration`], with the text.
pub fn parse_duration(text: &str) -> Result<i64, InvalidDuration> {
    let unit_at = text.find(|character: char| character.is_ascii_alphabetic()).unwrap_or(text.len());
    let (number, unit) = text.split_at(unit_at);
    let malformed = || InvalidDuration::Malformed(shown(text));
    let (_, unit_nanos) = UNITS.into_iter().find(|(name, _)| *name == unit).ok_or_else(malformed)?;
    let decimal = Decimal::parse(number).map_err(|_| malformed())?;
    if decimal.digits == 0 {
        return Err(InvalidDuration::Zero(shown(text)));
    }
    if decimal.negative {
        return Err(malformed());
    }
    // Multiplied before scaling, so that 0.0000000001d is read exactly.
    let product = decimal.digits.checked_mul(i128::from(unit_nanos)).ok_or(InvalidDuration::TooLong(shown(text)))?;
    Decimal { digits: product, ..decimal }.scaled(0).map_err(|why| match why {
        InvalidDecimal::TooLarge => InvalidDuration::TooLong(shown(text)),
        InvalidDecimal::TooFine | InvalidDecimal::Malformed => malformed(),
    })
}

/// A duration in the largest unit that divides it: `7d`, `36h`, `90s`, `0.5s`.
pub fn format_duration(nanos: i64) -> String {
    let unit = UNITS[1..4].iter().find(|(_, unit_nanos)| nanos != 0 && nanos % unit_nanos == 0);
    match unit {
        Some((name, unit_nanos)) => format!("{}{name}", nanos / unit_nanos),
        None => format!("{}s", format_secs(nanos)),
    }
}

#[cfg(test)]
mod tests;
