//! Tails and quantiles of the normal and the Beta distribution.
//!
//! The normal tail is libm's erfc; its quantile starts at M. Abramowitz and I. A. Stegun, "Handbook of Mathematical
//! Functions", 1964, 26.2.23 (error 5e-4) and takes two steps of Halley's method (error below 1e-12). The distribution
//! function of the Beta distribution is the continued fraction of W. H. Press et al., "Numerical Recipes", section 6.4,
//! evaluated by Lentz's method; its quantile is found in u = ln(x / (1 - x)), where the density has no poles, by Newton
//! steps that never leave the bracket of the answer. Invariant: no result is NaN for arguments in their ranges.

use libm::{erfc, lgamma};

/// The square, rounded once everywhere.
#[must_use]
#[inline]
pub fn square(number: f64) -> f64 {
    number * number
}

#[cfg(test)]
mod tests;

/// Beyond this magnitude of u, x is 0 or 1.
const LOGIT_MAX: f64 = 745.0;

/// The logarithm of the gamma function of `x`, above 0; to 1e-9. Stirling's series after a shift to 7 or more: the
/// tables of an ensemble take thousands a night, for which libm's is four times slower.
pub(crate) fn ln_gamma(mut x: f64) -> f64 {
    let mut product = 1.0;
    while x < 7.0 {
        product *= x;
        x += 1.0;
    }
    let inverse = 1.0 / x;
    let square = inverse * inverse;
    let series = inverse * (1.0 / 12.0 - square * (1.0 / 360.0 - square * (1.0 / 1260.0 - square / 1680.0)));
    let shifted = if product == 1.0 { 0.0 } else { libm::log(product) };
    (x - 0.5) * libm::log(x) - x + HALF_LN_TAU + series - shifted
}

/// ln Γ(x + steps) - ln Γ(x), for `x` above 0 and `steps` from 0; to 1e-9. A few whole steps are a product.
pub(crate) fn ln_rising(x: f64, steps: f64) -> f64 {
    if steps <= PRODUCT_STEPS && steps.fract() == 0.0 {
        return libm::log((0..steps as u32).fold(1.0, |product, step| product * (x + f64::from(step))));
    }
    ln_gamma(x + steps) - ln_gamma(x)
}

/// Up to this number of steps, the product is faster.
const PRODUCT_STEPS: f64 = 12.0;

/// The derivative of [`ln_gamma`] for `x` above 0; to 1e-10.
pub(crate) fn digamma(mut x: f64) -> f64 {
    let mut sum = 0.0;
    while x < 7.0 {
        sum -= 1.0 / x;
        x += 1.0;
    }
    let square = 1.0 / (x * x);
    let series = square
        * (1.0 / 12.0 - square * (1.0 / 120.0 - square * (1.0 / 252.0 - square * (1.0 / 240.0 - square / 132.0))));
    sum + libm::log(x) - 0.5 / x - series
}

/// Half the logarithm of 2π.
const HALF_LN_TAU: f64 = 0.918_938_533_204_672_7;

/// The probability that a standard normal variable exceeds `z`.
pub(crate) fn normal_tail(z: f64) -> f64 {
    0.5 * erfc(z / std::f64::consts::SQRT_2)
}

/// The z that a standard normal variable exceeds with probability `tail`, in `[1e-300, 0.5]`; to 1e-12.
pub(crate) fn normal_upper_quantile(tail: f64) -> f64 {
    let t = (-2.0 * libm::log(tail)).sqrt();
    let numerator = 2.515_517 + t * (0.802_853 + t * 0.010_328);
    let denominator = 1.0 + t * (1.432_788 + t * (0.189_269 + t * 0.001_308));
    let mut z = t - numerator / denominator;
    for _ in 0..2 {
        let step = (normal_tail(z) - tail) * std::f64::consts::TAU.sqrt() * libm::exp(0.5 * z * z);
        z += step / (1.0 - 0.5 * z * step);
    }
    z.max(0.0)
}

/// The number of standard deviations to both sides that hold a normally distributed number with this probability,
/// within (0, 1).
pub fn normal_reach(level: f64) -> f64 {
    normal_upper_quantile((1.0 - level) / 2.0)
}

/// The x below which Beta(α, β) lies with probability `q`.
pub fn beta_quantile(alpha: f64, beta: f64, q: f64) -> f64 {
    let log_beta = lgamma(alpha) + lgamma(beta) - lgamma(alpha + beta);
    let (mut low, mut high) = (-LOGIT_MAX, LOGIT_MAX);
    let mut u = libm::log(alpha / beta).clamp(low, high);
    for _ in 0..200 {
        let (log_x, log_y) = (-softplus(-u), -softplus(u));
        let front = libm::exp(alpha * log_x + beta * log_y - log_beta);
        let x = libm::exp(log_x);
        let below = if x < (alpha + 1.0) / (alpha + beta + 2.0) {
            front * fraction(alpha, beta, x) / alpha
        } else {
            1.0 - front * fraction(beta, alpha, libm::exp(log_y)) / beta
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
    libm::exp(-softplus(-u))
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
pub(crate) fn softplus(u: f64) -> f64 {
    u.max(0.0) + libm::log1p(libm::exp(-u.abs()))
}
