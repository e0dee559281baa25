//! A probability in hypertime: the density of readings that are 1 against that of readings that are 0.
//!
//! p = γ·n₁f₁/(n₁f₁ + n₀f₀), which is eq. 2 of RA-L 2019 with a fixed at 1 and at 0; a reading between 0 and 1 counts
//! for both. γ makes the mean prediction over the readings equal to their mean (eq. 3, according to its text; the
//! printed sum in its denominator runs over the readings that are 1 alone). Densities are those of the plane in which
//! each circle lies. Invariant: a prediction lies in `[0,1]`, and where there is no data it tends to the mean.

use super::candidates::{HypertimePeriod, project};
use super::mixture::Mixture;
use super::{HypertimeCluster, HypertimeMethod};
use crate::InvalidParts;

/// Bound on logarithms, so that two of them can be added and exponentiated.
const LOG_MAX: f64 = 300.0;
/// Bound on ln γ.
const GAIN_LOG_MAX: f64 = 20.0;

/// The parts of a hypertime model of a probability, for storage.
#[derive(Clone, Debug, PartialEq)]
pub struct HypertimeOddsParts {
    /// The method of clustering.
    pub method: HypertimeMethod,
    /// The periods, in the order found; at most five.
    pub periods: Vec<HypertimePeriod>,
    /// Mean value, in `[0,1]`.
    pub mean: f64,
    /// Weight of the prior, the mean value spread evenly over all times; above 0.
    pub background: f64,
    /// ln of the factor on the density of the readings that are 1.
    pub log_ones: f64,
    /// ln of the factor on the density of the readings that are 0.
    pub log_zeros: f64,
    /// γ, the factor on the ratio of the densities; above 0.
    pub gain: f64,
    /// Clusters of readings that are 1; empty if the prediction is the mean.
    pub ones: Vec<HypertimeCluster>,
    /// Clusters of readings that are 0; empty if the prediction is the mean.
    pub zeros: Vec<HypertimeCluster>,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Odds {
    method: HypertimeMethod,
    periods: Vec<HypertimePeriod>,
    mean: f64,
    background: f64,
    log_ones: f64,
    log_zeros: f64,
    gain: f64,
    ones: Mixture,
    zeros: Mixture,
}

/// The numbers of coordinates of the Gaussians, and of circles.
pub(super) fn shape(method: HypertimeMethod, periods: usize) -> (usize, usize) {
    match method {
        HypertimeMethod::Em => (2 * periods, 0),
        HypertimeMethod::Km => (0, periods),
    }
}

impl Odds {
    /// The model that predicts the mean alone.
    pub(super) fn constant(method: HypertimeMethod, periods: &[HypertimePeriod], mean: f64, background: f64) -> Odds {
        Odds {
            method,
            periods: periods.to_vec(),
            mean,
            background,
            log_ones: 0.0,
            log_zeros: 0.0,
            gain: 1.0,
            ones: Mixture::default(),
            zeros: Mixture::default(),
        }
    }

