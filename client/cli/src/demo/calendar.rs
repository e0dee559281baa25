//! The dates of the demo.
//!
//! Invariant: dates are fixed, so that a seed always shows the same picture. They are in the past, because a daemon
//! delays data from the future; they include a change to summer time (30 March), and "tomorrow" is a working day.

use anyhow::Context as _;
use jiff::{
    Span, Timestamp,
    civil::{Date, date},
    tz::{TimeZone, TimeZoneDatabase},
};

/// The day to predict, a Tuesday; the last week observed ends as it begins.
const TOMORROW: Date = date(2025, 4, 15);
/// A day off after it.
const SATURDAY: Date = date(2025, 4, 19);

/// The observed weeks, and the predicted days.
pub(super) struct Calendar {
    zone: TimeZone,
    weeks: u32,
}

impl Calendar {
    pub(super) fn new(zone: &str, weeks: u32) -> anyhow::Result<Self> {
        let zone = TimeZoneDatabase::bundled().get(zone).with_context(|| format!("time zone {zone}"))?;
        Ok(Self { zone, weeks })
    }

    /// Start of the observations, in nanoseconds UTC.
    pub(super) fn start(&self) -> i64 {
        self.week_end(0)
    }

    /// The end of a week of observations, counted from 1, in nanoseconds UTC.
    pub(super) fn week_end(&self, week: u32) -> i64 {
        let weeks = i64::from(self.weeks) - i64::from(week);
        self.midnight(TOMORROW.saturating_sub(Span::new().weeks(weeks)))
    }

    /// Start of the local date of a time, both in nanoseconds UTC.
    pub(super) fn midnight_before(&self, utc_nanos: i64) -> i64 {
        self.midnight(self.local_date(utc_nanos))
    }

    /// The working day to predict, and the day off.
    pub(super) fn days(&self) -> [(String, Vec<i64>); 2] {
        [TOMORROW, SATURDAY].map(|day| (day.strftime("%A %-d %B %Y").to_string(), self.samples(self.midnight(day))))
    }

    /// The last local date before a time in nanoseconds UTC, as text.
    pub(super) fn last_day(&self, utc_nanos: i64) -> String {
        self.local_date(utc_nanos - 1).strftime("%a %-d %b").to_string()
    }

    /// Times over 24 hours, five minutes apart, each in the middle of its five minutes.
    pub(super) fn samples(&self, from_nanos: i64) -> Vec<i64> {
        const STEP_NANOS: i64 = 5 * 60 * 1_000_000_000;
        (0..24 * 12).map(|step| from_nanos + step * STEP_NANOS + STEP_NANOS / 2).collect()
    }

    fn local_date(&self, utc_nanos: i64) -> Date {
        let time = Timestamp::from_nanosecond(i128::from(utc_nanos)).unwrap_or(Timestamp::UNIX_EPOCH);
        self.zone.to_datetime(time).date()
    }

    fn midnight(&self, date: Date) -> i64 {
        let nanos = date.to_zoned(self.zone.clone()).map_or(0, |start| start.timestamp().as_nanosecond());
        i64::try_from(nanos).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weeks_end_at_local_midnight_before_a_working_day() -> anyhow::Result<()> {
        let calendar = Calendar::new("Europe/London", 6)?;
        let end = calendar.week_end(6);
        // 23:00 UTC in summer, midnight in winter.
        assert_eq!(end, 1_744_671_600 * 1_000_000_000);
        assert_eq!(calendar.start(), 1_741_046_400 * 1_000_000_000);
        assert_eq!(calendar.last_day(end), "Mon 14 Apr");
        assert_eq!(calendar.midnight_before(end - 1), end - 24 * 3600 * 1_000_000_000);
        assert_eq!(calendar.days().map(|(name, _)| name), ["Tuesday 15 April 2025", "Saturday 19 April 2025"]);
        Ok(())
    }
}
