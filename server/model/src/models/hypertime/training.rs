//! Readings of a probability in hypertime, and models of them that leave a fold out.
//!
//! Readings are summed by slots, so that years of them take little longer than weeks: by slots of the candidates' cycle
//! for circles that divide it, by slots of time for others. Invariant: a model uses only the weights of its folds.

use std::collections::BTreeMap;

use super::HypertimeMethod;
use super::candidates::{Candidates, HypertimePeriod, project};
use super::grow::{Attempt, Circles, HeldOutScore, Trainer};
use super::mixture::Mixture;
use super::odds::{Odds, shape};
use super::residuals::Residuals;
use super::seeding::Points;
use crate::{StopSignal, civil::NANOS_PER_SEC};

const FIRST_STEPS: usize = 60;
const FOLD_STEPS: usize = 15;
/// Probabilities are clipped to this and 1 minus this for scoring.
const PROBABILITY_MIN: f64 = 1e-4;
/// Maximum number of slots of time. The shortest is five minutes; slots double in length until there are at most this
/// many.
const TIMES_MAX: usize = 8_760;
const TIME_MIN_NANOS: i64 = 300 * NANOS_PER_SEC;
/// Number of times that represent all times, spread evenly by the golden ratio.
const EVERYWHERE: u64 = 2_016;

/// A reading of a probability.
pub(super) struct OddsReading {
    pub(super) civil_nanos: i64,
    pub(super) fold: usize,
    /// The weight, above 0.
    pub(super) weight: f64,
    /// The probability, in `[0,1]`.
    pub(super) probability: f64,
}

/// Weights of readings by slot: those of 1, and those of 0.
#[derive(Clone, Debug)]
struct SlotWeights {
    ones: Vec<f64>,
    zeros: Vec<f64>,
}

impl SlotWeights {
    fn new(slots: usize) -> SlotWeights {
        SlotWeights { ones: vec![0.0; slots], zeros: vec![0.0; slots] }
    }

    /// Adds a reading; a value in `[0,1]` adds to both.
    fn add(&mut self, slot: usize, weight: f64, value: f64) {
        self.ones[slot] += weight * value;
        self.zeros[slot] += weight * (1.0 - value);
    }

    fn combined<'a>(slots: usize, folds: impl Iterator<Item = &'a SlotWeights>) -> SlotWeights {
        folds.fold(SlotWeights::new(slots), |mut sum, counts| {
            sum.ones.iter_mut().zip(&counts.ones).for_each(|(sum, count)| *sum += count);
            sum.zeros.iter_mut().zip(&counts.zeros).for_each(|(sum, count)| *sum += count);
            sum
        })
    }

    fn sums(&self) -> (f64, f64) {
        (self.ones.iter().sum(), self.zeros.iter().sum())
    }

    /// The weights of ones and zeros of each slot that has some.
    fn occupied(&self) -> impl Iterator<Item = (usize, f64, f64)> {
        let slots = self.ones.iter().zip(&self.zeros).enumerate();
        slots.map(|(slot, (&ones, &zeros))| (slot, ones, zeros)).filter(|(_, ones, zeros)| ones + zeros > 0.0)
    }
}

/// Readings of a probability, by fold.
pub(super) struct OddsTraining<'a> {
    candidates: Candidates,
    /// Weights by slot of the cycle, for each fold.
    by_cycle: Vec<SlotWeights>,
    /// Weights by slot of time, for each fold; no slots where all candidates divide the cycle.
    by_time: Vec<SlotWeights>,
    /// A local civil time in the middle of each slot of time.
    times: Vec<i64>,
    time_nanos: i64,
    /// Local civil times that represent all times.
    everywhere: Vec<i64>,
    method: HypertimeMethod,
    /// The weight of independent readings.
    unit: f64,
    stop: StopSignal<'a>,
}

