//! Decides how many components of a state of two values are used, and whether its errors have risen.
//!
//! The rules of [`StateModel`](super::StateModel) without its models and tables, for states that are kept in large
//! numbers: some hundred bytes each. Invariant: on the same readings the supported components, the gains and the alarm
//! are those of a state that has the spectral model alone.

use super::alternatives::{ALARM_DAYS, KEPT_AT_CHANGE};
use std::array;

use crate::{
    InvalidParts, LocalDay, ORDER_MAX, OrderErrors, Periodicities, SpectralModel,
    fields::{NOT_NEGATIVE, StoredFields, Visitor},
    models::{
        ChangeAlarm, ChangeAlarmParts, DependenceSums, OrderGains, OrderGainsParts, half_square_of_probabilities,
        supported_order_of,
    },
};

#[cfg(test)]
mod tests;

/// Support, gains and change alarm of a state of two values.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct OrderWatch {
    gains: OrderGains,
    alarm: ChangeAlarm,
    change_rate_sum: f64,
    changes: u32,
    last: Option<bool>,
    supported: u8,
}

/// The parts of an [`OrderWatch`], for storage.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct OrderWatchParts {
    /// Daily gains of the chosen orders.
    pub gains: OrderGainsParts,
    /// The change alarm.
    pub alarm: ChangeAlarmParts,
    /// Sum over pairs of successive learned readings of |change| / time between, per second; the two values are 0 and
    /// 1.
    pub change_rate_sum: f64,
    /// Number of changes between successive learned readings.
    pub changes: u32,
    /// Whether the newest learned reading is the higher value; `None` before the first.
    pub last: Option<bool>,
    /// Number of supported components.
    pub supported: u8,
}

impl StoredFields for OrderWatchParts {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        self.gains.field(1, visitor)?;
        visitor.messages(2, "change alarm", array::from_mut(&mut self.alarm))?;
        visitor.number(3, "rate of changes", NOT_NEGATIVE, &mut self.change_rate_sum)?;
        visitor.integer(4, "newest reading", &mut self.last)?;
        visitor.integer(5, "supported order", &mut self.supported)?;
        visitor.integer(6, "number of changes", &mut self.changes)
    }
}

/// The errors of a day's predictions, made before the day was learned.
#[derive(Clone, Copy, Debug)]
pub struct DayScores<'a> {
    /// Errors by the criterion of the map, summed over the day, per order.
    pub errors: &'a [f64; ORDER_MAX + 1],
    /// Squared errors, summed over the day, per order.
    pub squared: &'a [f64; ORDER_MAX + 1],
    /// Number of predictions, above 0.
    pub scored: u64,
    /// The order that was in force.
    pub order: usize,
    /// The squared error that counts as 1 for the alarm: the squared difference of the two values.
    pub unit: f64,
}

/// The data from which the support of components is determined, beside the model.
#[derive(Clone, Copy, Debug)]
pub struct LearnedReadings {
    /// Number of learned readings, each newer than the one before, less one.
    pub pairs: u64,
    /// Time from the first to the last, in seconds.
    pub span_secs: f64,
    /// Number of single hours with a reading; fractional with forgetting.
    pub observed_hours: f64,
    /// The share of the higher value.
    pub mean: f64,
    /// The difference of the two values.
    pub difference: f64,
    /// The weight of the readings over their number, below 1 with forgetting.
    pub remembered: f64,
}

impl OrderWatch {
    /// A watch of a state that has had one value so far; `None`: no value.
    pub fn of_constant(value: Option<bool>) -> OrderWatch {
        OrderWatch { last: value, ..OrderWatch::default() }
    }

    /// Records the errors of a day with the order that was best before it, and watches them for a change of routine.
    pub fn score(
        &mut self,
        day: LocalDay,
        periodicities: &Periodicities,
        errors: &mut OrderErrors,
        scores: DayScores<'_>,
    ) {
        let DayScores { squared, scored, order, unit, .. } = scores;
        let best = errors.best();
        errors.record(day, scores.errors);
        if OrderGains::apply_to(periodicities) {
            self.gains.record(best, squared, scored);
        }
        if self.alarm.alarm_day().is_some_and(|alarm_day| day.0 - alarm_day.0 >= ALARM_DAYS) {
            self.alarm.reset();
        }
        let was_ringing = self.alarm.alarm_day().is_some();
        let error = squared.get(order.min(ORDER_MAX)).map_or(0.0, |sum| sum / scored.max(1) as f64 / unit);
        if self.alarm.observe(day, error, scored) && !was_ringing {
            // The errors are of another routine.
            errors.fade(KEPT_AT_CHANGE);
            self.gains.fade(KEPT_AT_CHANGE);
        }
    }

    /// Adds the changes among some newer readings: their number, the sum over the changes of 1 / time between the
    /// readings, per second, and the value after them.
    pub fn learn(&mut self, changes: u32, change_rate_sum: f64, last: Option<bool>) {
        self.changes = self.changes.saturating_add(changes);
        self.change_rate_sum += change_rate_sum;
        self.last = last.or(self.last);
    }

    /// Forgetting: lowers the weight of the gains so far.
    pub fn fade(&mut self, factor: f64) {
        self.gains.fade(factor);
    }

    /// Determines which components of a newly trained model are supported.
    pub fn support(&mut self, model: &SpectralModel, periodicities: &Periodicities, readings: LearnedReadings) {
        let LearnedReadings { pairs, span_secs, observed_hours, mean, difference, remembered } = readings;
        let sums = DependenceSums {
            pairs,
            change_rate_sum: self.change_rate_sum,
            span_secs,
            mean,
            observed_hours,
            changes: f64::from(self.changes),
        };
        let square = difference * difference;
        let half_square = |change: f64| square * half_square_of_probabilities(change);
        let variance = square * mean * (1.0 - mean);
        // At most 15.
        self.supported = supported_order_of(model, periodicities, &sums, (half_square, variance), remembered) as u8;
    }

    /// Number of supported components: those that noise would not show, or all where the choice of orders has made
    /// predictions better day after day.
    pub fn supported_order(&self) -> usize {
        if self.gains.is_significant() { ORDER_MAX } else { usize::from(self.supported) }
    }

    /// Whether the newest learned reading is the higher value; `None` before the first.
    pub fn last(&self) -> Option<bool> {
        self.last
    }

    /// The change alarm, which rings when recent errors depart from earlier ones.
    pub fn alarm(&self) -> &ChangeAlarm {
        &self.alarm
    }

    /// The parts to store.
    pub fn to_parts(&self) -> OrderWatchParts {
        OrderWatchParts {
            gains: self.gains.to_parts(),
            alarm: self.alarm.to_parts(),
            change_rate_sum: self.change_rate_sum,
            changes: self.changes,
            last: self.last,
            supported: self.supported,
        }
    }

    /// A watch from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is outside its range.
    pub fn from_parts(parts: OrderWatchParts) -> Result<OrderWatch, InvalidParts> {
        let OrderWatchParts { gains, alarm, change_rate_sum, changes, last, supported } = parts;
        InvalidParts::check("rate of changes", change_rate_sum, 0.0..=f64::MAX)?;
        if usize::from(supported) > ORDER_MAX {
            return Err(InvalidParts::OrderTooHigh { found: supported.into() });
        }
        let (gains, alarm) = (OrderGains::from_parts(gains)?, ChangeAlarm::from_parts(alarm)?);
        Ok(OrderWatch { gains, alarm, change_rate_sum, changes, last, supported })
    }
}
