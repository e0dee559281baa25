//! Readings folded into one period: the mean value in each of 1,440 phases (Waldo eq. 6).
//!
//! Invariant: each of the means lies in `[0,1]`, for all observations.

use crate::civil::NANOS_PER_SEC;
use crate::models::Readings;

/// Number of phases of a period: minutes, for a day.
pub(super) const PHASES: usize = 1_440;

/// The phase of a local civil time, in turns from 0 to 1; reduced in integers, rounded once.
pub(super) fn turn(civil_nanos: i64, period_nanos: i64) -> f64 {
    let period_nanos = period_nanos.max(NANOS_PER_SEC);
    civil_nanos.rem_euclid(period_nanos) as f64 / period_nanos as f64
}

/// The mean value in each phase: p' of Waldo eq. 6.
pub(super) struct PhaseMeans {
    means: Vec<f64>,
}

impl PhaseMeans {
    /// Folds the readings, of which there must be at least one.
    pub(super) fn new(readings: Readings<'_>, period_nanos: i64) -> PhaseMeans {
        let mut sums = vec![(0.0_f64, 0.0_f64); PHASES];
        for (sample, weight) in readings.samples.iter().zip(readings.weights()) {
            let phase = (turn(sample.civil_nanos(), period_nanos) * PHASES as f64) as usize;
            let (value_sum, weight_sum) = &mut sums[phase.min(PHASES - 1)];
            let probability = if sample.value.is_nan() { 0.0 } else { sample.value.clamp(0.0, 1.0) };
            *value_sum += weight * probability;
            *weight_sum += weight;
        }
        PhaseMeans { means: interpolated(&sums) }
    }

    /// The mean over the period, in `[0,1]`.
    pub(super) fn level(&self) -> f64 {
        self.means.iter().sum::<f64>() / PHASES as f64
    }

    /// The mean value of each phase, which the mixture uses as shares of its mass.
    pub(super) fn shares(&self) -> &[f64] {
        &self.means
    }
}

/// Means where there is weight; elsewhere the interpolation between the nearest means, around the circle.
fn interpolated(sums: &[(f64, f64)]) -> Vec<f64> {
    let mean = |phase: usize| sums[phase].0 / sums[phase].1;
    let known: Vec<usize> = (0..sums.len()).filter(|&phase| sums[phase].1 > 0.0).collect();
    let mut means = vec![0.0; sums.len()];
    for (index, &from) in known.iter().enumerate() {
        let until = known[(index + 1) % known.len()];
        let steps = match (until + sums.len() - from) % sums.len() {
            0 => sums.len(),
            steps => steps,
        };
        let (start, end) = (mean(from), mean(until));
        for step in 0..steps {
            means[(from + step) % sums.len()] = start + (end - start) * step as f64 / steps as f64;
        }
    }
    for mean in &mut means {
        *mean = mean.clamp(0.0, 1.0);
    }
    means
}
