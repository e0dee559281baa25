//! Tail probabilities of single values of states that are not probabilities.
//!
//! Continuous values are assumed to be normal about the prediction. Counts are assumed to be negative binomial, a
//! Poisson distribution whose rate differs from time to time, with the variance φ·λ, φ ≥ 1, λ the prediction (the form
//! called NB1: A. C. Cameron and P. K. Trivedi, "Econometric models based on count data", Journal of Applied
//! Econometrics 1986). As φ goes to 1 it becomes Poisson. Invariant: the result is in `[0,1]` for all arguments.

use crate::{StateKind, VALUE_MAX, special::normal_tail};

#[cfg(test)]
mod tests;

/// The variance of counts is at least this times their mean: so close to Poisson that one formula serves for both.
const DISPERSION_MIN: f64 = 1.000_01;
/// Above this mean, or this dispersion, counts are treated as normal, because sums would be long.
const SUMMED_MEAN_MAX: f64 = 600.0;
const DISPERSION_MAX: f64 = 1e4;
/// Values are distinguished from their prediction down to this share of it: sums of squares are not more precise.
const DEVIATION_MIN: f64 = 1e-6;

/// The probability of a value at least as far out as `value`, to either side: twice the lesser of the probabilities of
/// a value at least as large, and of a value at least as small; at most 1.
///
/// `expected` is the prediction, `variance` is the variance of single values about it, at least 0. The value lies
/// outside of the two-sided interval of confidence C if this is less than 1 - C. A prediction or variance that is not
/// finite counts as 0; a value that is not finite has the tail 0.
pub fn value_tail(kind: StateKind, expected: f64, variance: f64, value: f64) -> f64 {
    if !value.is_finite() {
        return 0.0;
    }
    let number = |found: f64| if found.is_finite() { found } else { 0.0 };
    let expected = number(expected).clamp(-VALUE_MAX, VALUE_MAX);
    let variance = number(variance).max(0.0);
    let one_sided = if kind == StateKind::Count {
        let mean = expected.max(0.0);
        counts_tail(mean, (variance / mean.max(f64::MIN_POSITIVE)).max(DISPERSION_MIN), value)
    } else {
        let deviation = variance.sqrt().max(DEVIATION_MIN * expected.abs()).max(f64::MIN_POSITIVE);
        normal_tail((value - expected).abs() / deviation)
    };
    (2.0 * one_sided).clamp(0.0, 1.0)
}

/// The lesser of the probabilities of a count of at most `value` and of at least `value`, with that mean and the
/// variance φ·mean.
fn counts_tail(mean: f64, dispersion: f64, value: f64) -> f64 {
    if value < 0.0 {
        return 0.0;
    }
    if mean <= 0.0 {
        return if value > 0.0 { 0.0 } else { 1.0 };
    }
    if mean > SUMMED_MEAN_MAX || dispersion > DISPERSION_MAX {
        // A continuity correction of one half.
        let distance = ((value - mean).abs() - 0.5).max(0.0);
        return normal_tail(distance / (dispersion * mean).sqrt());
    }
    let size = mean / (dispersion - 1.0);
    let ratio = 1.0 - 1.0 / dispersion;
    // P(k + 1) / P(k).
    let growth = |k: f64| (k + size) / (k + 1.0) * ratio;
    // P(0) is at least e^-600.
    let (mut at, mut mass, mut below) = (0.0, libm::exp(-size * libm::log1p(dispersion - 1.0)), 0.0);
    while at + 1.0 <= value && !(at > mean && mass < 1e-300) {
        below += mass;
        mass *= growth(at);
        at += 1.0;
    }
    if at + 1.0 <= value {
        return 0.0;
    }
    let at_most = below + mass;
    if value < mean {
        return at_most.min((1.0 - below).max(0.0));
    }
    let mut at_least = mass;
    // The masses fall monotonically from here on.
    while mass > 1e-9 * at_least && mass > 0.0 {
        mass *= growth(at);
        at += 1.0;
        at_least += mass;
    }
    at_least.min(at_most)
}
