//! A probability in hypertime: the density of readings that are 1 against that of readings that are 0.
//!
//! p = γ·n₁f₁/(n₁f₁ + n₀f₀), which is eq. 2 of RA-L 2019 with a fixed at 1 and at 0; a reading between 0 and 1 counts
//! for both. γ makes the mean prediction over the readings equal to their mean (eq. 3, as its text says; the sum
//! printed in its denominator runs over the readings that are 1 alone). Densities are those of the plane in which each
//! circle lies. Invariant: a prediction lies in `[0,1]`, and where there is no data it tends to the mean.

use super::grow::{Attempt, Circles, HeldOutScore, Trainer};
use super::mixture::Mixture;
use super::seeding::Points;
use super::week::{Residuals, SLOTS, check_divisors, project, slot_turn};
use super::{HypertimeCluster, HypertimeMethod};
use crate::{InvalidParts, StopSignal};

const FIRST_STEPS: usize = 60;
const FOLD_STEPS: usize = 15;
/// Probabilities are clipped to this and 1 minus this for scoring.
const PROBABILITY_MIN: f64 = 1e-4;
/// Bound on logarithms, so that two of them can be added and exponentiated.
const LOG_MAX: f64 = 300.0;
/// Bound on ln γ.
const GAIN_LOG_MAX: f64 = 20.0;

/// What a hypertime model of a probability consists of, for storage.
#[derive(Clone, Debug, PartialEq)]
pub struct HypertimeOddsParts {
    /// The method of clustering.
    pub method: HypertimeMethod,
    /// The periods, as divisors of a week, in the order found; at most five.
    pub week_divisors: Vec<u32>,
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
    divisors: Vec<u32>,
    mean: f64,
    background: f64,
    log_ones: f64,
    log_zeros: f64,
    gain: f64,
    ones: Mixture,
    zeros: Mixture,
}

/// Weights of readings by slot of the week: of 1, and of 0.
#[derive(Clone, Debug)]
pub(super) struct SlotWeights {
    pub(super) ones: Vec<f64>,
    pub(super) zeros: Vec<f64>,
}

impl SlotWeights {
    pub(super) fn new() -> SlotWeights {
        SlotWeights { ones: vec![0.0; SLOTS], zeros: vec![0.0; SLOTS] }
    }

    /// A value in `[0,1]` adds to both.
    pub(super) fn add(&mut self, slot: usize, weight: f64, value: f64) {
        self.ones[slot] += weight * value;
        self.zeros[slot] += weight * (1.0 - value);
    }

    fn combined<'a>(folds: impl Iterator<Item = &'a SlotWeights>) -> SlotWeights {
        folds.fold(SlotWeights::new(), |mut sum, counts| {
            sum.ones.iter_mut().zip(&counts.ones).for_each(|(sum, count)| *sum += count);
            sum.zeros.iter_mut().zip(&counts.zeros).for_each(|(sum, count)| *sum += count);
            sum
        })
    }

    fn mean(&self) -> f64 {
        let (ones, zeros): (f64, f64) = (self.ones.iter().sum(), self.zeros.iter().sum());
        (ones / (ones + zeros)).clamp(0.0, 1.0)
    }
}

/// Readings of a probability, by fold.
pub(super) struct Folds<'a> {
    pub(super) folds: Vec<SlotWeights>,
    pub(super) method: HypertimeMethod,
    /// The weight of independent readings.
    pub(super) unit: f64,
    pub(super) stop: StopSignal<'a>,
}

impl Trainer<Odds> for Folds<'_> {
    fn attempt(&self, circles: &Circles, clusters: usize, seed: u64) -> Attempt<Odds> {
        let all = SlotWeights::combined(self.folds.iter());
        let hypertime = Hypergrid::new(&circles.all);
        let fresh = |hypertime: &Hypergrid, weights: &[f64]| {
            Mixture::fit(&hypertime.points(weights, (self.method, self.unit, self.stop)), clusters, seed, FIRST_STEPS)
        };
        let model = self.calibrated(&hypertime, &all, || (fresh(&hypertime, &all.ones), fresh(&hypertime, &all.zeros)));
        let mut score = HeldOutScore::default();
        for (index, (left_out, divisors)) in self.folds.iter().zip(&circles.without).enumerate() {
            let others = self.folds.iter().enumerate().filter(|(other, _)| *other != index);
            let seen = SlotWeights::combined(others.map(|(_, counts)| counts));
            // Starts from the fit to all readings, so that its optimum is judged; with other circles, from scratch.
            let again = |mixture: &Mixture, weights: &[f64]| {
                let mut mixture = mixture.clone();
                mixture.refit(&hypertime.points(weights, (self.method, self.unit, self.stop)), FOLD_STEPS);
                mixture
            };
            if *divisors == circles.all {
                let mixtures = || (again(&model.ones, &seen.ones), again(&model.zeros, &seen.zeros));
                score.add(&self.calibrated(&hypertime, &seen, mixtures), &hypertime, left_out);
            } else {
                let other = Hypergrid::new(divisors);
                let mixtures = || (fresh(&other, &seen.ones), fresh(&other, &seen.zeros));
                score.add(&self.calibrated(&other, &seen, mixtures), &other, left_out);
            }
        }
        score.attempt(model)
    }
}

