//! Whether the chosen order has made predictions better day after day.
//!
//! The unit is the day, because errors within a day depend on each other. The recorded errors are of predictions made
//! before the day was learned, with the order that was best until then, so this is validation of the choice on held-out
//! data (T-RO section IV.B). Invariant: sums are finite.

use crate::{
    InvalidParts, ORDER_MAX, Periodicities,
    fields::{FINITE, Visitor},
};

/// A gain counts if its mean over days exceeds this many of its standard errors.
const STANDARD_ERRORS: f64 = 2.5;
/// With fewer days a standard error is meaningless.
const DAYS_MIN: f64 = 7.0;
/// The upper limit of mean squared errors.
const ERROR_MAX: f64 = 1e100;
/// Gains at a lead time of one day are evidence only if no candidate period is longer than this. Slow components follow
/// the last days of a state that keeps its value for weeks, and thus predict the next day well without any rhythm.
const PERIOD_MAX_SECS: f64 = 8.0 * 86_400.0;

/// Daily gains of the order that was best until then over order 0.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct OrderGains {
    parts: OrderGainsParts,
}

/// The parts of [`OrderGains`], for storage.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct OrderGainsParts {
    /// Days recorded; fractional with forgetting.
    pub days: f64,
    /// The sum over days of the mean squared error of order 0 minus that of the order that was best until then.
    pub sum: f64,
    /// The sum of the squares of these differences.
    pub squares: f64,
}

impl OrderGainsParts {
    /// Visits the three numbers as one field, which is absent before the first day.
    pub(crate) fn field<V: Visitor>(&mut self, tag: u32, visitor: &mut V) -> Result<(), V::Refused> {
        let known = Some(*self).filter(|parts| *parts != OrderGainsParts::default());
        let mut numbers = known.map(|OrderGainsParts { days, sum, squares }| [days, sum, squares]);
        visitor.list(tag, "gains of the orders", FINITE, &mut numbers)?;
        let [days, sum, squares] = numbers.unwrap_or_default();
        *self = OrderGainsParts { days, sum, squares };
        Ok(())
    }
}

impl OrderGains {
    /// Whether gains of a day are evidence for a rhythm at all: if no candidate period exceeds eight days.
    pub fn apply_to(periodicities: &Periodicities) -> bool {
        (0..periodicities.len()).all(|k| periodicities.period_secs(k) <= PERIOD_MAX_SECS)
    }

    /// Adds a day: the summed squared errors of each order over its `scored` observations, from
    /// [`UpdateOutcome`](crate::UpdateOutcome), and the order that was best before the day. A day of order 0, without
    /// observations, or with an error that is NaN, changes nothing.
    pub fn record(&mut self, order: usize, squared_errors: &[f64; ORDER_MAX + 1], scored: u64) {
        let order = order.min(ORDER_MAX);
        if order == 0 || scored == 0 || squared_errors[0].is_nan() || squared_errors[order].is_nan() {
            return;
        }
        let mean = |sum: f64| (sum / scored as f64).clamp(0.0, ERROR_MAX);
        let gain = mean(squared_errors[0]) - mean(squared_errors[order]);
        self.parts.days += 1.0;
        self.parts.sum += gain;
        self.parts.squares += gain * gain;
    }

    /// Whether the mean daily gain exceeds 0 by two and a half of its standard errors; never before seven days.
    pub fn is_significant(&self) -> bool {
        let OrderGainsParts { days, sum, squares } = self.parts;
        if days < DAYS_MIN {
            return false;
        }
        let mean = sum / days;
        let variance = ((squares - sum * mean) / (days - 1.0)).max(0.0);
        mean > STANDARD_ERRORS * (variance / days).sqrt()
    }

    /// Multiplies the weight of the days so far by `factor`, 0 to 1 (forgetting).
    pub(crate) fn fade(&mut self, factor: f64) {
        let OrderGainsParts { days, sum, squares } = &mut self.parts;
        [days, sum, squares].into_iter().for_each(|part| *part *= factor);
    }

    /// The parts to store.
    pub fn to_parts(&self) -> OrderGainsParts {
        self.parts
    }

    /// Gains from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where the sum is not finite, or another number is negative or not finite.
    pub fn from_parts(parts: OrderGainsParts) -> Result<OrderGains, InvalidParts> {
        InvalidParts::check("days of gains", parts.days, 0.0..=f64::MAX)?;
        InvalidParts::check("sum of gains", parts.sum, f64::MIN..=f64::MAX)?;
        InvalidParts::check("sum of squared gains", parts.squares, 0.0..=f64::MAX)?;
        Ok(OrderGains { parts })
    }
}