    /// Adds mixtures of the readings that are 1 and 0; `weights` are the sums of their weights, `everywhere` points
    /// spread evenly over all times.
    pub(super) fn with_mixtures<'a>(
        self,
        (ones, zeros): (Mixture, Mixture),
        weights: (f64, f64),
        everywhere: impl Iterator<Item = &'a [f64]>,
    ) -> Odds {
        let mut odds = Odds { ones, zeros, ..self };
        if odds.is_constant() {
            return odds;
        }
        let (ones, zeros) = weights;
        // The mean of the density of all readings over all times is the number of readings, so that the prior has its
        // weight.
        let both = |point: &'a [f64]| {
            let (one, zero) = odds.log_densities(point);
            log_sum(libm::log(ones) + one, libm::log(zeros) + zero)
        };
        let logs: Vec<f64> = everywhere.map(both).collect();
        let level = log_mean(&logs) - libm::log(ones + zeros);
        odds.log_ones = (libm::log(ones) - level).clamp(-LOG_MAX, LOG_MAX);
        odds.log_zeros = (libm::log(zeros) - level).clamp(-LOG_MAX, LOG_MAX);
        odds
    }

    /// Computes γ (eq. 3), by bisection of its logarithm: predictions end at 1, and their mean is monotonic in γ.
    /// `observed` are the points of the readings and their weights.
    pub(super) fn with_gain<'a>(self, observed: impl Iterator<Item = (&'a [f64], f64)>) -> Odds {
        if self.is_constant() {
            return self;
        }
        let ratio = |(point, weight): (&'a [f64], f64)| {
            let (log_one, log_zero) = self.log_densities(point);
            (weight, self.ratio(log_one, log_zero))
        };
        let observed: Vec<(f64, f64)> = observed.map(ratio).collect();
        let (mut low, mut high) = (-GAIN_LOG_MAX, GAIN_LOG_MAX);
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            let gain = libm::exp(middle);
            let excess: f64 =
                observed.iter().map(|(weight, ratio)| weight * ((gain * ratio).min(1.0) - self.mean)).sum();
            if excess > 0.0 {
                high = middle;
            } else {
                low = middle;
            }
        }
        Odds { gain: libm::exp(0.5 * (low + high)), ..self }
    }

    /// The clusters of the readings that are 1, and of those that are 0.
    pub(super) fn mixtures(&self) -> (&Mixture, &Mixture) {
        (&self.ones, &self.zeros)
    }

    fn is_constant(&self) -> bool {
        self.ones.clusters.is_empty() || self.zeros.clusters.is_empty()
    }

    fn log_densities(&self, point: &[f64]) -> (f64, f64) {
        let (coordinates, _) = shape(self.method, self.periods.len());
        (self.ones.log_densities(point, coordinates, 0).1, self.zeros.log_densities(point, coordinates, 0).1)
    }

    /// The prediction before γ.
    fn ratio(&self, log_one: f64, log_zero: f64) -> f64 {
        let ones = libm::exp((self.log_ones + log_one).min(2.0 * LOG_MAX));
        let zeros = libm::exp((self.log_zeros + log_zero).min(2.0 * LOG_MAX));
        ((ones + self.background * self.mean) / (ones + zeros + self.background)).clamp(0.0, 1.0)
    }

    /// The probability at a point in hypertime.
    pub(super) fn at_point(&self, point: &[f64]) -> f64 {
        if self.is_constant() {
            return self.mean;
        }
        let (log_one, log_zero) = self.log_densities(point);
        (self.gain * self.ratio(log_one, log_zero)).min(1.0)
    }

    /// The probability at a local civil time.
    pub(super) fn at(&self, civil_nanos: i64) -> f64 {
        let mut point = Vec::with_capacity(2 * self.periods.len());
        project(civil_nanos, &self.periods, &mut point);
        self.at_point(&point)
    }

    pub(super) fn method(&self) -> HypertimeMethod {
        self.method
    }

    pub(super) fn periods(&self) -> &[HypertimePeriod] {
        &self.periods
    }

    pub(super) fn to_parts(&self) -> HypertimeOddsParts {
        HypertimeOddsParts {
            method: self.method,
            periods: self.periods.clone(),
            mean: self.mean,
            background: self.background,
            log_ones: self.log_ones,
            log_zeros: self.log_zeros,
            gain: self.gain,
            ones: self.ones.to_parts(),
            zeros: self.zeros.to_parts(),
        }
    }

    pub(super) fn from_parts(parts: &HypertimeOddsParts) -> Result<Odds, InvalidParts> {
        HypertimePeriod::check(&parts.periods)?;
        InvalidParts::check("mean", parts.mean, 0.0..=1.0)?;
        InvalidParts::check("background", parts.background, 1e-300..=1e18)?;
        InvalidParts::check("log_ones", parts.log_ones, -2.0 * LOG_MAX..=2.0 * LOG_MAX)?;
        InvalidParts::check("log_zeros", parts.log_zeros, -2.0 * LOG_MAX..=2.0 * LOG_MAX)?;
        InvalidParts::check("gain", parts.gain, 1e-10..=1e10)?;
        let (coordinates, circles) = shape(parts.method, parts.periods.len());
        Ok(Odds {
            method: parts.method,
            periods: parts.periods.clone(),
            mean: parts.mean,
            background: parts.background,
            log_ones: parts.log_ones,
            log_zeros: parts.log_zeros,
            gain: parts.gain,
            ones: Mixture::from_parts(&parts.ones, coordinates, circles)?,
            zeros: Mixture::from_parts(&parts.zeros, coordinates, circles)?,
        })
    }
}

/// ln of the sum of two exponentials.
fn log_sum(one: f64, other: f64) -> f64 {
    let highest = one.max(other);
    highest + libm::log(libm::exp(one - highest) + libm::exp(other - highest))
}

/// ln of the mean of the exponentials.
fn log_mean(logs: &[f64]) -> f64 {
    let highest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    highest + libm::log(logs.iter().map(|log| libm::exp(log - highest)).sum::<f64>() / logs.len() as f64)
}
