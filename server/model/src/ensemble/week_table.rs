//! Sums over half-hour bins by hour of the local week, and the table that follows from them.
//!
//! The table has four levels, each shrunk towards the one before: the mean, the hour of the day, the hour of the kind
//! of day (Monday to Friday, or weekend), the hour of the weekday. A cell's prior is a mixture: its mean is that of the
//! coarser level or that of the neighbouring hours, its strength 1, 5, 25 or 125 bins. The cell weighs these eight
//! priors by how well each explains its own bins (the beta-binomial likelihood) and by how often each has explained the
//! cells of its level before (empirical Bayes). So a state without a daily rhythm keeps its mean, and one that changes
//! sharply at an hour keeps the edge. Invariant: every value lies strictly between 0 and 1.

use super::bins::DayBins;
use crate::hours_seen::{HOURS, Hours, SATURDAY, kind_of_day};
use crate::special::ln_rising;

/// The strengths of the priors, in bins.
const STRENGTHS: [f64; 4] = [1.0, 5.0, 25.0, 125.0];
/// Number of priors of a cell: each strength towards the coarser level, then each towards the neighbouring hours.
pub(super) const PRIORS: usize = 2 * STRENGTHS.len();
/// The weights of the priors before the first bin.
const PRIOR_WEIGHTS: [f64; PRIORS] = [0.05, 0.1, 0.15, 0.2, 0.05, 0.1, 0.15, 0.2];
/// Each day the weights of the priors keep this share, gain [`LEARNED`] times the responsibilities of the priors for
/// the cells, and [`RETURNED`] times the weights before the first bin.
const KEPT: f64 = 0.8;
const LEARNED: f64 = 0.2;
const RETURNED: f64 = 0.4;
/// The weights of the priors tend to this multiple of those before the first bin.
const RESTING: f64 = RETURNED / (1.0 - KEPT);
/// The factor on [`PRIOR_WEIGHTS`] before the first day.
const AT_FIRST: f64 = 16.0;
/// Number of neighbouring hours on each side; each further one counts half.
const NEIGHBOURS: usize = 4;
/// The coarser level counts as this many bins among the neighbours.
const NEIGHBOUR_PRIOR: f64 = 4.0;
/// A prior mean is at least this far from 0 and 1.
const EDGE: f64 = 1e-3;

/// Number of levels of the table above the mean: hour, hour of the kind of day, hour of the weekday.
pub(super) const LEVELS: usize = 3;

/// Sums over bins by hour of the local week, which fade by age if the table has a half-life.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct WeekTable {
    /// Days after which a bin counts half; `None`: never.
    half_life_days: Option<f64>,
    /// The sum of the values of the bins, by weekday from Monday and hour.
    pub(super) sums: [[f32; HOURS]; 7],
    /// The number of bins, by weekday from Monday and hour.
    pub(super) bins: [[f32; HOURS]; 7],
    /// The weights of the priors of each level.
    pub(super) weights: [[f32; PRIORS]; LEVELS],
}

/// The levels of a table for one weekday.
#[derive(Clone, Copy, Debug)]
pub(super) struct DayLevels {
    /// The value by hour of the day.
    pub(super) hour: Hours,
    /// The value by hour of the kind of day.
    pub(super) kind: Hours,
    /// The value by hour of the weekday.
    pub(super) weekday: Hours,
    /// The responsibility of each prior for the bins of each level, summed over the hours.
    responsibilities: [[f64; PRIORS]; LEVELS],
}

impl WeekTable {
    pub(super) fn new(half_life_days: Option<f64>) -> WeekTable {
        let weights = [PRIOR_WEIGHTS.map(|weight| (AT_FIRST * weight) as f32); LEVELS];
        WeekTable { half_life_days, sums: [[0.0; HOURS]; 7], bins: [[0.0; HOURS]; 7], weights }
    }

    fn of_days(table: &[[f32; HOURS]; 7], weekdays: std::ops::Range<usize>) -> Hours {
        let mut hours = [0.0; HOURS];
        for day in &table[weekdays] {
            hours.iter_mut().zip(day).for_each(|(hour, &of_day)| *hour += f64::from(of_day));
        }
        hours
    }

    /// Sum and number of the bins of some weekdays by hour.
    fn sums_of(&self, weekdays: std::ops::Range<usize>) -> (Hours, Hours) {
        (Self::of_days(&self.sums, weekdays.clone()), Self::of_days(&self.bins, weekdays))
    }

    /// Number of bins by hour of the kind of day: of weekdays, then of the weekend.
    pub(super) fn bins_by_kind(&self) -> [Hours; 2] {
        [Self::of_days(&self.bins, 0..SATURDAY), Self::of_days(&self.bins, SATURDAY..7)]
    }

    /// Sum of the bins by hour of the kind of day: of weekdays, then of the weekend.
    pub(super) fn sums_by_kind(&self) -> [Hours; 2] {
        [Self::of_days(&self.sums, 0..SATURDAY), Self::of_days(&self.sums, SATURDAY..7)]
    }

    /// The levels for a weekday. `mean`: the mean of all bins.
    pub(super) fn levels(&self, weekday: usize, mean: f64) -> DayLevels {
        let of_kind = if weekday >= SATURDAY { SATURDAY..7 } else { 0..SATURDAY };
        let [mut first, mut second, mut third] = [[0.0; PRIORS]; LEVELS];
        let hour = level(self.sums_of(0..7), &[mean; HOURS], &self.weights[0], &mut first);
        let kind = level(self.sums_of(of_kind), &hour, &self.weights[1], &mut second);
        let weekday = level(self.sums_of(weekday..weekday + 1), &kind, &self.weights[2], &mut third);
        DayLevels { hour, kind, weekday, responsibilities: [first, second, third] }
    }

