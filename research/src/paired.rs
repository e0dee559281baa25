//! Paired tests of whether one model predicts better than another.
//!
//! Errors of readings minutes apart are correlated, so readings are not independent samples; days nearly are. Both
//! models are scored on the same days, and days are drawn with replacement within each test set: a block bootstrap of
//! the paired differences. It is studentised, because a few days with a skewed distribution would otherwise seem to
//! prove too much (B. Efron and R. Tibshirani, "An Introduction to the Bootstrap", 1993, section 12.5; symmetric as in
//! P. Hall, "On symmetric bootstrap confidence intervals", 1988). A Wilcoxon test would test the median day, but the
//! reported figure is the mean.
//!
//! Among all pairs of many models some differ by chance; their p-values are also given corrected for the number of
//! pairs (S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 1979).
//!
//! Invariant: the same days give the same difference, independent of other models: the seed is fixed.

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use rayon::prelude::*;

use super::score::DayErrors;

#[cfg(test)]
mod tests;

/// Number of draws: determines the p-value to about 0.002 around 0.05.
const DRAWS: usize = 9_999;
const SEED: u64 = 1;
/// Minimum of the number of days minus the number of test sets: with fewer days intervals would be far too short.
const FREEDOM_MIN: usize = 5;

/// The difference between the errors of two models.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// The difference of the mean squared errors, each the mean over test sets; below 0 if the model is better.
    pub mean: f64,
    /// The test; none with too few days.
    pub test: Option<PairedTest>,
}

/// The interval and p-value of a difference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairedTest {
    /// The interval of the difference; none if it is unbounded because too few days differ.
    pub interval: Option<(f64, f64)>,
    /// The two-sided p-value; not corrected for the number of models compared.
    pub p_value: f64,
}

/// Two models, and the difference of their errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairedModels {
    /// Index of the model.
    pub model: usize,
    /// Index of the model it is compared with.
    pub other: usize,
    /// The difference, below 0 if the model is better.
    pub difference: Difference,
    /// The two-sided p-value, corrected for the number of pairs: the chance that any pair of equal models seems to
    /// differ this much is at most this. None with too few days.
    pub corrected_p_value: Option<f64>,
}

/// Compares every pair of models; all have the same days.
pub(crate) fn all_pairs(models: &[&[DayErrors]], significance: f64) -> Vec<PairedModels> {
    let indices = (0..models.len()).flat_map(|model| (model + 1..models.len()).map(move |other| (model, other)));
    let pair = |(model, other): (usize, usize)| PairedModels {
        model,
        other,
        difference: difference(models[model], models[other], significance),
        corrected_p_value: None,
    };
    let mut pairs: Vec<PairedModels> = indices.collect::<Vec<_>>().into_par_iter().map(pair).collect();
    let p_values: Option<Vec<f64>> = pairs.iter().map(|pair| Some(pair.difference.test?.p_value)).collect();
    for (pair, corrected) in pairs.iter_mut().zip(p_values.map(|p_values| holm(&p_values)).unwrap_or_default()) {
        pair.corrected_p_value = Some(corrected);
    }
    pairs
}

/// p-values corrected for their number.
fn holm(p_values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p_values.len()).collect();
    order.sort_by(|&a, &b| p_values[a].total_cmp(&p_values[b]));
    let mut corrected = vec![1.0; p_values.len()];
    let mut least: f64 = 0.0;
    for (rank, &index) in order.iter().enumerate() {
        let remaining = (p_values.len() - rank) as f64;
        least = least.max((remaining * p_values[index]).min(1.0));
        corrected[index] = least;
    }
    corrected
}

/// The paired difference of one day.
#[derive(Clone, Copy, Debug)]
struct PairedDay {
    squared: f64,
    readings: f64,
}

/// Compares a model with the baseline, day by day; both have the same days. The interval has the confidence
/// 1 - `significance`.
pub(crate) fn difference(model: &[DayErrors], baseline: &[DayErrors], significance: f64) -> Difference {
    paired(&sets(model, baseline), significance, DRAWS)
}