impl Folds<'_> {
    /// The mean if there is no period or only one kind of reading; else the mixtures with their factor.
    fn calibrated(
        &self,
        hypertime: &Hypergrid,
        counts: &SlotWeights,
        mixtures: impl FnOnce() -> (Mixture, Mixture),
    ) -> Odds {
        let mean = counts.mean();
        let mut odds = Odds {
            method: self.method,
            divisors: hypertime.divisors.clone(),
            mean,
            background: self.unit,
            log_ones: 0.0,
            log_zeros: 0.0,
            gain: 1.0,
            ones: Mixture::default(),
            zeros: Mixture::default(),
        };
        // Also if there is too little of one kind.
        if hypertime.divisors.is_empty() || mean <= 1e-9 || mean >= 1.0 - 1e-9 {
            return odds;
        }
        (odds.ones, odds.zeros) = mixtures();
        if odds.is_constant() {
            return odds;
        }
        let (ones, zeros): (f64, f64) = (counts.ones.iter().sum(), counts.zeros.iter().sum());
        let logs: Vec<(f64, f64)> = (0..SLOTS).map(|slot| odds.log_densities(hypertime.point(slot))).collect();
        // The mean of the density of all readings over the week is their number, so that the prior has its weight.
        let both = |&(one, zero): &(f64, f64)| log_sum(ones.ln() + one, zeros.ln() + zero);
        let level = log_mean(logs.iter().map(both)) - (ones + zeros).ln();
        odds.log_ones = (ones.ln() - level).clamp(-LOG_MAX, LOG_MAX);
        odds.log_zeros = (zeros.ln() - level).clamp(-LOG_MAX, LOG_MAX);
        odds.gain = odds.gain_for(counts, &logs);
        odds
    }
}

impl HeldOutScore {
    fn add(&mut self, fitted: &Odds, hypertime: &Hypergrid, left_out: &SlotWeights) {
        let mut residuals = Residuals::new(1);
        for (slot, (&ones, &zeros)) in left_out.ones.iter().zip(&left_out.zeros).enumerate() {
            if ones + zeros > 0.0 {
                let p = fitted.at_point(hypertime.point(slot));
                self.squared += ones * (1.0 - p) * (1.0 - p) + zeros * p * p;
                let scored = p.clamp(PROBABILITY_MIN, 1.0 - PROBABILITY_MIN);
                self.logs += ones * scored.ln() + zeros * (1.0 - scored).ln();
                self.total += ones + zeros;
                residuals.add(slot, 0, ones + zeros, p - ones / (ones + zeros));
            }
        }
        self.residuals.push(residuals);
    }
}

/// Every slot of the week in hypertime.
struct Hypergrid {
    divisors: Vec<u32>,
    numbers: Vec<f64>,
}

impl Hypergrid {
    fn new(divisors: &[u32]) -> Hypergrid {
        let mut numbers = Vec::new();
        for slot in 0..SLOTS {
            project(slot_turn(slot), divisors, &mut numbers);
        }
        Hypergrid { divisors: divisors.to_vec(), numbers }
    }

    fn point(&self, slot: usize) -> &[f64] {
        let stride = 2 * self.divisors.len();
        &self.numbers[slot * stride..][..stride]
    }

    /// The slots with weight.
    fn points<'a>(&self, weights: &[f64], (method, unit, stop): (HypertimeMethod, f64, StopSignal<'a>)) -> Points<'a> {
        let (coordinates, circles) = shape(method, self.divisors.len());
        let mut points = Points::new(coordinates, circles, unit, stop);
        for (slot, &weight) in weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
            points.numbers.extend_from_slice(self.point(slot));
            points.weights.push(weight);
        }
        points
    }
}

