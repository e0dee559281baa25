//! The change alarm: rings when a model's recent errors depart from their history.
//!
//! A one-sided cumulative sum (E. S. Page, "Continuous Inspection Schemes", Biometrika 1954) of each day's error, in
//! standard deviations above the usual error of such days. Lower errors than usual never ring it. Invariant: the sum is
//! finite and not negative, and once the alarm rings it rings until it is reset.

use std::slice;

use crate::{
    InvalidParts, LocalDay,
    fields::{NOT_NEGATIVE, StoredFields, Visitor},
};

#[cfg(test)]
mod tests;

/// The time constant, in days, with which older days fade.
const MEMORY_DAYS: f64 = 60.0;
/// Days before the alarm can ring: a standard deviation of fewer is too uncertain.
const DAYS_MIN: f64 = 14.0;
/// Days of a kind (weekday, weekend) before one of that kind can add to the sum.
const DAYS_OF_KIND_MIN: f64 = 4.0;
/// A day adds its standard score less this to the sum …
const SLACK: f64 = 0.75;
/// … but no score above this: a single unusual day is not a change of routine.
const SCORE_MAX: f64 = 3.5;
/// The sum at which the alarm rings: at least four unusual days.
const THRESHOLD: f64 = 8.5;
/// Root mean squared errors that differ by less than this count as equal.
const DEVIATION_MIN: f64 = 0.02;
/// While the standard deviation rests on n days it may be too low; it is widened by 1 + this/n.
const WIDENING_DAYS: f64 = 3.0;

/// The alarm that rings when the errors of a state's predictions have risen above their history.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ChangeAlarm {
    parts: ChangeAlarmParts,
}

/// The parts of a [`ChangeAlarm`], for storage.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ChangeAlarmParts {
    /// History of weekdays, and of Saturdays and Sundays.
    pub kinds: [DayErrors; 2],
    /// Faded mean number of scored observations of a day.
    pub typical_observations: f64,
    /// The cumulative sum, in standard deviations, at least 0.
    pub sum: f64,
    /// The last local day added.
    pub last_day: Option<LocalDay>,
    /// The day on which the alarm rang, if it rings.
    pub alarm_day: Option<LocalDay>,
}

impl StoredFields for ChangeAlarmParts {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        let numbers = self.kinds.each_mut().map(|kind| [&mut kind.days, &mut kind.mean, &mut kind.variance]);
        let [[one, two, three], [four, five, six]] = numbers;
        let numbers = [one, two, three, four, five, six];
        visitor.lists(1, "errors of the days of a kind", NOT_NEGATIVE, &mut numbers.map(slice::from_mut))?;
        visitor.number(2, "typical observations", NOT_NEGATIVE, &mut self.typical_observations)?;
        visitor.number(3, "alarm sum", NOT_NEGATIVE, &mut self.sum)?;
        visitor.integer(4, "last day of an alarm", &mut self.last_day)?;
        visitor.integer(5, "day of an alarm", &mut self.alarm_day)
    }
}

/// The history of the errors of one kind of days.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct DayErrors {
    /// Faded number of days.
    pub days: f64,
    /// Faded mean of the root mean squared error of a day.
    pub mean: f64,
    /// Faded variance of the root mean squared error of a day.
    pub variance: f64,
}

impl ChangeAlarm {
    /// Adds a local day: the mean squared error of `observations` predictions made before the day was learned. Returns
    /// whether the alarm rings.
    ///
    /// The error is that of a state in `[0,1]`; for others the caller divides it by the variance of the values first.
    /// The root of the error is compared with the history of days of that kind, weekdays or weekend, so that weekends
    /// that are easier to predict are not a change; both kinds use the larger of their standard deviations. A day with
    /// fewer observations than usual counts less. The first 14 days cannot ring. A day changes nothing if it has no
    /// observations, is not after the last one, or has an error that is negative or not finite.
    pub fn observe(&mut self, day: LocalDay, mse: f64, observations: u64) -> bool {
        let is_new = self.parts.last_day.is_none_or(|last_day| day > last_day);
        if is_new && observations > 0 && mse.is_finite() && mse >= 0.0 {
            self.parts.last_day = Some(day);
            self.take_in(day, mse.sqrt(), observations as f64);
            debug_assert!(self.parts.sum.is_finite() && self.parts.sum >= 0.0, "{}", self.parts.sum);
        }
        self.is_ringing()
    }

