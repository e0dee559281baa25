//! Local civil time: which UTC offset, which date and which midnight a moment has in a zone.
//!
//! People live by the wall clock, so phases and days are local. Zones come from jiff's bundled
//! database alone, so that the same data gives the same model on every machine.
//! Invariant: times are i64 nanoseconds since 1970 and saturate at 0 and `i64::MAX`.

use std::fmt;

use jiff::Timestamp;
use jiff::civil::Time;
use jiff::tz::{AmbiguousOffset, Offset, TimeZone, TimeZoneDatabase};

#[cfg(test)]
mod tests;

pub(crate) use crate::time::NANOS_PER_SEC;
const SECS_PER_DAY: i64 = 86_400;
const NANOS_PER_DAY: i64 = SECS_PER_DAY * NANOS_PER_SEC;

/// A local date, as days since 1970-01-01; shown as `YYYY-MM-DD`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LocalDay(pub i32);

impl LocalDay {
    /// The date of a local civil time in nanoseconds since 1970-01-01T00:00 local.
    pub fn of_civil_nanos(civil_nanos: i64) -> LocalDay {
        // |i64| nanoseconds are at most 106,752 days.
        LocalDay(civil_nanos.div_euclid(NANOS_PER_DAY) as i32)
    }

    /// The date written as `YYYY-MM-DD`; `None` where there is no such date.
    pub fn parse(text: &str) -> Option<LocalDay> {
        let date: jiff::civil::Date = text.parse().ok()?;
        // Only the date, in one spelling.
        let day = i32::try_from(date.duration_since(jiff::civil::date(1970, 1, 1)).as_secs() / SECS_PER_DAY).ok()?;
        Some(LocalDay(day)).filter(|day| day.to_string() == text)
    }

    /// The day of the week: 0 for Monday to 6 for Sunday.
    pub fn weekday(self) -> usize {
        // 1970-01-01 was a Thursday. Between 0 and 6.
        (i64::from(self.0) + 3).rem_euclid(7) as usize
    }

    /// Year, month from 1, and day of the month from 1.
    pub fn date(self) -> (i64, u8, u8) {
        // Gregorian date from a day number in eras of 400 years that begin on 1 March, so that the
        // leap day comes last (H. Hinnant, "chrono-compatible low-level date algorithms").
        let days = i64::from(self.0) + 719_468;
        let era = days.div_euclid(146_097);
        let day_of_era = days.rem_euclid(146_097);
        let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
        let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
        let shifted_month = (5 * day_of_year + 2) / 153;
        let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
        let month = if shifted_month < 10 { shifted_month + 3 } else { shifted_month - 9 };
        // Month and day are at most 12 and 31.
        (year_of_era + era * 400 + i64::from(month <= 2), month as u8, day as u8)
    }
}

impl fmt::Display for LocalDay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (year, month, day) = self.date();
        write!(f, "{year:04}-{month:02}-{day:02}")
    }
}

/// The zone is not in the bundled IANA database.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown time zone {name:?}; expected an IANA name such as Europe/London")]
pub struct UnknownZone {
    /// The requested name.
    pub name: String,
}

/// The instants of a civil time: nanoseconds UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LocalInstant {
    /// The civil time occurs once, at this instant.
    Once(i64),
    /// The civil time occurs twice, because clocks were set back between the two instants.
    Twice(i64, i64),
    /// The civil time does not occur, because clocks were set forward over it.
    Never,
}

/// An IANA time zone; two zones are equal if their names are equal.
#[derive(Clone)]
pub struct Zone {
    name: String,
    rules: TimeZone,
}

impl Zone {
    /// The zone of that IANA name in the bundled database, letter case aside.
    ///
    /// # Errors
    /// [`UnknownZone`] where the database has no such name.
    pub fn named(name: &str) -> Result<Zone, UnknownZone> {
        let unknown = || UnknownZone { name: name.to_owned() };
        // Not `TimeZone::get`: that reads /usr/share/zoneinfo once any crate enables the feature.
        let rules = TimeZoneDatabase::bundled().get(name).map_err(|_| unknown())?;
        match rules.iana_name() {
            Some(iana) if !rules.is_unknown() => Ok(Zone { name: iana.to_owned(), rules: rules.clone() }),
            _ => Err(unknown()),
        }
    }

    /// Coordinated universal time.
    pub fn utc() -> Zone {
        Zone { name: "UTC".to_owned(), rules: TimeZone::UTC }
    }

    /// The IANA name in the spelling of the database.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The UTC offset at a moment, in seconds, east positive.
    pub fn offset_secs(&self, utc_nanos: i64) -> i32 {
        self.rules.to_offset(timestamp(utc_nanos)).seconds()
    }