/// Coordinates of the Gaussians, and circles.
fn shape(method: HypertimeMethod, periods: usize) -> (usize, usize) {
    match method {
        HypertimeMethod::Em => (2 * periods, 0),
        HypertimeMethod::Km => (0, periods),
    }
}

impl Odds {
    /// γ (eq. 3), by bisection of its logarithm: predictions end at 1, and their mean is monotonic in γ.
    fn gain_for(&self, counts: &SlotWeights, logs: &[(f64, f64)]) -> f64 {
        let both = counts.ones.iter().zip(&counts.zeros).map(|(ones, zeros)| ones + zeros);
        let ratios = logs.iter().map(|&(one, zero)| self.ratio(one, zero));
        let observed: Vec<(f64, f64)> = both.zip(ratios).filter(|(weight, _)| *weight > 0.0).collect();
        let (mut low, mut high) = (-GAIN_LOG_MAX, GAIN_LOG_MAX);
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            let gain = middle.exp();
            let excess: f64 =
                observed.iter().map(|(weight, ratio)| weight * ((gain * ratio).min(1.0) - self.mean)).sum();
            if excess > 0.0 {
                high = middle;
            } else {
                low = middle;
            }
        }
        (0.5 * (low + high)).exp()
    }

    fn is_constant(&self) -> bool {
        self.ones.clusters.is_empty() || self.zeros.clusters.is_empty()
    }

    fn log_densities(&self, point: &[f64]) -> (f64, f64) {
        let (coordinates, _) = shape(self.method, self.divisors.len());
        (self.ones.log_densities(point, coordinates, 0).1, self.zeros.log_densities(point, coordinates, 0).1)
    }

    /// The prediction before γ.
    fn ratio(&self, log_one: f64, log_zero: f64) -> f64 {
        let ones = (self.log_ones + log_one).min(2.0 * LOG_MAX).exp();
        let zeros = (self.log_zeros + log_zero).min(2.0 * LOG_MAX).exp();
        ((ones + self.background * self.mean) / (ones + zeros + self.background)).clamp(0.0, 1.0)
    }

    fn at_point(&self, point: &[f64]) -> f64 {
        if self.is_constant() {
            return self.mean;
        }
        let (log_one, log_zero) = self.log_densities(point);
        (self.gain * self.ratio(log_one, log_zero)).min(1.0)
    }

    /// The probability at a position in the week, in turns.
    pub(super) fn at(&self, turn: f64) -> f64 {
        let mut point = Vec::with_capacity(2 * self.divisors.len());
        project(turn, &self.divisors, &mut point);
        self.at_point(&point)
    }

    pub(super) fn method(&self) -> HypertimeMethod {
        self.method
    }

    pub(super) fn divisors(&self) -> &[u32] {
        &self.divisors
    }

    pub(super) fn to_parts(&self) -> HypertimeOddsParts {
        HypertimeOddsParts {
            method: self.method,
            week_divisors: self.divisors.clone(),
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
        check_divisors(&parts.week_divisors)?;
        InvalidParts::check("mean", parts.mean, 0.0..=1.0)?;
        InvalidParts::check("background", parts.background, 1e-300..=1e18)?;
        InvalidParts::check("log_ones", parts.log_ones, -2.0 * LOG_MAX..=2.0 * LOG_MAX)?;
        InvalidParts::check("log_zeros", parts.log_zeros, -2.0 * LOG_MAX..=2.0 * LOG_MAX)?;
        InvalidParts::check("gain", parts.gain, 1e-10..=1e10)?;
        let (coordinates, circles) = shape(parts.method, parts.week_divisors.len());
        Ok(Odds {
            method: parts.method,
            divisors: parts.week_divisors.clone(),
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
    let most = one.max(other);
    most + ((one - most).exp() + (other - most).exp()).ln()
}

/// ln of the mean of the exponentials.
fn log_mean(logs: impl Iterator<Item = f64> + Clone) -> f64 {
    let most = logs.clone().fold(f64::NEG_INFINITY, f64::max);
    let (sum, count) = logs.fold((0.0, 0.0), |(sum, count), log| (sum + (log - most).exp(), count + 1.0));
    most + (sum / count).ln()
}
