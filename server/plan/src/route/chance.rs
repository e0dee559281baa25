//! The uncertain success probability of a route: a product of independent Beta variables.
//!
//! Invariant: 0 ≤ lower ≤ upper ≤ 1, for all arguments.

use tidemap_model::{models::Interval, special::beta_quantile};

#[cfg(test)]
mod tests;

/// The interval that holds the success of an edge with probability `confidence`, 0 to 1, with equal tails: quantiles of
/// Beta(success · evidence, (1 - success) · evidence), widened to hold the success itself.
pub fn success_interval(success: f64, evidence: f64, confidence: f64) -> Interval {
    Chance::new(success, evidence).interval(confidence)
}

/// Upper limit of the evidence, in observations.
const EVIDENCE_MAX: f64 = 1e6;
/// Lower limit of the evidence: with less the value is 0 or 1.
const EVIDENCE_MIN: f64 = 1e-9;

/// An uncertain probability: a product of independent Beta variables, by its first two moments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Chance {
    /// The logarithm of the mean.
    log_mean: f64,
    /// The logarithm of E[P²] / E[P]².
    log_spread: f64,
}

impl Chance {
    pub(crate) const CERTAIN: Chance = Chance { log_mean: 0.0, log_spread: 0.0 };

    /// Beta(mean · evidence, (1 - mean) · evidence).
    pub(super) fn new(mean: f64, evidence: f64) -> Chance {
        Chance { log_mean: mean.ln(), log_spread: ((1.0 - mean) / (mean * (evidence + 1.0))).ln_1p() }
    }

    /// The product of both, which are independent: the moments multiply.
    pub(super) fn and(self, other: Chance) -> Chance {
        Chance { log_mean: self.log_mean + other.log_mean, log_spread: self.log_spread + other.log_spread }
    }

    /// The interval with equal tails that holds `confidence` of the Beta distribution with these two moments, and the
    /// mean. A probability of 1 is certain.
    pub(super) fn interval(self, confidence: f64) -> Interval {
        let mean = self.log_mean.exp();
        if mean >= 1.0 {
            return Interval { lower: 1.0, upper: 1.0 };
        }
        if mean < f64::MIN_POSITIVE {
            return Interval { lower: 0.0, upper: 0.0 };
        }
        // m(1 - m) / v - 1, with v = m² · (e^spread - 1).
        let found = -self.log_mean.exp_m1() / (mean * self.log_spread.exp_m1()) - 1.0;
        let evidence = if found.is_nan() { EVIDENCE_MIN } else { found.clamp(EVIDENCE_MIN, EVIDENCE_MAX) };
        let (alpha, beta) = (mean * evidence, -self.log_mean.exp_m1() * evidence);
        let tail = 0.5 * (1.0 - confidence);
        let (lower, upper) = (beta_quantile(alpha, beta, tail), beta_quantile(alpha, beta, 1.0 - tail));
        // Nearly all mass of a probability close to 0 or 1 may lie on one side of its mean.
        let found = Interval { lower: lower.min(mean), upper: upper.max(mean) };
        debug_assert!(
            0.0 <= found.lower && found.lower <= found.upper && found.upper <= 1.0,
            "{found:?} around {mean}"
        );
        found
    }
}
