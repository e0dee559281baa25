//! The iterative scheme of warped hypertime (RA-L 2019 section III.C): cluster, look where the error has a period
//! left, add a circle for it, and stop when the error no longer falls.
//!
//! The error is that of readings left out of the fit, by blocks of days: on training readings it falls with nearly
//! every circle, so that the rule as printed overfits. Clustering depends on its start, so of several starts the one
//! is kept under which the readings left out are likeliest. Invariant: what is returned is no worse on those readings
//! than the model without time.

use rand::SeedableRng;
use rand::rngs::SmallRng;
use rand::seq::SliceRandom;

use super::week::{PERIODS_MAX, Residuals};
use super::{HypertimeMethod, HypertimeOptions};
use crate::civil::NANOS_PER_SEC;

/// Most blocks of readings that are left out in turn.
const FOLDS_MAX: usize = 4;
const STARTS: u64 = 4;
/// Starts where there are many clusters: most of them end in places that are needed whatever the start.
const STARTS_OF_MANY: u64 = 2;
const MANY_CLUSTERS: usize = 20;
/// A circle more must lower the error to this: it brings two dimensions, and one that only noise speaks for gains less.
const CIRCLE_WORTH: f64 = 0.99;
/// A cluster more must lower the strength of the periods in the error to this.
const CLUSTER_WORTH: f64 = 0.999;
const DAY_NANOS: i64 = 86_400 * NANOS_PER_SEC;
const HOUR_NANOS: i64 = 3_600 * NANOS_PER_SEC;

/// The circles of a model and of the fits that leave a fold out, as divisors of a week. They may differ: if a period
/// were sought in the readings that it is then judged by, noise would pass for a rhythm.
#[derive(Clone, Debug, Default)]
pub(super) struct Circles {
    pub(super) all: Vec<u32>,
    /// For each fold, those of the fit without it.
    pub(super) without: Vec<Vec<u32>>,
}

impl Circles {
    /// One circle more, each from the error of those readings that may be looked at; false where there is none to add.
    fn extend(&mut self, residuals: &[Residuals], span_nanos: u64) -> bool {
        let Some(divisor) = Residuals::combined(residuals.iter()).strongest(&self.all, span_nanos) else {
            return false;
        };
        self.all.push(divisor);
        for (fold, divisors) in self.without.iter_mut().enumerate() {
            let others = residuals.iter().enumerate().filter(|(other, _)| *other != fold);
            let found = Residuals::combined(others.map(|(_, residuals)| residuals)).strongest(divisors, span_nanos);
            let taken = divisors.contains(&divisor);
            match found {
                Some(found) => divisors.push(found),
                None if !taken => divisors.push(divisor),
                None => return false,
            }
        }
        true
    }
}

/// A fit to all readings, and how fits like it did on readings left out of them.
pub(super) struct Attempt<M> {
    pub(super) model: M,
    /// Mean squared error.
    pub(super) error: f64,
    /// Mean log-likelihood.
    pub(super) log_likelihood: f64,
    /// Of each fold, by the fit without it.
    pub(super) residuals: Vec<Residuals>,
}

impl<M> Attempt<M> {
    fn strength(&self) -> f64 {
        Residuals::combined(self.residuals.iter()).total_strength()
    }
}

/// How well readings left out were predicted.
#[derive(Default)]
pub(super) struct HeldOutScore {
    /// Sum of weight · squared error.
    pub(super) squared: f64,
    /// Sum of weight · log-likelihood.
    pub(super) logs: f64,
    /// Sum of weights.
    pub(super) total: f64,
    pub(super) residuals: Vec<Residuals>,
}

impl HeldOutScore {
    pub(super) fn attempt<M>(self, model: M) -> Attempt<M> {
        let (error, log_likelihood) = (self.squared / self.total, self.logs / self.total);
        Attempt { model, error, log_likelihood, residuals: self.residuals }
    }
}

/// Something that can be fitted with given circles.
pub(super) trait Trainer<M> {
    /// Fits with these circles; the seed is for the start of the clustering.
    fn attempt(&self, circles: &Circles, clusters: usize, seed: u64) -> Attempt<M>;
}

