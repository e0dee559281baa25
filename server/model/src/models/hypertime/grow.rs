//! The iterative scheme of warped hypertime (RA-L 2019 section III.C): cluster, find the strongest period left in the
//! error, add a circle for it, and stop when the error no longer falls.
//!
//! The error is that of held-out readings, by blocks of days: on training readings it falls with nearly every circle,
//! so that the rule as printed overfits. Clustering depends on its start, so the best of several starts is kept, by the
//! likelihood of the held-out readings. Invariant: the result is no worse on these readings than the model without
//! time.

use rand::SeedableRng;
use rand::rngs::SmallRng;
use rand::seq::SliceRandom;

use super::candidates::{Candidates, HypertimePeriod, PERIODS_MAX};
use super::residuals::Residuals;
use super::{HypertimeMethod, HypertimeOptions};
use crate::{StopSignal, civil::NANOS_PER_SEC};

/// Maximum number of blocks of readings that are held out in turn.
const FOLDS_MAX: usize = 4;
const STARTS: u64 = 4;
/// Number of starts with many clusters: most clusters then end in the same positions from any start.
const STARTS_OF_MANY: u64 = 2;
const MANY_CLUSTERS: usize = 20;
/// A further circle must lower the error to this factor: it adds two dimensions, and a circle that follows only noise
/// gains less.
const CIRCLE_WORTH: f64 = 0.99;
/// A further cluster must lower the strength of the periods in the error to this factor.
const CLUSTER_WORTH: f64 = 0.999;
const DAY_NANOS: i64 = 86_400 * NANOS_PER_SEC;
const HOUR_NANOS: i64 = 3_600 * NANOS_PER_SEC;

/// The circles of a model and of the models that leave a fold out, by their periods. They may differ: if a period were
/// searched in the readings that later judge it, noise would count as a rhythm.
#[derive(Clone, Debug, Default)]
pub(super) struct Circles {
    pub(super) all: Vec<HypertimePeriod>,
    /// For each fold, the circles of the model without it.
    pub(super) without: Vec<Vec<HypertimePeriod>>,
}

impl Circles {
    /// Adds one circle to each model, from the error on its own readings; false if there is none to add.
    fn extend(&mut self, residuals: &[Residuals], candidates: &Candidates) -> bool {
        let strongest = |residuals: Option<Residuals>, taken: &[HypertimePeriod]| {
            residuals.and_then(|residuals| residuals.strongest(candidates, taken))
        };
        let Some(period) = strongest(Residuals::combined(residuals.iter()), &self.all) else {
            return false;
        };
        self.all.push(period);
        for (fold, periods) in self.without.iter_mut().enumerate() {
            let others = residuals.iter().enumerate().filter(|(other, _)| *other != fold);
            let found = strongest(Residuals::combined(others.map(|(_, residuals)| residuals)), periods);
            let taken = periods.contains(&period);
            match found {
                Some(found) => periods.push(found),
                None if !taken => periods.push(period),
                None => return false,
            }
        }
        true
    }
}

/// A model of all readings, with the errors of such models on held-out readings.
pub(super) struct Attempt<M> {
    pub(super) model: M,
    /// Mean squared error.
    pub(super) error: f64,
    /// Mean log-likelihood.
    pub(super) log_likelihood: f64,
    /// The residuals of each fold, by the model without it.
    pub(super) residuals: Vec<Residuals>,
}

impl<M> Attempt<M> {
    fn strength(&self, candidates: &Candidates) -> f64 {
        Residuals::combined(self.residuals.iter()).map_or(0.0, |residuals| residuals.total_strength(candidates))
    }
}

/// The quality of the predictions of held-out readings.
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

/// Training data in the form that a model with given circles needs.
pub(super) trait Trainer<M> {
    /// The periods to choose among.
    fn candidates(&self) -> &Candidates;

    /// Trains with these circles; the seed is for the start of the clustering.
    fn attempt(&self, circles: &Circles, clusters: usize, seed: u64) -> Attempt<M>;
}

/// The parameters of a model's growth.
pub(super) struct Growth<'a> {
    /// Number of folds of the training data.
    pub(super) folds: usize,
    /// Ends the growth early; its result must then not be used.
    pub(super) stop: StopSignal<'a>,
}

