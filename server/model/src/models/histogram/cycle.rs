//! The cycle of a histogram, and the bin of a local civil time.
//!
//! Bins are computed in integer nanoseconds. Invariant: every time has a bin, and bins differ in length by at most 1
//! ns.

use crate::civil::NANOS_PER_SEC;

pub(super) const HOUR_NANOS: i64 = 3600 * NANOS_PER_SEC;
const DAY_NANOS: i64 = 24 * HOUR_NANOS;
const WEEK_NANOS: i64 = 7 * DAY_NANOS;
/// 1970-01-01 was a Thursday; weeks begin on Monday.
const MONDAY_TO_EPOCH_NANOS: i64 = 3 * DAY_NANOS;

/// Hours of a day.
pub(super) const DAY_HOURS: usize = 24;
/// Hours of a week.
pub(super) const WEEK_HOURS: usize = 168;

/// The cycle of a histogram; all in local civil time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum HistogramCycle {
    /// All days are alike, from midnight.
    Day,
    /// All weeks are alike, from Monday, midnight.
    Week,
    /// Two kinds of days, Monday to Friday and Saturday to Sunday, each from midnight.
    WeekdayWeekend,
}

impl HistogramCycle {
    /// All cycles.
    pub const ALL: [HistogramCycle; 3] = [HistogramCycle::Day, HistogramCycle::Week, HistogramCycle::WeekdayWeekend];

    /// The cycle of a name; `None` for any other name.
    pub fn named(name: &str) -> Option<HistogramCycle> {
        HistogramCycle::ALL.into_iter().find(|cycle| cycle.name() == name)
    }

    /// The name of the cycle in the name of a model and in protocols.
    pub fn name(self) -> &'static str {
        match self {
            HistogramCycle::Day => "day",
            HistogramCycle::Week => "week",
            HistogramCycle::WeekdayWeekend => "weekend",
        }
    }

    /// The default number of bins: hours.
    pub fn usual_bins(self) -> u32 {
        // At most 168.
        self.hours() as u32
    }

    /// The maximum number of bins, one a minute: 1440 for the day, 10,080 for the week, 1440 each for weekday and
    /// weekend.
    pub fn max_bins(self) -> usize {
        match self {
            HistogramCycle::Day | HistogramCycle::WeekdayWeekend => 1440,
            HistogramCycle::Week => 10_080,
        }
    }

    /// Number of circles of bins.
    pub(super) fn runs(self) -> usize {
        match self {
            HistogramCycle::Day | HistogramCycle::Week => 1,
            HistogramCycle::WeekdayWeekend => 2,
        }
    }

    /// Hours of one circle.
    pub(super) fn hours(self) -> usize {
        match self {
            HistogramCycle::Day | HistogramCycle::WeekdayWeekend => DAY_HOURS,
            HistogramCycle::Week => WEEK_HOURS,
        }
    }

    /// The bin of a local civil time where each circle has `bins` of them.
    pub(super) fn bin(self, bins: usize, civil_nanos: i64) -> usize {
        match self {
            HistogramCycle::Day => part(civil_nanos.rem_euclid(DAY_NANOS), DAY_NANOS, bins),
            HistogramCycle::Week => part(week_nanos(civil_nanos), WEEK_NANOS, bins),
            HistogramCycle::WeekdayWeekend => {
                let of_day = part(civil_nanos.rem_euclid(DAY_NANOS), DAY_NANOS, bins);
                if is_weekend(hour_of_week(civil_nanos)) { bins + of_day } else { of_day }
            }
        }
    }
}

/// The hour of the local week, 0..168, from Monday, midnight.
pub(super) fn hour_of_week(civil_nanos: i64) -> usize {
    (week_nanos(civil_nanos) / HOUR_NANOS) as usize
}

/// Whether an hour of the week is on Saturday or Sunday.
pub(super) fn is_weekend(hour_of_week: usize) -> bool {
    hour_of_week >= 5 * DAY_HOURS
}

/// The number of a local civil hour, from 1970-01-01T00:00 local.
pub(super) fn civil_hour(civil_nanos: i64) -> i64 {
    civil_nanos.div_euclid(HOUR_NANOS)
}

/// The hour of the week of a civil hour's number.
pub(super) fn hour_of_week_of(civil_hour: i64) -> usize {
    (civil_hour + 3 * DAY_HOURS as i64).rem_euclid(WEEK_HOURS as i64) as usize
}

/// Nanoseconds since Monday, midnight.
fn week_nanos(civil_nanos: i64) -> i64 {
    // The time is reduced first, because the sum could overflow.
    (civil_nanos.rem_euclid(WEEK_NANOS) + MONDAY_TO_EPOCH_NANOS) % WEEK_NANOS
}

/// The index of the part, of `bins` equal parts of a length, that contains a position.
fn part(place_nanos: i64, length_nanos: i64, bins: usize) -> usize {
    ((place_nanos as u128 * bins as u128) / length_nanos as u128) as usize
}
