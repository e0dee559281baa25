//! Chooses the model order: how well each order has predicted observations that came after its training.
//!
//! The method is T-RO section IV.B, with memory: errors fade by 7 % with each further day of observations, so that
//! neither one unusual day nor the distant past decides. Days without observations do not count: a place that is
//! observed once a month is not judged by its last observation alone. Invariant: the error sums are finite and not
//! negative.

use crate::{InvalidParts, LocalDay, ORDER_MAX};

#[cfg(test)]
mod tests;

/// The share of a day's errors that remains after each further observed local day.
const KEPT_PER_DAY: f64 = 0.93;

/// The share of earlier errors that remains when a day is recorded after `last`. A later day fades them; the same day
/// or an earlier one does not.
pub(crate) fn kept(last: LocalDay, day: LocalDay) -> f64 {
    if day > last { KEPT_PER_DAY } else { 1.0 }
}
/// A lower order is preferred if its error exceeds the lowest by at most this factor.
const NEAR_TIE: f64 = 1.001;

/// The error of a prediction that counts when the order is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum OrderCriterion {
    /// Squared difference of prediction and value.
    #[default]
    SquaredError,
    /// 1 where prediction and value lie on different sides of 0.5, else 0 (T-RO eq. 15).
    ZeroOne,
}

/// Faded sums of prediction errors, one per order 0..=[`ORDER_MAX`].
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct OrderErrors {
    parts: OrderErrorsParts,
}

/// The parts of [`OrderErrors`], for storage.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct OrderErrorsParts {
    /// Faded sum of errors per order, at `last_day`.
    pub sums: [f64; ORDER_MAX + 1],
    /// The last local day that was recorded.
    pub last_day: Option<LocalDay>,
}

impl OrderErrors {
    /// Adds the summed errors of a day's observations per order, after older errors have faded by 0.93. A day that is
    /// not later than the last one is added without fading.
    pub fn record(&mut self, day: LocalDay, errors: &[f64; ORDER_MAX + 1]) {
        let last_day = self.parts.last_day.unwrap_or(day);
        let kept = kept(last_day, day);
        for (sum, error) in self.parts.sums.iter_mut().zip(errors) {
            *sum = *sum * kept + error;
            debug_assert!(sum.is_finite() && *sum >= 0.0, "a sum of errors is {sum}");
        }
        self.parts.last_day = Some(day.max(last_day));
    }

    /// Lowers the weight of the errors recorded so far (forgetting).
    pub(crate) fn fade(&mut self, factor: f64) {
        self.parts.sums.iter_mut().for_each(|sum| *sum *= factor);
    }

    /// The lowest order whose error is within 0.1 % of the lowest error.
    pub fn best(&self) -> usize {
        let lowest = self.parts.sums.iter().copied().fold(f64::INFINITY, f64::min);
        self.parts.sums.iter().position(|&sum| sum <= lowest * NEAR_TIE).unwrap_or(0)
    }

    /// Faded sum of errors per order.
    pub fn sums(&self) -> &[f64; ORDER_MAX + 1] {
        &self.parts.sums
    }

    /// The last local day that was recorded.
    pub fn last_day(&self) -> Option<LocalDay> {
        self.parts.last_day
    }

    /// The parts to store.
    pub fn to_parts(&self) -> OrderErrorsParts {
        self.parts
    }

    /// Errors from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a sum is negative or not finite.
    pub fn from_parts(parts: OrderErrorsParts) -> Result<OrderErrors, InvalidParts> {
        for &sum in &parts.sums {
            InvalidParts::check("error sum", sum, 0.0..=f64::MAX)?;
        }
        Ok(OrderErrors { parts })
    }
}
