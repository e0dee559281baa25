//! Hypertime: a time as one point on each of several circles, and the search for the periods of these circles.
//!
//! Every candidate period is a week divided by 1..=84, so a slot of the week is one point in hypertime, and errors can
//! be summed by slot before the search. Invariant: a period is named by its divisor of the week, never by a length in
//! floating point.

use std::f64::consts::TAU;

use crate::InvalidParts;
use crate::civil::NANOS_PER_SEC;

#[cfg(test)]
mod tests;

/// A week, in nanoseconds.
pub(super) const WEEK_NANOS: i64 = 7 * 86_400 * NANOS_PER_SEC;
/// Slots of a week, of five minutes: a 24th of the shortest period.
pub(super) const SLOTS: usize = 2_016;
/// Periods searched: a week to two hours.
pub(super) const CANDIDATES: u32 = 84;

/// Most circles of a model.
pub(super) const PERIODS_MAX: usize = 5;

/// Checks stored divisors: not too many, each a candidate, no two equal.
pub(super) fn check_divisors(divisors: &[u32]) -> Result<(), InvalidParts> {
    InvalidParts::check("week_divisors", divisors.len() as f64, 0.0..=PERIODS_MAX as f64)?;
    for (index, &divisor) in divisors.iter().enumerate() {
        let repeated = divisors[..index].contains(&divisor);
        let found = if repeated { f64::NAN } else { f64::from(divisor) };
        InvalidParts::check("week_divisors", found, 1.0..=f64::from(CANDIDATES))?;
    }
    Ok(())
}

/// The slot of the week that a local civil time falls into.
pub(super) fn slot(civil_nanos: i64) -> usize {
    (civil_nanos.rem_euclid(WEEK_NANOS) / (WEEK_NANOS / SLOTS as i64)) as usize
}

/// The place in the week of a local civil time, in turns from 0 to 1.
pub(super) fn turn(civil_nanos: i64) -> f64 {
    civil_nanos.rem_euclid(WEEK_NANOS) as f64 / WEEK_NANOS as f64
}

/// The place in the week of a slot's middle, in turns.
pub(super) fn slot_turn(slot: usize) -> f64 {
    (slot as f64 + 0.5) / SLOTS as f64
}

/// Projects a place in the week onto the circles (RA-L 2019 eq. 1): cosine and sine for each divisor, appended.
pub(super) fn project(turn: f64, divisors: &[u32], out: &mut Vec<f64>) {
    for &divisor in divisors {
        let (sin, cos) = (TAU * (turn * f64::from(divisor)).fract()).sin_cos();
        out.extend([cos, sin]);
    }
}

/// Errors of a model, summed by slot of the week, for one or more dimensions of the value.
#[derive(Clone, Debug)]
pub(super) struct Residuals {
    dimensions: usize,
    weights: Vec<f64>,
    /// `dimensions` sums of weight · error for each slot.
    sums: Vec<f64>,
}

impl Residuals {
    pub(super) fn new(dimensions: usize) -> Residuals {
        Residuals { dimensions, weights: vec![0.0; SLOTS], sums: vec![0.0; SLOTS * dimensions] }
    }

    /// The sum of several, of the same number of dimensions.
    pub(super) fn combined<'a>(parts: impl Iterator<Item = &'a Residuals>) -> Residuals {
        parts.fold(Residuals::new(1), |sum, part| {
            let mut sum = if sum.dimensions == part.dimensions { sum } else { Residuals::new(part.dimensions) };
            sum.weights.iter_mut().zip(&part.weights).for_each(|(sum, weight)| *sum += weight);
            sum.sums.iter_mut().zip(&part.sums).for_each(|(sum, part)| *sum += part);
            sum
        })
    }

    /// Adds an error of one dimension; the weight of the slot is counted with dimension 0.
    pub(super) fn add(&mut self, slot: usize, dimension: usize, weight: f64, error: f64) {
        if dimension == 0 {
            self.weights[slot] += weight;
        }
        self.sums[slot * self.dimensions + dimension] += weight * error;
    }

    /// Strength of each candidate period in the error, from a week on: |Σ (ε - ε̄) e^(-j2πt/T)| of RA-L 2019 eq. 7
    /// (printed with the modulus inside the sum, which would leave the period out), over all dimensions.
    pub(super) fn spectrum(&self) -> Vec<f64> {
        // From the slots' beginnings: half a slot of shift does not change the modulus.
        let phasors: Vec<(f64, f64)> = (0..SLOTS).map(|slot| (TAU * slot as f64 / SLOTS as f64).sin_cos()).collect();
        let total: f64 = self.weights.iter().sum();
        let mut power = vec![0.0; CANDIDATES as usize];
        for dimension in 0..self.dimensions {
            let mean = self.sums.iter().skip(dimension).step_by(self.dimensions).sum::<f64>() / total;
            for (index, power) in power.iter_mut().enumerate() {
                let (mut re, mut im) = (0.0, 0.0);
                for (slot, weight) in self.weights.iter().enumerate() {
                    let centred = self.sums[slot * self.dimensions + dimension] - mean * weight;
                    let (sin, cos) = phasors[slot * (index + 1) % SLOTS];
                    re += centred * cos;
                    im -= centred * sin;
                }
                *power += re * re + im * im;
            }
        }
        power.into_iter().map(f64::sqrt).collect()
    }

    /// The divisor of the strongest unused candidate of which the observed span holds at least 0.99.
    pub(super) fn strongest(&self, taken: &[u32], span_nanos: u64) -> Option<u32> {
        let mut best: Option<(f64, u32)> = None;
        for (strength, divisor) in self.spectrum().into_iter().zip(1..) {
            let held = u128::from(span_nanos) * u128::from(divisor) * 100 >= WEEK_NANOS as u128 * 99;
            let stronger = best.is_none_or(|(before, _)| strength > before);
            if held && !taken.contains(&divisor) && stronger && strength > 0.0 {
                best = Some((strength, divisor));
            }
        }
        best.map(|(_, divisor)| divisor)
    }

    /// Sum of the spectrum: T_Σ of RA-L 2019 eq. 8, with the modulus outside the inner sum as in eq. 7.
    pub(super) fn total_strength(&self) -> f64 {
        self.spectrum().into_iter().sum()
    }
}
