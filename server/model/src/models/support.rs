//! The number of components of a spectral model that the observations support.
//!
//! The strongest of 168 candidates is never 0, even for noise. There are two independent tests, and either suffices:
//! the probability that noise of equal dependence has such a peak in its periodogram ([`supported_order`]), and whether
//! predictions improved day after day ([`OrderGains`]). Invariant: more observations of equal kind never lower the
//! number; no result is NaN.

use crate::special::square;
use crate::{Component, Periodicities, SpectralModel};

mod gains;
pub use gains::{OrderGains, OrderGainsParts};

#[cfg(test)]
mod tests;

/// A component is supported if noise alone shows one as strong, at any candidate period, with less than this
/// probability.
const FALSE_ALARM: f64 = 0.01;

/// The upper limit of a share of the variance: a state that consists only of its components still has noise.
const SHARE_MAX: f64 = 0.999;

/// The dependence of successive readings, from sums that are kept for other purposes.
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
    /// Number of single hours with a reading: [`HourTable::observed_hours`](super::HourTable::observed_hours).
    pub observed_hours: f64,
    /// Σ |change of value| over the pairs.
    pub changes: f64,
}

/// The number of independent readings that the readings are equivalent to, from 1 to their number.
///
/// Readings of a state that changes slowly repeat each other. With a correlation ρ of neighbours that fades
/// exponentially (the state as a two-state Markov chain, RAS 2017 section 4.2), the mean of N readings, and any slow
/// component of their spectrum, have the variance of N(1 - ρ)/(1 + ρ) independent readings (G. V. Bayley and J. M.
/// Hammersley, "The 'Effective' Number of Independent Observations in an Autocorrelated Time Series", 1946). For values
/// of variance v, E(Δs)² = 2v(1 - ρ), and (Δs)² = |Δs| if they are 0 or 1. So 1 - ρ is the mean rate of change times
/// the mean time between readings, over 2μ(1-μ). Values between 0 and 1 vary less than that allows, which lowers the
/// number and is conservative.
///
/// If there are observed hours, the observed time counts instead of the span, with at least one reading an hour.
///
/// For readings at irregular times, the mean rate of change times the mean gap is more than the mean change, because
/// short gaps have high rates. So the mean of the changes is a second bound: with independent gaps, 1 - ρ of the
/// formula is the mean of 1 - e^(-gap/τ), and the changes measure this mean. At regular times both bounds are equal.
pub fn effective_observations(sums: &DependenceSums) -> f64 {
    let variance = sums.mean * (1.0 - sums.mean);
    let forgotten = |spacing: Spacing| if variance > 0.0 { 0.5 * spacing.change / variance } else { 0.0 };
    effective(sums, spacings(sums).map(forgotten))
}

/// The statistics from one reading to the next.
#[derive(Clone, Copy, Debug, Default)]
struct Spacing {
    /// The mean change.
    change: f64,
    secs: f64,
}

/// Three spacings of the readings: spread over the span; spread over the observed hours; and spread over the span, with
/// the changes that were counted.
fn spacings(sums: &DependenceSums) -> [Spacing; 3] {
    let pairs = sums.pairs.max(1) as f64;
    let spread = |secs: f64| Spacing { change: sums.change_rate_sum / pairs * (secs / pairs), secs: secs / pairs };
    let counted = Spacing { change: sums.changes / pairs, secs: sums.span_secs / pairs };
    [spread(sums.span_secs), spread(sums.observed_hours * 3600.0), counted]
}

/// The effective number. `forgotten`: 1 - ρ by each of the [`spacings`].
fn effective(sums: &DependenceSums, forgotten: [f64; 3]) -> f64 {
    let pairs = sums.pairs as f64;
    let over = |forgotten: f64| {
        if sums.pairs == 0 {
            return 1.0;
        }
        let forgotten = forgotten.clamp(0.0, 1.0);
        (pairs + 1.0) * forgotten / (2.0 - forgotten)
    };
    let number = if sums.observed_hours > 0.0 {
        over(forgotten[0]).min(over(forgotten[1]).max(sums.observed_hours))
    } else {
        over(forgotten[0])
    };
    let number = if number.is_nan() { number } else { number.min(over(forgotten[2])) };
    let readings = sums.pairs as f64 + 1.0;
    // Invalid sums give NaN, which supports nothing.
    if number.is_nan() { 1.0 } else { number.clamp(1.0, readings) }
}

