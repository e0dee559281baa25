//! Quantiles of the Beta distribution, and of a product of independent ones.
//!
//! The distribution function is the continued fraction of W. H. Press et al., "Numerical Recipes", section 6.4, evaluated by
//! Lentz's method; its inverse is found in u = ln(x / (1 - x)), where the density has no poles, by Newton steps that never leave
//! what is known to hold the answer. Invariant: 0 ≤ lower ≤ upper ≤ 1, whatever is asked.

use libm::lgamma;
use tidemap_model::models::Interval;

#[cfg(test)]
mod tests;

/// More observations than this make an interval no narrower.
const EVIDENCE_MAX: f64 = 1e6;
/// Fewer are as good as none: the value is 0 or 1.
const EVIDENCE_MIN: f64 = 1e-9;
/// Beyond this on either side x is 0 or 1.
const FARTHEST: f64 = 745.0;

/// A chance that is not known for certain: a product of independent Beta variables, by its first two moments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Chance {
    /// The logarithm of the mean.
    log_mean: f64,
    /// The logarithm of E[P²] / E[P]².
    log_spread: f64,
}

impl Chance {
    pub const CERTAIN: Chance = Chance { log_mean: 0.0, log_spread: 0.0 };

    /// Beta(mean · evidence, (1 - mean) · evidence).
    pub fn new(mean: f64, evidence: f64) -> Chance {
        Chance { log_mean: mean.ln(), log_spread: ((1.0 - mean) / (mean * (evidence + 1.0))).ln_1p() }
    }

    /// Of both, which do not depend on each other: the means of products are the products of means.
    pub fn and(self, other: Chance) -> Chance {
        Chance { log_mean: self.log_mean + other.log_mean, log_spread: self.log_spread + other.log_spread }
    }

    /// The interval with equal tails that holds `confidence` of the Beta distribution with these two moments, and the mean. A
    /// chance of 1 is certain.
    pub fn interval(self, confidence: f64) -> Interval {
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
        let (lower, upper) = (quantile(alpha, beta, tail), quantile(alpha, beta, 1.0 - tail));
        // Nearly all of a chance close to 0 or 1 may lie on one side of its mean.
        Interval { lower: lower.min(mean), upper: upper.max(mean) }
    }
}

/// The x below which Beta(α, β) lies with probability q.
fn quantile(alpha: f64, beta: f64, q: f64) -> f64 {
    let log_beta = lgamma(alpha) + lgamma(beta) - lgamma(alpha + beta);
    let (mut low, mut high) = (-FARTHEST, FARTHEST);
    let mut u = (alpha / beta).ln().clamp(low, high);
    for _ in 0..200 {
        let (log_x, log_y) = (-softplus(-u), -softplus(u));
        let front = (alpha * log_x + beta * log_y - log_beta).exp();
        let x = log_x.exp();
        let below = if x < (alpha + 1.0) / (alpha + beta + 2.0) {
            front * fraction(alpha, beta, x) / alpha
        } else {
            1.0 - front * fraction(beta, alpha, log_y.exp()) / beta
        };
        (low, high) = if below < q { (u, high) } else { (low, u) };
        // The density of u is `front`.
        let newton = u - (below - q) / front;
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - u).abs() <= 1e-12 * u.abs().max(1.0) {
            break;
        }
        u = next;
    }
    (-softplus(-u)).exp()
}

/// The continued fraction of the incomplete Beta function; converges fast for x < (α + 1)/(α + β + 2).
fn fraction(alpha: f64, beta: f64, x: f64) -> f64 {
    const TINY: f64 = 1e-300;
    let away = |value: f64| if value.abs() < TINY { TINY } else { value };
    let mut c = 1.0;
    let mut d = 1.0 / away(1.0 - (alpha + beta) * x / (alpha + 1.0));
    let mut sum = d;
    for m in 1..20_000 {
        let m = f64::from(m);
        let twice = 2.0 * m;
        let even = m * (beta - m) * x / ((alpha + twice - 1.0) * (alpha + twice));
        d = 1.0 / away(1.0 + even * d);
        c = away(1.0 + even / c);
        sum *= d * c;
        let odd = -(alpha + m) * (alpha + beta + m) * x / ((alpha + twice) * (alpha + twice + 1.0));
        d = 1.0 / away(1.0 + odd * d);
        c = away(1.0 + odd / c);
        sum *= d * c;
        if (d * c - 1.0).abs() < 1e-15 {
            break;
        }
    }
    sum
}

/// ln(1 + e^u) without overflow.
fn softplus(u: f64) -> f64 {
    u.max(0.0) + (-u.abs()).exp().ln_1p()
}
