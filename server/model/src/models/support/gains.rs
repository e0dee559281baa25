//! Whether components make predictions better day after day.
//!
//! Days are blocks: within one, errors depend on each other. The recorded errors are of predictions made before the day
//! was learned, so this is validation on held-out data. Invariant: sums are finite.

use crate::{InvalidParts, ORDER_MAX};

/// A gain counts if its mean over days exceeds this many of its standard errors.
const STANDARD_ERRORS: f64 = 2.0;
/// With fewer days a standard error is meaningless.
const DAYS_MIN: u64 = 7;
/// The upper limit of mean squared errors.
const ERROR_MAX: f64 = 1e100;

/// Daily gains of each order over order 0.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct OrderGains {
    parts: OrderGainsParts,
}

/// What [`OrderGains`] consist of, for storage.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct OrderGainsParts {
    /// Days recorded.
    pub days: u64,
    /// Per order, the sum over days of the mean squared error of order 0 minus that of the order.
    pub sums: [f64; ORDER_MAX + 1],
    /// Per order the sum of the squares of these.
    pub squares: [f64; ORDER_MAX + 1],
}

impl OrderGains {
    /// Adds a day: the summed squared errors of each order over its `scored` observations, as in
    /// [`UpdateOutcome`](crate::UpdateOutcome). A day without observations, or with an error that is NaN, changes
    /// nothing.
    pub fn record(&mut self, squared_errors: &[f64; ORDER_MAX + 1], scored: u64) {
        if scored == 0 || squared_errors.iter().any(|error| error.is_nan()) {
            return;
        }
        let mean = |sum: f64| (sum / scored as f64).clamp(0.0, ERROR_MAX);
        for (order, &error) in squared_errors.iter().enumerate() {
            let gain = mean(squared_errors[0]) - mean(error);
            self.parts.sums[order] += gain;
            self.parts.squares[order] += gain * gain;
        }
        self.parts.days += 1;
    }

    /// The highest order that has predicted better than order 0 by two standard errors of the mean daily gain; 0 if
    /// there is none, or before seven days.
    pub fn supported_order(&self) -> usize {
        if self.parts.days < DAYS_MIN {
            return 0;
        }
        let days = self.parts.days as f64;
        let is_gain = |order: &usize| {
            let (sum, squares) = (self.parts.sums[*order], self.parts.squares[*order]);
            let mean = sum / days;
            let variance = ((squares - sum * mean) / (days - 1.0)).max(0.0);
            mean > STANDARD_ERRORS * (variance / days).sqrt()
        };
        (1..=ORDER_MAX).rev().find(is_gain).unwrap_or(0)
    }

    /// The parts to store.
    pub fn to_parts(&self) -> OrderGainsParts {
        self.parts
    }

    /// Gains from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a sum is not finite or a sum of squares is negative.
    pub fn from_parts(parts: OrderGainsParts) -> Result<OrderGains, InvalidParts> {
        for (&sum, &squares) in parts.sums.iter().zip(&parts.squares) {
            InvalidParts::check("sum of gains", sum, f64::MIN..=f64::MAX)?;
            InvalidParts::check("sum of squared gains", squares, 0.0..=f64::MAX)?;
        }
        Ok(OrderGains { parts })
    }
}
