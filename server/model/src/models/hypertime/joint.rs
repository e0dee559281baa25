//! Trains one mixture over location, circles and value, and scores it on held-out readings.
//!
//! Invariant: errors are taken along standardised coordinates, so that all coordinates of the value have equal weight.

use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};

use super::HypertimeMethod;
use super::axis::{HypertimeAxis, standardised};
use super::candidates::{Candidates, HypertimePeriod, project};
use super::conditional::HypertimeDistribution;
use super::grow::{Attempt, Circles, HeldOutScore, Trainer};
use super::mixture::Mixture;
use super::residuals::Residuals;
use super::seeding::Points;
use crate::StopSignal;

/// Maximum number of readings of a training.
const READINGS_MAX: usize = 4_000;
const FIRST_STEPS: usize = 40;
const FOLD_STEPS: usize = 10;
/// Bound on the contribution of one reading to a log-likelihood, so that one outlier does not decide between starts.
const LOG_MAX: f64 = 20.0;

/// A reading with standardised numbers.
pub(super) struct FieldPoint {
    pub(super) civil_nanos: i64,
    pub(super) fold: usize,
    /// The weight, above 0.
    pub(super) weight: f64,
    pub(super) location: Vec<f64>,
    pub(super) value: Vec<f64>,
}

impl FieldPoint {
    /// The indices of the kept readings of `count`: all, or one drawn from each of equal runs.
    pub(super) fn thinned(count: usize, seed: u64) -> Vec<usize> {
        if count <= READINGS_MAX {
            return (0..count).collect();
        }
        let mut rng = SmallRng::seed_from_u64(seed);
        let start = |run: usize| (run as u128 * count as u128 / READINGS_MAX as u128) as usize;
        // The draw is random, because a fixed stride could always hit the same minute of the hour.
        (0..READINGS_MAX).map(|run| rng.random_range(start(run)..start(run + 1))).collect()
    }
}

pub(super) struct FieldTraining<'a> {
    pub(super) readings: Vec<FieldPoint>,
    pub(super) candidates: Candidates,
    pub(super) method: HypertimeMethod,
    pub(super) value: Vec<HypertimeAxis>,
    /// The weight of independent readings.
    pub(super) unit: f64,
    pub(super) stop: StopSignal<'a>,
}

impl<'a> FieldTraining<'a> {
    /// The readings in hypertime: location, circles as coordinates if they are coordinates, value; then circles that
    /// are not coordinates.
    fn points(&self, periods: &[HypertimePeriod]) -> Points<'a> {
        let first = self.readings.first();
        let linear = first.map_or(0, |reading| reading.location.len() + reading.value.len());
        let (hypertime, circles) = match self.method {
            HypertimeMethod::Em => (2 * periods.len(), 0),
            HypertimeMethod::Km => (0, periods.len()),
        };
        let mut points = Points::new(linear + hypertime, circles, self.unit, self.stop);
        for reading in &self.readings {
            points.numbers.extend_from_slice(&reading.location);
            if self.method == HypertimeMethod::Em {
                project(reading.civil_nanos, periods, &mut points.numbers);
            }
            points.numbers.extend_from_slice(&reading.value);
            if self.method == HypertimeMethod::Km {
                project(reading.civil_nanos, periods, &mut points.numbers);
            }
            points.weights.push(reading.weight);
        }
        points
    }

    /// The points of all folds but one.
    fn others(&self, points: &Points, fold: usize) -> Points<'a> {
        let mut others = Points::new(points.coordinates, points.circles, points.unit, self.stop);
        for (reading, (numbers, weight)) in self.readings.iter().zip(points.iter()) {
            if reading.fold != fold {
                others.numbers.extend_from_slice(numbers);
                others.weights.push(weight);
            }
        }
        others
    }

    /// Scores a model without a fold on that fold.
    fn score(&self, trained: &Mixture, points: &Points, fold: usize, score: &mut HeldOutScore) {
        let given = points.coordinates - self.value.len();
        let mut residuals = Residuals::new(&self.candidates, self.value.len());
        for (reading, (numbers, weight)) in self.readings.iter().zip(points.iter()) {
            if reading.fold != fold {
                continue;
            }
            let (coordinates, circles) = numbers.split_at(points.coordinates);
            let (log_given, log_all) = trained.log_densities(numbers, points.coordinates, given);
            score.logs += weight * (log_all - log_given).clamp(-LOG_MAX, LOG_MAX);
            score.total += weight;
            let shares = trained.given(&coordinates[..given], circles);
            let mean = HypertimeDistribution::new(shares, self.value.clone()).mean();
            let standard = standardised(&mean, &self.value);
            for (dimension, (mean, value)) in standard.iter().zip(&reading.value).enumerate() {
                score.squared += weight * (mean - value) * (mean - value);
                let slot = self.candidates.slot(reading.civil_nanos);
                residuals.add(slot, dimension, weight, mean - value);
                residuals.add_at(reading.civil_nanos, &self.candidates, (dimension, weight, mean - value));
            }
        }
        score.residuals.push(residuals);
    }
}

/// A mixture and the periods of its circles.
type CircledMixture = (Vec<HypertimePeriod>, Mixture);

impl Trainer<CircledMixture> for FieldTraining<'_> {
    fn candidates(&self) -> &Candidates {
        &self.candidates
    }

    fn attempt(&self, circles: &Circles, clusters: usize, seed: u64) -> Attempt<CircledMixture> {
        let points = self.points(&circles.all);
        let mixture = Mixture::train(&points, clusters, seed, FIRST_STEPS);
        let mut score = HeldOutScore::default();
        for (fold, periods) in circles.without.iter().enumerate() {
            // The training starts from the model of all readings, so that its optimum is judged; with other circles,
            // from scratch.
            if *periods == circles.all {
                let mut trained = mixture.clone();
                trained.train_further(&self.others(&points, fold), FOLD_STEPS);
                self.score(&trained, &points, fold, &mut score);
            } else {
                let other = self.points(periods);
                let trained = Mixture::train(&self.others(&other, fold), clusters, seed, FIRST_STEPS);
                self.score(&trained, &other, fold, &mut score);
            }
        }
        score.attempt((circles.all.clone(), mixture))
    }
}