    fn take_in(&mut self, day: LocalDay, error: f64, observations: f64) {
        let parts = &mut self.parts;
        let kind = usize::from(is_weekend(day));
        let all_days = parts.kinds[0].days + parts.kinds[1].days;
        parts.typical_observations += (observations - parts.typical_observations) / (all_days + 1.0).min(MEMORY_DAYS);
        let weight = (observations / parts.typical_observations).min(1.0);

        let deviation = deviation(&parts.kinds);
        let history = &mut parts.kinds[kind];
        let mut score = 0.0;
        if all_days >= DAYS_MIN && history.days >= DAYS_OF_KIND_MIN {
            score = ((error - history.mean) / deviation).min(SCORE_MAX);
            // The term is weighted as a whole. The error of a day with few observations varies more in equal
            // proportion, so the sum climbs to the threshold by chance as rarely as on full days.
            parts.sum = (parts.sum + weight * (score - SLACK)).max(0.0);
        }
        if parts.alarm_day.is_none() && parts.sum > THRESHOLD {
            parts.alarm_day = Some(day);
        }
        // An error far above the history enters it as the highest error that still scores.
        let error = if score >= SCORE_MAX { history.mean + SCORE_MAX * deviation } else { error };
        history.add(error, weight);
    }

    /// Whether the alarm rings.
    pub(crate) fn is_ringing(&self) -> bool {
        self.parts.alarm_day.is_some()
    }

    /// The day on which the alarm rang, if it rings.
    pub fn alarm_day(&self) -> Option<LocalDay> {
        self.parts.alarm_day
    }

    /// The mean squared error so far of days of the kind of `day`, weekday or weekend: the square of the mean of its
    /// root, plus the variance of the root. If there is none, the error of the other kind of days; `None` without days.
    pub fn usual_mse(&self, day: LocalDay) -> Option<f64> {
        let kind = usize::from(is_weekend(day));
        let known = [kind, 1 - kind].map(|kind| self.parts.kinds[kind]).into_iter().find(|kind| kind.days > 0.0)?;
        Some(known.mean * known.mean + known.variance)
    }

    /// Silences the alarm and begins a new history: errors from before the change no longer count. Days up to the last
    /// one added stay closed.
    pub fn reset(&mut self) {
        self.parts = ChangeAlarmParts { last_day: self.parts.last_day, ..ChangeAlarmParts::default() };
    }

    /// The parts to store.
    pub fn to_parts(&self) -> ChangeAlarmParts {
        self.parts
    }

    /// An alarm from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is negative or not finite.
    pub fn from_parts(parts: ChangeAlarmParts) -> Result<ChangeAlarm, InvalidParts> {
        for kind in &parts.kinds {
            InvalidParts::check("days of errors", kind.days, 0.0..=f64::MAX)?;
            InvalidParts::check("mean daily error", kind.mean, 0.0..=f64::MAX)?;
            InvalidParts::check("variance of daily errors", kind.variance, 0.0..=f64::MAX)?;
        }
        InvalidParts::check("typical observations", parts.typical_observations, 0.0..=f64::MAX)?;
        InvalidParts::check("alarm sum", parts.sum, 0.0..=f64::MAX)?;
        Ok(ChangeAlarm { parts })
    }
}

impl DayErrors {
    /// Adds a day's error; fades the others by its weight.
    fn add(&mut self, error: f64, weight: f64) {
        self.days = (self.days + weight).min(MEMORY_DAYS);
        let share = (weight / self.days).min(1.0);
        let from_mean = error - self.mean;
        self.mean += share * from_mean;
        // West's update of a weighted variance. Huge errors stop at the largest number.
        self.variance = ((1.0 - share) * (self.variance + share * from_mean * from_mean)).min(f64::MAX);
    }
}

/// The standard deviation that a day's error is compared with: that of the kind of day that varies more.
fn deviation(kinds: &[DayErrors; 2]) -> f64 {
    let widened = |kind: &DayErrors| kind.variance.sqrt() * (1.0 + WIDENING_DAYS / kind.days.max(1.0));
    kinds.iter().filter(|kind| kind.days >= DAYS_OF_KIND_MIN).map(widened).fold(DEVIATION_MIN, f64::max)
}

fn is_weekend(day: LocalDay) -> bool {
    // 1970-01-01 was a Thursday.
    (day.0.rem_euclid(7) + 3) % 7 >= 5
}
