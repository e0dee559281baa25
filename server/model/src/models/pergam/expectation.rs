//! Expectation-maximisation of wrapped Gaussians on a circle.
//!
//! The turn and the Gaussian of a phase are hidden variables. Both are estimated, so that the likelihood never falls,
//! and a Gaussian may grow until it is flat. Invariant: weights add up to 1 or there are none; widths are between one
//! phase and one turn.

use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};

use crate::StopSignal;

const STARTS: u64 = 3;
const STEPS_MAX: usize = 100;
/// The least gain of a step that continues the training, in nats per unit of mass.
const GAIN_MIN: f64 = 1e-6;
/// At one turn a wrapped Gaussian is flat to 6e-9.
const DEVIATION_MAX: f64 = 1.0;

/// A Gaussian wrapped around the circle; its numbers are in turns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WrappedGaussian {
    pub(super) weight: f64,
    /// The mean, from 0 to 1.
    pub(super) mean: f64,
    pub(super) deviation: f64,
}

impl WrappedGaussian {
    /// Number of turns to either side beyond which images are more than four deviations away.
    fn images(&self) -> i32 {
        if self.deviation < 0.06 { 0 } else { (4.0 * self.deviation + 0.5).ceil() as i32 }
    }

    /// The shortest signed distance to a phase, from -0.5 to 0.5.
    fn distance(&self, turn: f64) -> f64 {
        let distance = turn - self.mean;
        distance - distance.round()
    }

    /// Calls `each` with every image's distance and density.
    fn for_images(&self, turn: f64, mut call: impl FnMut(f64, f64)) {
        let nearest = self.distance(turn);
        let images = self.images();
        let scale = 1.0 / (self.deviation * std::f64::consts::TAU.sqrt());
        for image in -images..=images {
            let distance = nearest + f64::from(image);
            let standard = distance / self.deviation;
            call(distance, scale * libm::exp(-0.5 * standard * standard));
        }
    }

    /// Probability density at a phase, per turn, without the weight.
    pub(super) fn density(&self, turn: f64) -> f64 {
        let mut sum = 0.0;
        self.for_images(turn, |_, density| sum += density);
        sum
    }
}

/// The likeliest mixture found from several starts; `shares` are masses at equally spaced phases, not negative. The
/// mixture is empty without mass. Training ends early if it is stopped; the result must then not be used.
pub(super) fn train_wrapped(shares: &[f64], gaussians: usize, seed: u64, stop: StopSignal<'_>) -> Vec<WrappedGaussian> {
    let mass: f64 = shares.iter().sum();
    let distinct = shares.iter().filter(|&&share| share > 0.0).count();
    if distinct == 0 || mass <= 0.0 {
        return Vec::new();
    }
    let (lowest, highest) = shares.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), &share| (a.min(share), b.max(share)));
    if highest - lowest <= highest * 1e-12 {
        return vec![WrappedGaussian { weight: 1.0, mean: 0.5, deviation: DEVIATION_MAX }];
    }
    let gaussians = gaussians.clamp(1, distinct);
    let starts = if gaussians == 1 { 1 } else { STARTS };
    let mut best: (f64, Vec<WrappedGaussian>) = (f64::NEG_INFINITY, Vec::new());
    for start in 0..starts {
        let mut rng = SmallRng::seed_from_u64(seed.wrapping_add(start));
        let means: Vec<f64> = (0..gaussians)
            .map(|index| {
                // The first start is spread evenly over the mass, the others are drawn from it.
                let even = (index as f64 + 0.5) / gaussians as f64;
                quantile(shares, mass, if start == 0 { even } else { rng.random() })
            })
            .collect();
        let found = maximise(shares, &means, stop);
        if found.0 > best.0 || best.1.is_empty() {
            best = found;
        }
    }
    let weights: f64 = best.1.iter().map(|gaussian| gaussian.weight).sum();
    debug_assert!(best.1.is_empty() || (weights - 1.0).abs() < 1e-9, "weights sum to {weights}");
    best.1
}

/// The phase below which `share` of the mass lies.
fn quantile(shares: &[f64], mass: f64, share: f64) -> f64 {
    let mut below = 0.0;
    for (phase, &here) in shares.iter().enumerate() {
        below += here;
        if below >= share * mass {
            return (phase as f64 + 0.5) / shares.len() as f64;
        }
    }
    0.5
}

/// Log-likelihood per unit of mass, and the mixture.
fn maximise(shares: &[f64], means: &[f64], stop: StopSignal<'_>) -> (f64, Vec<WrappedGaussian>) {
    let count = means.len() as f64;
    let mut mixture: Vec<WrappedGaussian> = means
        .iter()
        .map(|&mean| WrappedGaussian { weight: 1.0 / count, mean, deviation: 0.25 / count.sqrt() })
        .collect();
    let mut likelihood = f64::NEG_INFINITY;
    for _ in 0..STEPS_MAX {
        let before = likelihood;
        likelihood = step(shares, &mut mixture);
        if likelihood - before < GAIN_MIN || stop.is_set() {
            break;
        }
    }
    (likelihood, mixture)
}

/// One step for both hidden variables; the likelihood is that of the mixture before it.
fn step(shares: &[f64], mixture: &mut Vec<WrappedGaussian>) -> f64 {
    let mut moments = vec![[0.0_f64; 3]; mixture.len()];
    let mut here = vec![[0.0_f64; 3]; mixture.len()];
    let (mut mass, mut likelihood) = (0.0, 0.0);
    for (phase, &share) in shares.iter().enumerate().filter(|(_, share)| **share > 0.0) {
        let turn = (phase as f64 + 0.5) / shares.len() as f64;
        let mut density = 0.0;
        for (gaussian, here) in mixture.iter().zip(&mut here) {
            *here = [0.0; 3];
            gaussian.for_images(turn, |distance, image| {
                // The part is above 0 at any distance, so that every phase belongs to a Gaussian.
                let part = gaussian.weight * image.max(1e-200);
                here[0] += part;
                here[1] += part * distance;
                here[2] += part * distance * distance;
            });
            density += here[0];
        }
        for (sum, here) in moments.iter_mut().zip(&here) {
            for (sum, here) in sum.iter_mut().zip(here) {
                *sum += share * here / density;
            }
        }
        mass += share;
        likelihood += share * libm::log(density);
    }
    let least_deviation = 1.0 / shares.len() as f64;
    for (gaussian, [count, first, second]) in mixture.iter_mut().zip(moments) {
        gaussian.weight = count / mass;
        if count > 0.0 {
            let shift = first / count;
            let variance = (second / count - shift * shift).max(0.0);
            gaussian.mean = (gaussian.mean + shift).rem_euclid(1.0);
            gaussian.deviation = variance.sqrt().clamp(least_deviation, DEVIATION_MAX);
        }
    }
    mixture.retain(|gaussian| gaussian.weight > 1e-9);
    likelihood / mass
}
