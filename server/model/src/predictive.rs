//! The predictive distribution of a state of probabilities at one time: the one source of value, interval, entropy and
//! information.
//!
//! p is the probability by the state's habits. Its uncertainty follows from the number ν of half-hour bins that support
//! it: p ~ Beta(vν, (1 - v)ν). M is the mean of the state over an hour; an interval refers to M. The number of
//! the hour's twelve readings that are 1 has a beta-binomial distribution with the mean v and the dependence of the
//! state's readings. The means 0 and 1 have a probability of their own, so the mass of an interval may be above the
//! level. Invariant: the value lies strictly between 0 and 1; entropy and information are not negative; an interval
//! contains the value and holds at least its level.

use crate::{entropy::entropy_bits, information::learning_bits, models::Interval, special::ln_gamma};

#[cfg(test)]
mod tests;

/// Readings of an hour.
const READINGS: usize = 12;
/// The least distance of a value from 0 and 1.
const EDGE: f64 = 1e-6;
/// Lower ends that are tried.
const STEPS: usize = 60;

/// A predicted probability with its evidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Predictive {
    value: f64,
    bins: f64,
    dependence: f64,
}

/// An interval with the probability that it holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldInterval {
    /// The interval.
    pub interval: Interval,
    /// The probability that the mean of the hour lies in the interval: at least the requested level.
    pub mass: f64,
}

impl Predictive {
    /// A prediction. `value`: the probability; NaN counts as 0.5. `bins`: the number of half-hour bins at this hour
    /// that support it, at least 0. `dependence`: the correlation of the state half an hour apart, within `[0,1)`.
    pub fn new(value: f64, bins: f64, dependence: f64) -> Predictive {
        let value = if value.is_nan() { 0.5 } else { value.clamp(EDGE, 1.0 - EDGE) };
        let bins = if bins.is_nan() { 0.0 } else { bins.max(0.0) };
        let dependence = if dependence.is_nan() { 0.0 } else { dependence.clamp(1e-3, 0.999) };
        Predictive { value, bins, dependence }
    }

    /// The probability.
    pub fn value(self) -> f64 {
        self.value
    }

    /// The number of half-hour bins at this hour that support the value.
    pub fn bins(self) -> f64 {
        self.bins
    }

    /// The entropy of the state in bits, 0 to 1: the expected loss of acting on the value.
    pub fn entropy_bits(self) -> f64 {
        entropy_bits(self.value)
    }

    /// The mutual information of one observation and the habit, in bits: its information about later observations.
    pub fn learning_bits(self) -> f64 {
        learning_bits(self.value, self.bins)
    }

    /// The share of a single reading's variance that the mean of an hour has.
    fn variance_share(self) -> f64 {
        // The share of a state that relaxes to its habit, with this correlation after half an hour.
        let x = -2.0 * libm::log(self.dependence);
        let share = 2.0 * (x - 1.0 + libm::exp(-x)) / (x * x);
        // The uncertainty of the habit is common to the whole hour.
        share + (1.0 - share) / (1.0 + self.bins)
    }

    /// The probabilities that none, one, … all of the hour's twelve readings are 1.
    fn masses(self) -> [f64; READINGS + 1] {
        let n = READINGS as f64;
        let dependence = ((n * self.variance_share() - 1.0) / (n - 1.0)).clamp(1e-4, 0.995);
        let strength = 1.0 / dependence - 1.0;
        let (ones, zeros) = (self.value * strength, (1.0 - self.value) * strength);
        let constant =
            ln_gamma(n + 1.0) + ln_gamma(strength) - ln_gamma(ones) - ln_gamma(zeros) - ln_gamma(n + strength);
        let mut masses = [0.0; READINGS + 1];
        for (k, mass) in masses.iter_mut().enumerate() {
            let k = k as f64;
            let log = ln_gamma(k + ones) + ln_gamma(n - k + zeros) - ln_gamma(k + 1.0) - ln_gamma(n - k + 1.0);
            *mass = libm::exp(constant + log);
        }
        masses
    }

    /// The shortest interval that contains the value and holds the mean of the hour with probability `level`, in (0,
    /// 1).
    pub fn interval(self, level: f64) -> HeldInterval {
        HourMean::new(self.masses()).interval(self.value, level)
    }
}

/// The distribution of the mean of an hour: atoms at 0 and 1, and a density between.
struct HourMean {
    at_zero: f64,
    /// The possible means, ascending from 0 to 1. `below` has the probability of at most each of them, without the atom
    /// at 1.
    means: [f64; READINGS],
    below: [f64; READINGS],
}

impl HourMean {
    fn new(masses: [f64; READINGS + 1]) -> HourMean {
        let (mut means, mut below) = ([0.0; READINGS], [0.0; READINGS]);
        let mut sum = masses[0];
        below[0] = sum;
        for k in 1..READINGS {
            sum += masses[k];
            below[k] = sum;
            means[k] = if k == READINGS - 1 { 1.0 } else { (k as f64 + 0.5) / READINGS as f64 };
        }
        HourMean { at_zero: masses[0], means, below }
    }

    /// The probability of less than `mean` if that is above 0, and of at most `mean` if it is below 1.
    fn below(&self, mean: f64) -> f64 {
        between(mean, &self.means, &self.below)
    }

    fn quantile(&self, probability: f64) -> f64 {
        if probability > self.at_zero { between(probability, &self.below, &self.means) } else { 0.0 }
    }

    fn interval(&self, value: f64, level: f64) -> HeldInterval {
        let inner = self.below[READINGS - 1];
        let (mut best, mut width) = ((0.0, 1.0), f64::INFINITY);
        let mut consider = |lower: f64, upper: f64| {
            if upper - lower < width - 1e-9 {
                (best, width) = ((lower, upper), upper - lower);
            }
        };
        for step in 0..=STEPS {
            let lower = (value * step as f64 / STEPS as f64).min(value);
            let up_to = level + if lower > 0.0 { self.below(lower) } else { 0.0 };
            if up_to > 1.0 {
                break;
            }
            consider(lower, if up_to <= inner { self.quantile(up_to).max(value) } else { 1.0 });
        }
        // The interval that ends at 1 and starts as high as the level allows.
        consider(self.quantile(1.0 - level).min(value), 1.0);
        let (lower, upper) = best;
        let mass =
            if upper >= 1.0 { 1.0 } else { self.below(upper) } - if lower > 0.0 { self.below(lower) } else { 0.0 };
        HeldInterval { interval: Interval { lower, upper }, mass: mass.clamp(0.0, 1.0) }
    }
}

/// Linear interpolation; `from` ascends.
fn between(at: f64, from: &[f64; READINGS], to: &[f64; READINGS]) -> f64 {
    let next = from.iter().position(|&known| at <= known).unwrap_or(READINGS);
    if next == 0 || next == READINGS {
        return to[next.min(READINGS - 1)];
    }
    let span = from[next] - from[next - 1];
    if span <= 0.0 { to[next] } else { to[next - 1] + (to[next] - to[next - 1]) * (at - from[next - 1]) / span }
}
