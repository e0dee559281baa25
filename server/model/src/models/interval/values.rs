//! Credible intervals of states that are not probabilities: z standard deviations to either side of the prediction.
//!
//! Invariant: a band is finite, holds its prediction and lies in the bounds of the state's kind.

use super::{HourMoments, Interval};
use crate::{StateKind, special::normal_upper_quantile};

#[cfg(test)]
mod tests;

/// The weight of the variance of single readings, in days.
const BORROWED_DAYS: f64 = 1.0;

fn number(found: f64) -> f64 {
    if found.is_finite() { found.max(0.0) } else { 0.0 }
}

/// The band that holds the mean of the state over the hour around a moment with probability `level`: the prediction p,
/// which lies in the kind's bounds, ± z·σ, where z is the quantile of the normal distribution at (1 + level)/2.
///
/// σ² is the variance between days of this hour of the day on days of this kind, `hour`. It is shrunk towards the
/// variance of single readings, `readings`, with the weight of one day, and widened by 1 + 1/days for the uncertainty
/// of the mean of these days. Without data of the hour σ² is twice the variance of single readings. `level` outside
/// `[0, 0.999999]` counts as the nearer end, NaN as the upper end.
pub fn value_interval(kind: StateKind, p: f64, hour: HourMoments, readings: f64, level: f64) -> Interval {
    let days = number(hour.days);
    let mean = if days > 0.0 { kind.saturate(hour.sum / days) } else { 0.0 };
    let between = number(hour.sum_of_squares - mean * hour.sum);
    let freedom = (days - 1.0).max(0.0);
    let variance = (between.min(f64::MAX) + BORROWED_DAYS * number(readings)) / (freedom + BORROWED_DAYS);
    value_interval_of(kind, p, variance * (1.0 + 1.0 / days.max(1.0)), level)
}

/// The band of a prediction p from which the mean of the hour has an expected squared distance of `variance`: p ± z·σ
/// with the z of [`value_interval`].
pub fn value_interval_of(kind: StateKind, p: f64, variance: f64, level: f64) -> Interval {
    let (p, deviation) = (kind.saturate(p), number(variance).sqrt().min(1e13));
    let level = if level.is_nan() { 1.0 } else { level }.clamp(0.0, 0.999_999);
    let reach = normal_upper_quantile((1.0 - level) / 2.0) * deviation;
    Interval { lower: kind.saturate(p - reach), upper: kind.saturate(p + reach) }
}