/// What is fitted to: how long the readings span, and whether any can be left out.
pub(super) struct Extent {
    /// UTC.
    pub(super) span_nanos: u64,
    pub(super) folds: usize,
}

/// Grows a model circle by circle.
pub(super) fn grow<M, F: Trainer<M>>(fit: &F, extent: &Extent, options: &HypertimeOptions) -> M {
    let mut circles = Circles { all: Vec::new(), without: vec![Vec::new(); extent.folds] };
    let mut clusters = match options.method {
        HypertimeMethod::Em => options.clusters,
        HypertimeMethod::Km => 1,
    };
    if extent.folds < 2 {
        return fit.attempt(&circles, 1, options.seed).model;
    }
    let mut best = clustered(fit, &circles, &mut clusters, options);
    while circles.all.len() < PERIODS_MAX && circles.extend(&best.residuals, extent.span_nanos) {
        let next = clustered(fit, &circles, &mut clusters, options);
        if next.error >= best.error * CIRCLE_WORTH {
            break;
        }
        best = next;
    }
    best.model
}

/// The best of several starts; with HyT-KM, of as many clusters as make the periods left in the error weaker (eq. 8).
fn clustered<M, F: Trainer<M>>(
    fit: &F,
    circles: &Circles,
    clusters: &mut usize,
    options: &HypertimeOptions,
) -> Attempt<M> {
    let mut best = best_start(fit, circles, *clusters, options.seed);
    while options.method == HypertimeMethod::Km && *clusters < options.clusters {
        let next = best_start(fit, circles, *clusters + 1, options.seed);
        if next.strength() >= best.strength() * CLUSTER_WORTH {
            break;
        }
        best = next;
        *clusters += 1;
    }
    best
}

fn best_start<M, F: Trainer<M>>(fit: &F, circles: &Circles, clusters: usize, seed: u64) -> Attempt<M> {
    let mut best = fit.attempt(circles, clusters, seed);
    let starts = match clusters {
        // The same from any start.
        1 => 1,
        _ if clusters > MANY_CLUSTERS => STARTS_OF_MANY,
        _ => STARTS,
    };
    for start in 1..starts {
        let next = fit.attempt(circles, clusters, seed.wrapping_add(start));
        if next.log_likelihood > best.log_likelihood {
            best = next;
        }
    }
    best
}

/// Deals readings (by their local civil times) into folds, a local day at a time, or an hour where there are fewer days
/// than folds: the fold of each, and how many folds.
pub(super) fn deal(civil_nanos: &[i64], seed: u64) -> (Vec<usize>, usize) {
    let blocks_of = |length: i64| {
        let mut blocks: Vec<i64> = civil_nanos.iter().map(|nanos| nanos.div_euclid(length)).collect();
        blocks.sort_unstable();
        blocks.dedup();
        blocks
    };
    let (mut length, mut blocks) = (DAY_NANOS, blocks_of(DAY_NANOS));
    if blocks.len() < FOLDS_MAX {
        (length, blocks) = (HOUR_NANOS, blocks_of(HOUR_NANOS));
    }
    let folds = blocks.len().min(FOLDS_MAX);
    // Drawn, not in turn, so that no weekday is always in the same fold.
    let mut dealt: Vec<usize> = (0..blocks.len()).map(|index| index % folds.max(1)).collect();
    dealt.shuffle(&mut SmallRng::seed_from_u64(seed));
    let fold_of = |nanos: &i64| blocks.binary_search(&nanos.div_euclid(length)).map_or(0, |block| dealt[block]);
    (civil_nanos.iter().map(fold_of).collect(), folds)
}

/// What readings weigh that can be taken as independent: all weight divided by the local hours that have readings.
pub(super) fn unit_weight(civil_nanos: &[i64], weight: f64) -> f64 {
    let mut hours: Vec<i64> = civil_nanos.iter().map(|nanos| nanos.div_euclid(HOUR_NANOS)).collect();
    hours.sort_unstable();
    hours.dedup();
    (weight / hours.len().max(1) as f64).max(f64::MIN_POSITIVE)
}
