//! The days and the steps of ten minutes on which a simulated state lives, by the clocks of London.
//!
//! Invariant: steps follow each other every ten minutes of UTC, so the days on which clocks change have 138 or 150
//! steps, and a local hour is six steps, of which the first begins with the hour.

use std::ops::Range;

use jiff::civil::Date;
use tidemap_model::{LocalDay, UnknownZone, Zone};

/// The first day, a Monday.
pub(super) const FIRST: Date = jiff::civil::date(2025, 9, 1);
/// The first day, in days since 1970.
const FIRST_DAY: i32 = 20_332;
/// Length of a step in seconds.
pub(super) const STEP_SECS: i64 = 600;
/// Steps of an hour.
pub(super) const HOUR_STEPS: usize = 6;
pub(super) const SEC_NANOS: i64 = 1_000_000_000;
const DAY_SECS: i64 = 86_400;

/// A local day.
#[derive(Clone, Debug)]
pub(super) struct HabitDay {
    /// The local date.
    pub(super) date: Date,
    /// The number of the day, from 0.
    pub(super) number: usize,
    /// 0 for Monday to 6 for Sunday.
    pub(super) weekday: usize,
    /// The offset of local time from UTC at noon, hours.
    pub(super) noon_offset_hours: f64,
    /// The steps of the day.
    pub(super) steps: Range<usize>,
}

impl HabitDay {
    /// Whether the day is a Saturday or a Sunday.
    pub(super) fn is_weekend(&self) -> bool {
        self.weekday > 4
    }
}

/// A step of ten minutes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HabitStep {
    /// The begin of the step, nanoseconds UTC.
    pub(super) utc_nanos: i64,
    /// The UTC offset, in seconds.
    pub(super) offset_secs: i32,
    /// The number of its day.
    pub(super) day: usize,
    /// The hour of the local day at which it begins, with its fraction, in `[0,24)`.
    pub(super) hour: f64,
}

/// Days from [`FIRST`] on.
#[derive(Clone, Debug)]
pub(super) struct Calendar {
    /// The time zone.
    pub(super) zone: Zone,
    /// The days in order.
    pub(super) days: Vec<HabitDay>,
    /// The steps in order.
    pub(super) steps: Vec<HabitStep>,
}

impl Calendar {
    /// The days up to a date, which is included.
    pub(super) fn until(last: Date) -> Result<Calendar, UnknownZone> {
        let zone = Zone::named("Europe/London")?;
        let mut offsets = zone.offset_cache();
        let mut calendar = Calendar { zone: zone.clone(), days: Vec::new(), steps: Vec::new() };
        for (number, date) in FIRST.series(jiff::ToSpan::days(1)).take_while(|&date| date <= last).enumerate() {
            let local_day = LocalDay(FIRST_DAY.saturating_add(i32::try_from(number).unwrap_or(i32::MAX)));
            let midnight = |ahead: i32| zone.midnight_nanos(LocalDay(local_day.0.saturating_add(ahead)));
            let first = calendar.steps.len();
            let times = (midnight(0)..midnight(1)).step_by((STEP_SECS * SEC_NANOS) as usize);
            calendar.steps.extend(times.map(|utc_nanos| {
                let offset_secs = offsets.offset_secs(utc_nanos);
                let local_secs = (utc_nanos / SEC_NANOS + i64::from(offset_secs)).rem_euclid(DAY_SECS);
                HabitStep { utc_nanos, offset_secs, day: number, hour: local_secs as f64 / 3600.0 }
            }));
            calendar.days.push(HabitDay {
                date,
                number,
                weekday: local_day.weekday(),
                noon_offset_hours: f64::from(offsets.offset_secs(midnight(0) + DAY_SECS / 2 * SEC_NANOS)) / 3600.0,
                steps: first..calendar.steps.len(),
            });
        }
        Ok(calendar)
    }

    /// The number of a date's day; the number of days where it is later.
    pub(super) fn number_of(&self, date: Date) -> usize {
        self.days.iter().position(|day| day.date >= date).unwrap_or(self.days.len())
    }

    /// The hour of the week of a step, 0 for Monday's first.
    pub(super) fn hour_of_week(&self, step: usize) -> usize {
        let HabitStep { day, hour, .. } = self.steps[step];
        self.days[day].weekday * 24 + hour as usize
    }
}
