//! The intervals of local civil time in which detections are counted.
//!
//! Invariant: the intervals follow each other without gaps; all of them count as watched.

use super::{FlowOptions, INTERVALS_MAX};
use crate::{Component, LocalDay, Periodicities, PhasorTable};

/// Number of intervals that share one table of phasors.
const CHUNK: usize = 512;

/// Intervals of equal length from the first to the last detection.
pub(super) struct FlowIntervals {
    length_nanos: i64,
    /// Number of the first interval, from 1970.
    first: i64,
    /// The weight of each interval.
    weights: Vec<f64>,
}

/// A part of the intervals: its weight, and the mean of its phasors.
pub(super) struct IntervalSum {
    pub(super) weight: f64,
    /// The factor of the weights that makes the weight of the last interval 1.
    pub(super) scale: f64,
    /// Number of local days, complete or not.
    pub(super) days: usize,
    /// Σ w e^(-jωt) / Σ w for every periodicity that its span holds.
    pub(super) phasors: Vec<Component>,
}

impl FlowIntervals {
    pub(super) fn between(first_nanos: i64, last_nanos: i64, options: &FlowOptions) -> FlowIntervals {
        let span = last_nanos.saturating_sub(first_nanos).max(0);
        let longer = span / options.interval_nanos / INTERVALS_MAX + 1;
        let length_nanos = options.interval_nanos.saturating_mul(longer);
        let (first, last) = (first_nanos.div_euclid(length_nanos), last_nanos.div_euclid(length_nanos));
        let secs = length_nanos as f64 / 1e9;
        let weight = |index: i64| {
            options.half_life_secs.map_or(1.0, |half_life| libm::exp2(-((last - index) as f64) * secs / half_life))
        };
        FlowIntervals { length_nanos, first, weights: (first..=last.max(first)).map(weight).collect() }
    }

    pub(super) fn length_nanos(&self) -> i64 {
        self.length_nanos
    }

    pub(super) fn len(&self) -> usize {
        self.weights.len()
    }

    /// The interval of a local civil time; times beyond both ends belong to the nearest.
    pub(super) fn index(&self, civil_nanos: i64) -> usize {
        let steps = civil_nanos.div_euclid(self.length_nanos).saturating_sub(self.first).max(0);
        (steps as usize).min(self.weights.len() - 1)
    }

    pub(super) fn weight(&self, index: usize) -> f64 {
        self.weights[index]
    }

    /// The middle of an interval in local civil time.
    pub(super) fn centre_nanos(&self, index: usize) -> i64 {
        self.first.saturating_add(index as i64).saturating_mul(self.length_nanos).saturating_add(self.length_nanos / 2)
    }

    /// The index of the first interval of each day.
    pub(super) fn days(&self) -> Vec<usize> {
        let day = |index: usize| LocalDay::of_civil_nanos(self.centre_nanos(index));
        (0..self.len()).filter(|&index| index == 0 || day(index) != day(index - 1)).collect()
    }

    pub(super) fn all(&self, periodicities: &Periodicities) -> IntervalSum {
        self.sum(self.len(), periodicities)
    }

    /// The sum of the intervals before `end`.
    pub(super) fn sum(&self, end: usize, periodicities: &Periodicities) -> IntervalSum {
        // Weights are relative to the newest interval of the part: days that are old for the last days are new for
        // earlier ones.
        let newest = self.weights[..end].last().copied().unwrap_or(1.0);
        let scale = if newest > 0.0 { 1.0 / newest } else { 1.0 };
        let weight: f64 = self.weights[..end].iter().map(|weight| weight * scale).sum();
        let mut phasors: Vec<Component> = eligible(self, end, periodicities);
        let times: Vec<i64> = (0..end).map(|index| self.centre_nanos(index)).collect();
        for (chunk, weights) in times.chunks(CHUNK).zip(self.weights.chunks(CHUNK)) {
            let table = PhasorTable::new(periodicities, chunk);
            for sum in &mut phasors {
                let Some((cos, sin)) = table.row(sum.periodicity) else { continue };
                sum.gamma_re += cos.iter().zip(weights).map(|(cos, share)| cos * share * scale / weight).sum::<f64>();
                sum.gamma_im -= sin.iter().zip(weights).map(|(sin, share)| sin * share * scale / weight).sum::<f64>();
            }
        }
        let days = self.days().partition_point(|&first| first < end);
        IntervalSum { weight, scale, days, phasors }
    }
}

/// The periodicities that the intervals before `end` hold at least once, with sums of 0.
fn eligible(intervals: &FlowIntervals, end: usize, periodicities: &Periodicities) -> Vec<Component> {
    let span_nanos = (end as u64).saturating_sub(1).saturating_mul(intervals.length_nanos.unsigned_abs());
    let held = |&k: &u32| periodicities.is_eligible(k as usize, span_nanos);
    let start = |periodicity: u32| Component { periodicity, gamma_re: 0.0, gamma_im: 0.0 };
    (0..periodicities.len() as u32).filter(held).map(start).collect()
}