/// Grows a model circle by circle.
pub(super) fn grow<M, F: Trainer<M>>(trainer: &F, growth: &Growth<'_>, options: &HypertimeOptions) -> M {
    let mut circles = Circles { all: Vec::new(), without: vec![Vec::new(); growth.folds] };
    let mut clusters = match options.method {
        HypertimeMethod::Em => options.clusters,
        HypertimeMethod::Km => 1,
    };
    if growth.folds < 2 {
        return trainer.attempt(&circles, 1, options.seed).model;
    }
    let mut best = clustered(trainer, &circles, &mut clusters, options, growth.stop);
    while circles.all.len() < PERIODS_MAX && circles.extend(&best.residuals, trainer.candidates()) {
        let next = clustered(trainer, &circles, &mut clusters, options, growth.stop);
        if growth.stop.is_set() || next.error >= best.error * CIRCLE_WORTH {
            break;
        }
        best = next;
    }
    best.model
}

/// The best of several starts; with HyT-KM, adds clusters as long as the periods left in the error become weaker (eq.
/// 8).
fn clustered<M, F: Trainer<M>>(
    trainer: &F,
    circles: &Circles,
    clusters: &mut usize,
    options: &HypertimeOptions,
    stop: StopSignal<'_>,
) -> Attempt<M> {
    let mut best = best_start(trainer, circles, *clusters, options.seed, stop);
    while options.method == HypertimeMethod::Km && *clusters < options.clusters {
        let next = best_start(trainer, circles, *clusters + 1, options.seed, stop);
        if stop.is_set() || next.strength(trainer.candidates()) >= best.strength(trainer.candidates()) * CLUSTER_WORTH {
            break;
        }
        best = next;
        *clusters += 1;
    }
    best
}

fn best_start<M, F: Trainer<M>>(
    trainer: &F,
    circles: &Circles,
    clusters: usize,
    seed: u64,
    stop: StopSignal<'_>,
) -> Attempt<M> {
    let mut best = trainer.attempt(circles, clusters, seed);
    let starts = match clusters {
        // All starts give the same result.
        1 => 1,
        _ if clusters > MANY_CLUSTERS => STARTS_OF_MANY,
        _ => STARTS,
    };
    for start in 1..starts {
        if stop.is_set() {
            break;
        }
        let next = trainer.attempt(circles, clusters, seed.wrapping_add(start));
        if next.log_likelihood > best.log_likelihood {
            best = next;
        }
    }
    best
}

/// The assignment of days to folds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Dealing {
    /// Every fourth day.
    InTurn,
    /// Days in a random order that is the same in every run.
    Shuffled,
}

/// Splits readings (by their local civil times) into folds of local days, or of hours if there are fewer days than
/// folds. Returns the fold of each reading and the number of folds.
///
/// In turn, successive days belong to successive folds, so that each day of the week, or hour of the day, comes into
/// each fold.
/// The folds do not depend on the seed: which days judge a circle would otherwise decide more than the data.
pub(super) fn deal(civil_nanos: &[i64], dealing: Dealing) -> (Vec<usize>, usize) {
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
    let folds = blocks.len().clamp(1, FOLDS_MAX);
    // The folds divide a day's hours, so they are shifted from day to day. They do not divide a week's days.
    let shift = |block: i64| if length == HOUR_NANOS { block.div_euclid(24) } else { 0 };
    let mut dealt: Vec<usize> =
        blocks.iter().map(|&block| (block + shift(block)).rem_euclid(folds as i64) as usize).collect();
    let least = (0..folds).map(|fold| dealt.iter().filter(|dealt| **dealt == fold).count()).min();
    // The folds are unequal, for example with readings of every fourth day only.
    if least.unwrap_or(0) * 2 * folds < blocks.len() {
        dealt = (0..blocks.len()).map(|index| index % folds).collect();
    }
    if dealing == Dealing::Shuffled {
        dealt = (0..blocks.len()).map(|index| index % folds).collect();
        dealt.shuffle(&mut SmallRng::seed_from_u64(0));
    }
    let fold_of = |nanos: &i64| blocks.binary_search(&nanos.div_euclid(length)).map_or(0, |block| dealt[block]);
    (civil_nanos.iter().map(fold_of).collect(), folds)
}

/// The weight of independent readings: the total weight divided by the number of local hours with readings.
pub(super) fn unit_weight(civil_nanos: &[i64], weight: f64) -> f64 {
    let mut hours: Vec<i64> = civil_nanos.iter().map(|nanos| nanos.div_euclid(HOUR_NANOS)).collect();
    hours.sort_unstable();
    hours.dedup();
    (weight / hours.len().max(1) as f64).max(f64::MIN_POSITIVE)
}