    /// The values by hour of the kind of day, and by hour of the weekday, for the whole week.
    pub(super) fn week(&self, mean: f64) -> ([Hours; 2], [Hours; 7]) {
        let mut unused = [0.0; PRIORS];
        let hour = level(self.sums_of(0..7), &[mean; HOURS], &self.weights[0], &mut unused);
        let kinds = [0..SATURDAY, SATURDAY..7]
            .map(|weekdays| level(self.sums_of(weekdays), &hour, &self.weights[1], &mut unused));
        let weekday = |day| level(self.sums_of(day..day + 1), &kinds[kind_of_day(day)], &self.weights[2], &mut unused);
        (kinds, [0, 1, 2, 3, 4, 5, 6].map(weekday))
    }

    /// Ages the table by days without bins.
    pub(super) fn pass(&mut self, days: f64) {
        let kept = libm::pow(KEPT, days);
        for (weight, resting) in self.weights.iter_mut().flat_map(|level| level.iter_mut().zip(PRIOR_WEIGHTS)) {
            let resting = RESTING * resting;
            *weight = (resting + kept * (f64::from(*weight) - resting)) as f32;
        }
        self.fade(days);
    }

    fn fade(&mut self, days: f64) {
        let Some(half_life_days) = self.half_life_days else { return };
        let factor = libm::exp2(-days / half_life_days) as f32;
        for number in self.sums.as_flattened_mut().iter_mut().chain(self.bins.as_flattened_mut()) {
            *number *= factor;
        }
    }

    /// Learns a day. `levels`: those that were computed before the day.
    pub(super) fn learn(&mut self, weekday: usize, bins: &DayBins, levels: &DayLevels) {
        for (weights, stored) in self.weights.iter_mut().zip(&levels.responsibilities) {
            for ((weight, stored), first) in weights.iter_mut().zip(stored).zip(PRIOR_WEIGHTS) {
                *weight = (KEPT * f64::from(*weight) + LEARNED * stored + RETURNED * first) as f32;
            }
        }
        self.fade(1.0);
        self.add(weekday, bins, 1.0);
    }

    /// Adds bins with a weight.
    pub(super) fn add(&mut self, weekday: usize, bins: &DayBins, weight: f64) {
        for (slot, value) in bins.seen() {
            self.sums[weekday][slot / 2] += (weight * value) as f32;
            self.bins[weekday][slot / 2] += weight as f32;
        }
    }

    /// The weight of a bin of this age in days.
    pub(super) fn weight_at_age(&self, days: f64) -> f64 {
        self.half_life_days.map_or(1.0, |half_life_days| libm::exp2(-days / half_life_days))
    }
}

/// The values of one level. Adds the responsibility of each prior for the bins of the level to `responsibilities`.
fn level(
    (sums, bins): (Hours, Hours),
    coarser: &Hours,
    weights: &[f32; PRIORS],
    responsibilities: &mut [f64; PRIORS],
) -> Hours {
    let total: f64 = weights.iter().map(|&weight| f64::from(weight)).sum();
    let logs = weights.map(|weight| libm::log(f64::from(weight) / total));
    let mut values = [0.0; HOURS];
    for (hour, value) in values.iter_mut().enumerate() {
        let near = neighbours(&sums, &bins, hour, coarser[hour]);
        let (sum, number) = (sums[hour], bins[hour]);
        let zeros = (number - sum).max(0.0);
        let of_number = STRENGTHS.map(|strength| if number > 0.0 { ln_rising(strength, number) } else { 0.0 });
        let mut evidence = logs;
        let mut means = [0.0; PRIORS];
        for (prior, (evidence, mean)) in evidence.iter_mut().zip(&mut means).enumerate() {
            let strength = STRENGTHS[prior % STRENGTHS.len()];
            let towards = if prior < STRENGTHS.len() { coarser[hour] } else { near }.clamp(EDGE, 1.0 - EDGE);
            let (prior_ones, prior_zeros) = (strength * towards, strength * (1.0 - towards));
            if number > 0.0 {
                // The beta-binomial likelihood, without the factor that all priors share.
                let of_prior = ln_rising(prior_ones, sum) + ln_rising(prior_zeros, zeros);
                *evidence += of_prior - of_number[prior % STRENGTHS.len()];
            }
            *mean = (sum + prior_ones) / (number + strength);
        }
        let highest = evidence.iter().copied().fold(f64::MIN, f64::max);
        let shares = evidence.map(|evidence| libm::exp(evidence - highest));
        let all: f64 = shares.iter().sum();
        for ((share, mean), stored) in shares.iter().zip(means).zip(responsibilities.iter_mut()) {
            *value += share / all * mean;
            *stored += share / all * number.min(1.0);
        }
    }
    values
}

/// The mean of the neighbouring hours, shrunk to the coarser level.
fn neighbours(sums: &Hours, bins: &Hours, hour: usize, coarser: f64) -> f64 {
    let (mut sum, mut number, mut share) = (NEIGHBOUR_PRIOR * coarser, NEIGHBOUR_PRIOR, 1.0);
    for distance in 1..=NEIGHBOURS {
        let (after, before) = ((hour + distance) % HOURS, (hour + HOURS - distance) % HOURS);
        sum += share * (sums[after] + sums[before]);
        number += share * (bins[after] + bins[before]);
        share *= 0.5;
    }
    sum / number
}