/// The two-sided p-value of independent differences; none with too few.
pub(crate) fn p_value(differences: &[f64]) -> Option<f64> {
    let set: Vec<PairedDay> = differences.iter().map(|&squared| PairedDay { squared, readings: 1.0 }).collect();
    paired(&[set], 0.05, DRAWS).test.map(|test| test.p_value)
}

/// The differences of each day, by test set.
fn sets(model: &[DayErrors], baseline: &[DayErrors]) -> Vec<Vec<PairedDay>> {
    let pairs: Vec<(&DayErrors, &DayErrors)> = model.iter().zip(baseline).collect();
    let day = |(model, baseline): &(&DayErrors, &DayErrors)| PairedDay {
        squared: model.errors.squared_error - baseline.errors.squared_error,
        readings: model.errors.observations as f64,
    };
    pairs.chunk_by(|a, b| a.0.set == b.0.set).map(|set| set.iter().map(day).collect()).collect()
}

/// The mean difference over a set of days, with its standard error.
#[derive(Clone, Copy, Debug)]
struct MeanDifference {
    /// The mean over test sets of the mean over readings.
    mean: f64,
    /// The standard error of the mean, up to a factor that is equal for all draws.
    error: f64,
}

impl MeanDifference {
    fn of<'a>(sets: impl ExactSizeIterator<Item = &'a [PairedDay]>) -> Self {
        let count = sets.len().max(1) as f64;
        let (mut sum, mut variance) = (0.0, 0.0);
        for days in sets {
            let readings = days.iter().map(|day| day.readings).sum::<f64>().max(1.0);
            let mean = days.iter().map(|day| day.squared).sum::<f64>() / readings;
            // The contribution of a day to the mean of its set beyond its share of the readings.
            let beyond = |day: &PairedDay| (day.squared - mean * day.readings) / readings;
            sum += mean;
            variance += days.iter().map(|day| beyond(day).powi(2)).sum::<f64>();
        }
        Self { mean: sum / count, error: variance.sqrt() / count }
    }

    /// The distance of the mean to a value in standard errors; infinite if all days are equal and differ from the
    /// value.
    fn distance(self, value: f64) -> f64 {
        let away = (self.mean - value).abs();
        if away > 0.0 { away / self.error } else { 0.0 }
    }
}

fn paired(sets: &[Vec<PairedDay>], significance: f64, draws: usize) -> Difference {
    let observed = MeanDifference::of(sets.iter().map(Vec::as_slice));
    let days: usize = sets.iter().map(Vec::len).sum();
    if days.saturating_sub(sets.len()) < FREEDOM_MIN {
        return Difference { mean: observed.mean, test: None };
    }
    let mut random = SmallRng::seed_from_u64(SEED);
    let mut drawn = sets.to_vec();
    let mut distances: Vec<f64> = Vec::with_capacity(draws);
    for _ in 0..draws {
        for (drawn, days) in drawn.iter_mut().zip(sets) {
            drawn.fill_with(|| days[random.random_range(0..days.len())]);
        }
        distances.push(MeanDifference::of(drawn.iter().map(Vec::as_slice)).distance(observed.mean));
    }
    distances.sort_by(f64::total_cmp);
    let own = observed.distance(0.0);
    let as_far = distances.len() - distances.partition_point(|&distance| distance < own);
    // The observed difference counts as a draw.
    let p_value = (as_far as f64 + 1.0) / (draws as f64 + 1.0);
    let rank = ((1.0 - significance) * (draws as f64 + 1.0)).ceil() as usize;
    let reach = distances.get(rank.clamp(1, draws) - 1).copied().unwrap_or(f64::INFINITY);
    // If all days are equal, the mean is certain.
    let half_width = if observed.error > 0.0 { reach * observed.error } else { 0.0 };
    let interval = half_width.is_finite().then_some((observed.mean - half_width, observed.mean + half_width));
    Difference { mean: observed.mean, test: Some(PairedTest { interval, p_value }) }
}
