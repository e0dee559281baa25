//! Whether one model predicts better than another, or was lucky on these days.
//!
//! Readings minutes apart err together, so readings are no sample; days nearly are. Both models are scored on the same
//! days, and days are drawn with replacement within each test set: a block bootstrap of the paired differences,
//! studentised, because few days with a skewed distribution would otherwise seem to say more than they do (B. Efron and
//! R. Tibshirani, "An Introduction to the Bootstrap", 1993, section 12.5; symmetric as in P. Hall, "On symmetric
//! bootstrap confidence intervals", 1988). A Wilcoxon test would ask about the median day, while what is reported is
//! the mean.
//!
//! Invariant: the same days give the same answer, whatever else is compared: the seed is fixed.

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};

use super::score::DayErrors;

#[cfg(test)]
mod tests;

/// Draws. The p-value is then known to about 0.002 around 0.05.
const DRAWS: usize = 9_999;
const SEED: u64 = 1;
/// Days less test sets below which nothing is said: with so few days an interval would be far too short.
const FREEDOM_MIN: usize = 5;

/// How much more one model errs than another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// The difference of the mean squared errors, each the mean over test sets; below 0 where the model is better.
    pub mean: f64,
    /// What the days leave open; none where they are too few.
    pub test: Option<PairedTest>,
}

/// What the days leave open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairedTest {
    /// The interval of the difference; none where it has no bounds, because too few days differ at all.
    pub interval: Option<(f64, f64)>,
    /// How often a difference as large would be found, either way, if there were none; not corrected for the number of
    /// models that are compared.
    pub p_value: f64,
}

/// The paired difference of one day.
#[derive(Clone, Copy, Debug)]
struct PairedDay {
    squared: f64,
    readings: f64,
}

/// Compares a model with the baseline, day by day; both have the same days. The interval holds one less `significance`.
pub fn difference(model: &[DayErrors], baseline: &[DayErrors], significance: f64) -> Difference {
    paired(&sets(model, baseline), significance, DRAWS)
}

/// How often a mean difference as large would be found, either way, if there were none, of differences that are each a
/// sample of their own. `None` where there are too few.
pub fn p_value(differences: &[f64]) -> Option<f64> {
    let set: Vec<PairedDay> = differences.iter().map(|&squared| PairedDay { squared, readings: 1.0 }).collect();
    paired(&[set], 0.05, DRAWS).test.map(|test| test.p_value)
}

/// Differences by test set.
fn sets(model: &[DayErrors], baseline: &[DayErrors]) -> Vec<Vec<PairedDay>> {
    let pairs: Vec<(&DayErrors, &DayErrors)> = model.iter().zip(baseline).collect();
    let day = |(model, baseline): &(&DayErrors, &DayErrors)| PairedDay {
        squared: model.errors.squared_error - baseline.errors.squared_error,
        readings: model.errors.observations as f64,
    };
    pairs.chunk_by(|a, b| a.0.set == b.0.set).map(|set| set.iter().map(day).collect()).collect()
}

/// The difference over some days, and how far off it may be.
#[derive(Clone, Copy, Debug)]
struct MeanDifference {
    /// The mean over test sets of the mean over readings.
    mean: f64,
    /// Its standard error, up to a factor that is the same for all draws.
    error: f64,
}

impl MeanDifference {
    fn of<'a>(sets: impl ExactSizeIterator<Item = &'a [PairedDay]>) -> Self {
        let count = sets.len().max(1) as f64;
        let (mut sum, mut variance) = (0.0, 0.0);
        for days in sets {
            let readings = days.iter().map(|day| day.readings).sum::<f64>().max(1.0);
            let mean = days.iter().map(|day| day.squared).sum::<f64>() / readings;
            // What a day adds to the mean of its set beyond its share of the readings.
            let beyond = |day: &PairedDay| (day.squared - mean * day.readings) / readings;
            sum += mean;
            variance += days.iter().map(|day| beyond(day).powi(2)).sum::<f64>();
        }
        Self { mean: sum / count, error: variance.sqrt() / count }
    }

    /// How many standard errors it is from a value: infinitely many where all days are alike and it is not the value.
    fn distance(self, value: f64) -> f64 {
        let away = (self.mean - value).abs();
        if away > 0.0 { away / self.error } else { 0.0 }
    }
}

fn paired(sets: &[Vec<PairedDay>], significance: f64, draws: usize) -> Difference {
    let found = MeanDifference::of(sets.iter().map(Vec::as_slice));
    let days: usize = sets.iter().map(Vec::len).sum();
    if days.saturating_sub(sets.len()) < FREEDOM_MIN {
        return Difference { mean: found.mean, test: None };
    }
    let mut random = SmallRng::seed_from_u64(SEED);
    let mut drawn = sets.to_vec();
    let mut distances: Vec<f64> = Vec::with_capacity(draws);
    for _ in 0..draws {
        for (drawn, days) in drawn.iter_mut().zip(sets) {
            drawn.fill_with(|| days[random.random_range(0..days.len())]);
        }
        distances.push(MeanDifference::of(drawn.iter().map(Vec::as_slice)).distance(found.mean));
    }
    distances.sort_by(f64::total_cmp);
    let own = found.distance(0.0);
    let as_far = distances.len() - distances.partition_point(|&distance| distance < own);
    // The draw that was found counts as one.
    let p_value = (as_far as f64 + 1.0) / (draws as f64 + 1.0);
    let rank = ((1.0 - significance) * (draws as f64 + 1.0)).ceil() as usize;
    let reach = distances.get(rank.clamp(1, draws) - 1).copied().unwrap_or(f64::INFINITY);
    // All days alike: whatever the reach, the mean is certain.
    let half_width = if found.error > 0.0 { reach * found.error } else { 0.0 };
    let interval = half_width.is_finite().then_some((found.mean - half_width, found.mean + half_width));
    Difference { mean: found.mean, test: Some(PairedTest { interval, p_value }) }
}