impl<'a> OddsTraining<'a> {
    pub(super) fn new(
        readings: &[OddsReading],
        folds: usize,
        candidates: Candidates,
        (method, unit, stop): (HypertimeMethod, f64, StopSignal<'a>),
    ) -> OddsTraining<'a> {
        let mut by_cycle = vec![SlotWeights::new(candidates.slots()); folds];
        for reading in readings {
            let slot = candidates.slot(reading.civil_nanos);
            by_cycle[reading.fold].add(slot, reading.weight, reading.probability);
        }
        let (time_nanos, slots) =
            if candidates.others().is_empty() { (TIME_MIN_NANOS, BTreeMap::new()) } else { time_slots(readings) };
        let mut by_time = vec![SlotWeights::new(slots.len()); folds];
        if !slots.is_empty() {
            for reading in readings {
                if let Some(&slot) = slots.get(&reading.civil_nanos.div_euclid(time_nanos)) {
                    by_time[reading.fold].add(slot, reading.weight, reading.probability);
                }
            }
        }
        let middle = |slot: &i64| slot.saturating_mul(time_nanos).saturating_add(time_nanos / 2);
        let times: Vec<i64> = slots.keys().map(middle).collect();
        let everywhere = match (times.first(), times.last()) {
            (Some(&first), Some(&last)) => (0..EVERYWHERE).map(|index| evenly(index, first, last)).collect(),
            _ => Vec::new(),
        };
        OddsTraining { candidates, by_cycle, by_time, times, time_nanos, everywhere, method, unit, stop }
    }

    /// The mean if there is no period or only one kind of reading; else the mixtures with their factor.
    fn calibrated(
        &self,
        hypertime: &Hypergrid<'_>,
        counts: &SlotWeights,
        mixtures: impl FnOnce() -> (Mixture, Mixture),
    ) -> Odds {
        let (ones, zeros) = counts.sums();
        let mean = (ones / (ones + zeros)).clamp(0.0, 1.0);
        let odds = Odds::constant(self.method, &hypertime.periods, mean, self.unit);
        // The mean is also used if there is too little of one kind.
        if hypertime.periods.is_empty() || mean <= 1e-9 || mean >= 1.0 - 1e-9 {
            return odds;
        }
        let odds = odds.with_mixtures(mixtures(), (ones, zeros), hypertime.everywhere());
        odds.with_gain(counts.occupied().map(|(slot, ones, zeros)| (hypertime.point(slot), ones + zeros)))
    }

    fn mixtures(&self, hypertime: &Hypergrid<'_>, counts: &SlotWeights, start: (usize, u64)) -> (Mixture, Mixture) {
        let (clusters, seed) = start;
        let fresh = |weights: &[f64]| Mixture::train(&hypertime.points(weights), clusters, seed, FIRST_STEPS);
        (fresh(&counts.ones), fresh(&counts.zeros))
    }

    /// Adds the errors of a model on a fold that it was not trained on.
    fn score(&self, trained: &Odds, hypertime: &Hypergrid<'_>, fold: usize, score: &mut HeldOutScore) {
        let is_by_time = hypertime.is_by_time;
        let coarseness_nanos = if is_by_time { self.time_nanos } else { 0 };
        let mut residuals = Residuals::new(&self.candidates, 1).in_slots_of(coarseness_nanos);
        for (slot, ones, zeros) in hypertime.weights(fold).occupied() {
            let p = trained.at_point(hypertime.point(slot));
            score.squared += ones * (1.0 - p) * (1.0 - p) + zeros * p * p;
            let scored = p.clamp(PROBABILITY_MIN, 1.0 - PROBABILITY_MIN);
            score.logs += ones * libm::log(scored) + zeros * libm::log(1.0 - scored);
            score.total += ones + zeros;
            let slot = if is_by_time { self.candidates.slot(self.times[slot]) } else { slot };
            residuals.add(slot, 0, ones + zeros, p - ones / (ones + zeros));
        }
        for (slot, ones, zeros) in self.by_time[fold].occupied() {
            let time = self.times[slot];
            let error = trained.at(time) - ones / (ones + zeros);
            residuals.add_at(time, &self.candidates, (0, ones + zeros, error));
        }
        score.residuals.push(residuals);
    }
}

impl Trainer<Odds> for OddsTraining<'_> {
    fn candidates(&self) -> &Candidates {
        &self.candidates
    }

    fn attempt(&self, circles: &Circles, clusters: usize, seed: u64) -> Attempt<Odds> {
        let hypertime = Hypergrid::new(self, &circles.all);
        let all = hypertime.without(None);
        let start = (clusters, seed);
        let model = self.calibrated(&hypertime, &all, || self.mixtures(&hypertime, &all, start));
        let mut score = HeldOutScore::default();
        for (fold, periods) in circles.without.iter().enumerate() {
            let seen = hypertime.without(Some(fold));
            // The training starts from the model of all readings, so that its optimum is judged; with other circles,
            // from scratch.
            let again = |mixture: &Mixture, weights: &[f64]| {
                let mut mixture = mixture.clone();
                mixture.train_further(&hypertime.points(weights), FOLD_STEPS);
                mixture
            };
            if *periods == circles.all {
                let (ones, zeros) = model.mixtures();
                let mixtures = || (again(ones, &seen.ones), again(zeros, &seen.zeros));
                self.score(&self.calibrated(&hypertime, &seen, mixtures), &hypertime, fold, &mut score);
            } else {
                let other = Hypergrid::new(self, periods);
                let seen = other.without(Some(fold));
                let mixtures = || self.mixtures(&other, &seen, start);
                self.score(&self.calibrated(&other, &seen, mixtures), &other, fold, &mut score);
            }
        }
        score.attempt(model)
    }
}

