//! The number of components of a spectral model that the observations support.
//!
//! The strongest of 168 candidates is never 0, even for noise. There are two independent tests: how likely noise alone
//! has such a peak in its periodogram, and whether predictions improved by it day after day. Invariant: more
//! observations of the same kind never lower the number; no result is NaN.

use crate::{Periodicities, SpectralModel};

mod gains;
pub use gains::{OrderGains, OrderGainsParts};

#[cfg(test)]
mod tests;

/// A component is supported if noise alone shows one as strong, at any candidate period, with less than this
/// probability.
const FALSE_ALARM: f64 = 0.01;

/// How much successive readings depend on each other, from sums that are kept anyway.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DependenceSums {
    /// Number of pairs of successive readings: [`PersistenceParts::pairs`](crate::PersistenceParts::pairs).
    pub pairs: u64,
    /// Σ |change of value| / time between, per second:
    /// [`PersistenceParts::change_rate_sum`](crate::PersistenceParts::change_rate_sum).
    pub change_rate_sum: f64,
    /// Time from the first reading to the last, in seconds.
    pub span_secs: f64,
    /// Mean value, in `[0,1]`: [`Accumulator::mean`](crate::Accumulator::mean).
    pub mean: f64,
    /// Number of single hours with a reading: [`HourTable::observed_hours`](super::HourTable::observed_hours). `None`:
    /// unknown; then readings count as spread over the span, and visits with many readings each are overrated.
    pub observed_hours: Option<f64>,
}

/// The number of independent readings that the readings are equivalent to, from 1 to their number.
///
/// Readings of a state that changes slowly repeat each other. With a correlation ρ of neighbours that fades
/// exponentially (the state as a two-state Markov chain, RAS 2017 section 4.2), the mean of N readings, and any slow
/// component of their spectrum, vary as those of N(1 - ρ)/(1 + ρ) independent ones (G. V. Bayley and J. M. Hammersley,
/// "The 'Effective' Number of Independent Observations in an Autocorrelated Time Series", 1946). Of the chain E|Δs| =
/// 2μ(1-μ)(1 - ρ), so 1 - ρ is the mean rate of change times the mean time between readings, over 2μ(1-μ). A rhythm of
/// the state itself makes neighbours more alike, and values between 0 and 1 vary less than 2μ(1-μ) allows: both lower
/// the number, which is conservative.
///
/// If hours are known, the observed time counts instead of the span, with at least one reading an hour.
pub fn effective_observations(sums: &DependenceSums) -> f64 {
    let most_change = 2.0 * sums.mean * (1.0 - sums.mean);
    effective(sums, |change| if most_change > 0.0 { change / most_change } else { 0.0 })
}

/// `forgotten`: 1 - ρ, by the mean change from a reading to the next.
fn effective(sums: &DependenceSums, forgotten: impl Fn(f64) -> f64) -> f64 {
    let pairs = sums.pairs as f64;
    let over = |secs: f64| {
        if sums.pairs == 0 {
            return 1.0;
        }
        let forgotten = forgotten(sums.change_rate_sum / pairs * (secs / pairs)).min(1.0);
        (pairs + 1.0) * forgotten / (2.0 - forgotten)
    };
    let number = match sums.observed_hours {
        Some(hours) if hours > 0.0 => over(sums.span_secs).min(over(hours * 3600.0).max(hours)),
        _ => over(sums.span_secs),
    };
    let readings = sums.pairs as f64 + 1.0;
    // NaN, from invalid sums, supports nothing.
    if number.is_nan() { 1.0 } else { number.clamp(1.0, readings) }
}

/// [`effective_observations`] of values that are not probabilities, with the given variance; the mean is not used.
///
/// Neighbours with a normal distribution and the correlation ρ differ by E|Δs| = 2σ√((1 - ρ)/π), so 1 - ρ is
/// π/4·(E|Δs|/σ)².
pub(crate) fn effective_observations_of_values(sums: &DependenceSums, variance: f64) -> f64 {
    effective(sums, |change| std::f64::consts::FRAC_PI_4 * change * change / variance)
}

/// The number of a model's strongest components that are supported, 0..=[`ORDER_MAX`](crate::ORDER_MAX).
///
/// Of n independent readings with variance v, |γ|²n/v is exponentially distributed with mean 1, so that noise shows a
/// peak of z or more among K candidates with probability 1 - (1 - e^-z)^K (J. D. Scargle, "Studies in Astronomical Time
/// Series Analysis II", ApJ 1982, section III). Components are tested in turn, each against the variance that the
/// previous ones leave of μ(1-μ), the largest variance of values in `[0,1]`; the first that noise shows with a
/// probability of 1 % or more ends the test. To use supported components only, predict with `order.min(supported)`.
pub fn supported_order(model: &SpectralModel, periodicities: &Periodicities, effective_observations: f64) -> usize {
    let variance = model.mean() * (1.0 - model.mean());
    supported_order_of_values(model, periodicities, effective_observations, variance)
}

/// [`supported_order`] of values with the given variance.
pub(crate) fn supported_order_of_values(
    model: &SpectralModel,
    periodicities: &Periodicities,
    effective_observations: f64,
    variance: f64,
) -> usize {
    let candidates = periodicities.len() as f64;
    let mut variance = variance;
    let mut supported = 0;
    for component in model.components() {
        let power = component.gamma_re.powi(2) + component.gamma_im.powi(2);
        let peak = power * effective_observations / variance;
        // 1 - (1 - e^-z)^K, exact where e^-z is tiny.
        let false_alarm = -(candidates * (-(-peak).exp()).ln_1p()).exp_m1();
        // Overlapping components can explain more than the whole variance; NaN supports nothing.
        if variance <= 0.0 || false_alarm.is_nan() || false_alarm >= FALSE_ALARM {
            break;
        }
        variance -= 2.0 * power;
        supported += 1;
    }
    supported
}