    /// The instants of a civil time of the zone, such as `2025-03-30T02:30` or `2025-03-30 02:30:00`; a date alone
    /// means its midnight. `None` if the text is not a civil time, or the time is before 1970 or after 2262.
    pub fn local_instant(&self, text: &str) -> Option<LocalInstant> {
        let date = || text.parse::<jiff::civil::Date>().ok().map(|date| date.to_datetime(Time::midnight()));
        let civil = text.parse::<jiff::civil::DateTime>().ok().or_else(date)?;
        let nanos = |offset: Offset| {
            let timestamp = offset.to_timestamp(civil).ok()?;
            i64::try_from(timestamp.as_nanosecond()).ok().filter(|nanos| *nanos >= 0)
        };
        Some(match self.rules.to_ambiguous_timestamp(civil).offset() {
            AmbiguousOffset::Unambiguous { offset } => LocalInstant::Once(nanos(offset)?),
            AmbiguousOffset::Fold { before, after } => LocalInstant::Twice(nanos(before)?, nanos(after)?),
            AmbiguousOffset::Gap { .. } => LocalInstant::Never,
        })
    }

    /// The local date of a moment.
    pub fn day_of(&self, utc_nanos: i64) -> LocalDay {
        let utc_nanos = utc_nanos.max(0);
        LocalDay::of_civil_nanos(utc_nanos.saturating_add(i64::from(self.offset_secs(utc_nanos)) * NANOS_PER_SEC))
    }

    /// The first instant of a local date, UTC in nanoseconds since 1970.
    ///
    /// Where clocks jump over midnight, it is the moment of the jump. Where midnight occurs twice, it is the first. For
    /// a date that the zone skipped altogether, it is the start of the next date.
    pub fn midnight_nanos(&self, day: LocalDay) -> i64 {
        let utc_midnight_secs = i64::from(day.0) * SECS_PER_DAY;
        let Ok(utc_midnight) = Timestamp::from_second(utc_midnight_secs) else {
            return if day.0 < 0 { 0 } else { i64::MAX };
        };
        let midnight = Offset::UTC.to_datetime(utc_midnight).date().to_datetime(Time::midnight());
        let first_instant_secs = match self.rules.to_ambiguous_timestamp(midnight).offset() {
            AmbiguousOffset::Unambiguous { offset } => utc_midnight_secs - i64::from(offset.seconds()),
            AmbiguousOffset::Fold { before, .. } => utc_midnight_secs - i64::from(before.seconds()),
            AmbiguousOffset::Gap { before, .. } => {
                // With the old offset, midnight is at or after the jump that skips it, and before any other jump.
                let by_old_offset = utc_midnight_secs - i64::from(before.seconds());
                self.last_change_secs(by_old_offset).unwrap_or(by_old_offset)
            }
        };
        first_instant_secs.saturating_mul(NANOS_PER_SEC).max(0)
    }

    /// The last change of offset at or before a second.
    fn last_change_secs(&self, utc_secs: i64) -> Option<i64> {
        // `preceding` excludes the moment itself.
        let after = Timestamp::from_second(utc_secs.saturating_add(1)).ok()?;
        self.rules.preceding(after).next().map(|change| change.timestamp().as_second())
    }

    /// A cache that returns [`Zone::offset_secs`] in constant time while the moments lie between the same two changes
    /// of offset.
    pub fn offset_cache(&self) -> OffsetCache {
        OffsetCache { zone: self.clone(), from_nanos: 0, until_nanos: 0, offset_secs: 0 }
    }
}

impl PartialEq for Zone {
    fn eq(&self, other: &Zone) -> bool {
        self.name == other.name
    }
}

impl Eq for Zone {}

impl fmt::Debug for Zone {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Zone").field(&self.name).finish()
    }
}

/// Offsets of one zone, with the interval between two changes remembered; see [`Zone::offset_cache`].
#[derive(Clone, Debug)]
pub struct OffsetCache {
    zone: Zone,
    from_nanos: i64,
    /// First moment after the interval; the interval is empty at first.
    until_nanos: i64,
    offset_secs: i32,
}

impl OffsetCache {
    /// The UTC offset at a moment, in seconds, east positive; equals [`Zone::offset_secs`].
    pub fn offset_secs(&mut self, utc_nanos: i64) -> i32 {
        let utc_nanos = utc_nanos.max(0);
        if utc_nanos < self.from_nanos || utc_nanos >= self.until_nanos {
            self.remember(utc_nanos);
        }
        self.offset_secs
    }

    fn remember(&mut self, utc_nanos: i64) {
        self.offset_secs = self.zone.offset_secs(utc_nanos);
        let from_secs = self.zone.last_change_secs(utc_nanos.div_euclid(NANOS_PER_SEC));
        self.from_nanos = from_secs.map_or(0, |secs| secs.saturating_mul(NANOS_PER_SEC));
        let next_change = self.zone.rules.following(timestamp(utc_nanos)).next();
        self.until_nanos =
            next_change.map_or(i64::MAX, |change| change.timestamp().as_second().saturating_mul(NANOS_PER_SEC));
    }
}

/// Every i64 of nanoseconds is within jiff's range; times before 1970 count as 1970.
fn timestamp(utc_nanos: i64) -> Timestamp {
    Timestamp::from_nanosecond(i128::from(utc_nanos.max(0))).unwrap_or(Timestamp::UNIX_EPOCH)
}