/// Every slot in hypertime: slots of the cycle, or of time if a circle does not divide the cycle.
struct Hypergrid<'a> {
    training: &'a OddsTraining<'a>,
    periods: Vec<HypertimePeriod>,
    is_by_time: bool,
    numbers: Vec<f64>,
    /// Points that represent all times, if the slots do not.
    everywhere: Vec<f64>,
}

impl<'a> Hypergrid<'a> {
    fn new(training: &'a OddsTraining<'a>, periods: &[HypertimePeriod]) -> Hypergrid<'a> {
        let candidates = &training.candidates;
        let is_by_time = !candidates.all_divide(periods);
        let (mut numbers, mut everywhere) = (Vec::new(), Vec::new());
        if is_by_time {
            training.times.iter().for_each(|&time| project(time, periods, &mut numbers));
            training.everywhere.iter().for_each(|&time| project(time, periods, &mut everywhere));
        } else {
            (0..candidates.slots()).for_each(|slot| project(candidates.middle_nanos(slot), periods, &mut numbers));
        }
        Hypergrid { training, periods: periods.to_vec(), is_by_time, numbers, everywhere }
    }

    fn stride(&self) -> usize {
        2 * self.periods.len()
    }

    fn point(&self, slot: usize) -> &[f64] {
        &self.numbers[slot * self.stride()..][..self.stride()]
    }

    /// Points spread evenly over all times.
    fn everywhere(&self) -> impl Iterator<Item = &[f64]> {
        let numbers = if self.is_by_time { &self.everywhere } else { &self.numbers };
        numbers.chunks_exact(self.stride().max(1))
    }

    fn folds(&self) -> &'a [SlotWeights] {
        if self.is_by_time { &self.training.by_time } else { &self.training.by_cycle }
    }

    fn weights(&self, fold: usize) -> &'a SlotWeights {
        &self.folds()[fold]
    }

    /// The weights of all folds but one.
    fn without(&self, left_out: Option<usize>) -> SlotWeights {
        let slots = if self.is_by_time { self.training.times.len() } else { self.training.candidates.slots() };
        let others = self.folds().iter().enumerate().filter(|(fold, _)| Some(*fold) != left_out);
        SlotWeights::combined(slots, others.map(|(_, counts)| counts))
    }

    /// The slots with weight.
    fn points(&self, weights: &[f64]) -> Points<'a> {
        let (coordinates, circles) = shape(self.training.method, self.periods.len());
        let mut points = Points::new(coordinates, circles, self.training.unit, self.training.stop);
        for (slot, &weight) in weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
            points.numbers.extend_from_slice(self.point(slot));
            points.weights.push(weight);
        }
        points
    }
}

/// The length of the slots of time, and the index of each slot that holds a reading, by its number on the time line.
fn time_slots(readings: &[OddsReading]) -> (i64, BTreeMap<i64, usize>) {
    let mut length = TIME_MIN_NANOS;
    let mut slots: Vec<i64> = readings.iter().map(|reading| reading.civil_nanos.div_euclid(length)).collect();
    slots.sort_unstable();
    slots.dedup();
    while slots.len() > TIMES_MAX {
        length *= 2;
        slots.iter_mut().for_each(|slot| *slot = slot.div_euclid(2));
        slots.dedup();
    }
    (length, slots.into_iter().zip(0..).collect())
}

/// One of the times that are spread evenly between two times.
fn evenly(index: u64, first: i64, last: i64) -> i64 {
    let share = (index as f64 * 0.618_033_988_749_894_9).fract();
    let span = i128::from(last) - i128::from(first);
    (i128::from(first) + (span as f64 * share) as i128).clamp(first.into(), last.into()) as i64
}