/// Half the mean squared change from a reading to the next, computed from the mean change, for values in `[0,1]`. It is
/// exact if they are 0 or 1, otherwise too large.
pub(crate) fn half_square_of_probabilities(change: f64) -> f64 {
    0.5 * change
}

/// Half the mean squared change from a reading to the next, computed from the mean change, for values with a normal
/// distribution, for which E|Δs| = 2σ√((1 - ρ)/π).
pub(crate) fn half_square_of_values(change: f64) -> f64 {
    std::f64::consts::FRAC_PI_4 * change * change
}

/// The number of a model's strongest components that are supported, 0..=[`ORDER_MAX`](crate::ORDER_MAX).
///
/// Components are tested in turn. For N independent readings, a component at one period has the share x or more of the
/// variance with probability q = (1 - x)^((N-3)/2), and the strongest of K candidates has it with probability 1 - (1 -
/// q)^K (M. Zechmeister and M. Kürster, "The generalised Lomb-Scargle periodogram", A&A 2009, section 4). x is the
/// component's share of the variance that the earlier components leave of μ(1-μ), the largest variance of values in
/// `[0,1]`. N is the number of [`effective_observations`] without the component's own part: a component explains part
/// of the change from a reading to the next, 4|γ|²(1 - cos ωΔt), and part of the variance, 2|γ|²; both are subtracted,
/// so that a rhythm's own slowness is no evidence against it. The test ends at the first component that noise reaches
/// with a probability of 1 % or more. To use supported components only, predict with `order.min(supported)`.
pub fn supported_order(model: &SpectralModel, periodicities: &Periodicities, sums: &DependenceSums) -> usize {
    let variance = model.mean() * (1.0 - model.mean());
    supported_order_of(model, periodicities, sums, (half_square_of_probabilities, variance), 1.0)
}

/// Does the same as [`supported_order`] for values with the given variance, with half the mean squared change of
/// neighbours as a function of their mean change. `remembered`: the weight of the readings over their number, below 1
/// with forgetting.
pub(crate) fn supported_order_of(
    model: &SpectralModel,
    periodicities: &Periodicities,
    sums: &DependenceSums,
    (half_square, variance): (impl Fn(f64) -> f64, f64),
    remembered: f64,
) -> usize {
    let candidates = periodicities.len() as f64;
    let spacings = spacings(sums);
    let changed = spacings.map(|spacing| half_square(spacing.change));
    let mut explained = [0.0; 3];
    let mut left = variance;
    let mut supported = 0;
    for component in model.components() {
        let own = 2.0 * power(component);
        let share = (own / left).min(SHARE_MAX);
        for (explained, spacing) in explained.iter_mut().zip(spacings) {
            *explained += half_square_of(component, periodicities, spacing.secs);
        }
        let forgotten = |at: usize| (changed[at] - explained[at]).max(0.0) / (left * (1.0 - share));
        let effective = effective(sums, [0, 1, 2].map(forgotten));
        let exponent = -libm::log1p(-share) * (effective * remembered - 3.0).max(0.0) / 2.0;
        // 1 - (1 - e^-z)^K, exact where e^-z is tiny.
        let false_alarm = -libm::expm1(candidates * libm::log1p(-libm::exp(-exponent)));
        // Overlapping components can explain more than the whole variance; NaN supports nothing.
        if left.is_nan() || left <= 0.0 || false_alarm.is_nan() || false_alarm >= FALSE_ALARM {
            break;
        }
        left -= own;
        supported += 1;
    }
    supported
}

fn power(component: &Component) -> f64 {
    square(component.gamma_re) + square(component.gamma_im)
}

/// Half the mean squared change of a component's value over some seconds: 2|γ|²(1 - cos ωΔt).
fn half_square_of(component: &Component, periodicities: &Periodicities, secs: f64) -> f64 {
    let turns = secs / periodicities.period_secs(component.periodicity as usize);
    2.0 * power(component) * (1.0 - libm::cos(std::f64::consts::TAU * turns))
}
