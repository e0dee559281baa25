//! Errors of a hypertime model, and the strength of each candidate period in them.
//!
//! Invariant: the strength of a candidate is |Σ (ε - ε̄) e^(-j2πt/T)| over the errors. For candidates that divide the
//! cycle it is computed from sums by slot, for the others from phasors that are summed when the errors are added.

use std::f64::consts::TAU;

use super::candidates::{Candidates, HypertimePeriod, project};
use crate::special::square;

#[cfg(test)]
mod tests;

/// If candidates differ by less than rounding, the longer one is chosen.
const ROUNDING: f64 = 1e-9;

/// Errors of a model for one or more dimensions of the value.
#[derive(Clone, Debug)]
pub(super) struct Residuals {
    dimensions: usize,
    /// The weights by slot of the cycle.
    weights: Vec<f64>,
    /// `dimensions` sums of weight · error for each slot.
    sums: Vec<f64>,
    /// For each candidate that does not divide the cycle, cosine and sine: summed weights, then summed weight · error
    /// of each dimension.
    phasors: Vec<[f64; 2]>,
    /// Length of the slots of the errors; 0 for the slots of the cycle, or for the readings' times.
    coarseness_nanos: i64,
}

impl Residuals {
    pub(super) fn new(candidates: &Candidates, dimensions: usize) -> Residuals {
        let slots = candidates.slots();
        Residuals {
            dimensions,
            weights: vec![0.0; slots],
            sums: vec![0.0; slots * dimensions],
            phasors: vec![[0.0; 2]; candidates.others().len() * (1 + dimensions)],
            coarseness_nanos: 0,
        }
    }

    /// Makes residuals whose errors are computed in slots of this length.
    pub(super) fn in_slots_of(self, coarseness_nanos: i64) -> Residuals {
        Residuals { coarseness_nanos, ..self }
    }

    /// The sum of several residuals with equal candidates and number of dimensions; `None` without any.
    pub(super) fn combined<'a>(mut parts: impl Iterator<Item = &'a Residuals>) -> Option<Residuals> {
        let first = parts.next()?.clone();
        Some(parts.fold(first, |mut sum, part| {
            sum.weights.iter_mut().zip(&part.weights).for_each(|(sum, weight)| *sum += weight);
            sum.sums.iter_mut().zip(&part.sums).for_each(|(sum, part)| *sum += part);
            let phasors = sum.phasors.iter_mut().flatten().zip(part.phasors.iter().flatten());
            phasors.for_each(|(sum, part)| *sum += part);
            sum.coarseness_nanos = sum.coarseness_nanos.max(part.coarseness_nanos);
            sum
        }))
    }

    /// Adds an error of one dimension to a slot of the cycle; the weight is counted with dimension 0.
    pub(super) fn add(&mut self, slot: usize, dimension: usize, weight: f64, error: f64) {
        if dimension == 0 {
            self.weights[slot] += weight;
        }
        self.sums[slot * self.dimensions + dimension] += weight * error;
    }

    /// Adds an error of one dimension for the candidates that do not divide the cycle.
    pub(super) fn add_at(
        &mut self,
        civil_nanos: i64,
        candidates: &Candidates,
        (dimension, weight, error): (usize, f64, f64),
    ) {
        let mut point = Vec::with_capacity(2 * candidates.others().len());
        project(civil_nanos, candidates.others(), &mut point);
        for (phasors, turned) in self.phasors.chunks_exact_mut(1 + self.dimensions).zip(point.chunks_exact(2)) {
            for (place, turned) in turned.iter().enumerate() {
                if dimension == 0 {
                    phasors[0][place] += weight * turned;
                }
                phasors[1 + dimension][place] += weight * error * turned;
            }
        }
    }

    fn mean(&self, dimension: usize, total: f64) -> f64 {
        self.sums.iter().skip(dimension).step_by(self.dimensions).sum::<f64>() / total
    }

    /// Strength of each candidate period in the error, those of the cycle first: |Σ (ε - ε̄) e^(-j2πt/T)| of RA-L 2019
    /// eq. 7 (printed with the modulus inside the sum, which would leave the period out), over all dimensions.
    pub(super) fn spectrum(&self, candidates: &Candidates) -> Vec<(HypertimePeriod, f64)> {
        // Phasors are those of the slots' beginnings: half a slot of shift does not change the modulus.
        let slots = self.weights.len();
        let phasors: Vec<(f64, f64)> = (0..slots).map(|slot| libm::sincos(TAU * slot as f64 / slots as f64)).collect();
        let total: f64 = self.weights.iter().sum();
        let mut spectrum: Vec<(HypertimePeriod, f64)> = candidates.of_cycle().map(|period| (period, 0.0)).collect();
        for dimension in 0..self.dimensions {
            let mean = self.mean(dimension, total);
            for (period, power) in &mut spectrum {
                let (mut re, mut im) = (0.0, 0.0);
                for (slot, weight) in self.weights.iter().enumerate() {
                    let centred = self.sums[slot * self.dimensions + dimension] - mean * weight;
                    let (sin, cos) = phasors[slot * period.divisor as usize % slots];
                    re += centred * cos;
                    im -= centred * sin;
                }
                *power += re * re + im * im;
            }
        }
        for (&period, phasors) in candidates.others().iter().zip(self.phasors.chunks_exact(1 + self.dimensions)) {
            let centred = |dimension: usize, place: usize| {
                phasors[1 + dimension][place] - self.mean(dimension, total) * phasors[0][place]
            };
            let power = (0..self.dimensions).map(|d| square(centred(d, 0)) + square(centred(d, 1))).sum();
            spectrum.push((period, power));
        }
        spectrum.iter_mut().for_each(|(_, power)| *power = power.sqrt());
        spectrum
    }

    /// The strongest unused candidate that the readings can resolve.
    pub(super) fn strongest(&self, candidates: &Candidates, taken: &[HypertimePeriod]) -> Option<HypertimePeriod> {
        let mut best: Option<(f64, HypertimePeriod)> = None;
        let mut spectrum = self.spectrum(candidates);
        spectrum.sort_by(|(a, _), (b, _)| b.secs().total_cmp(&a.secs()));
        for (period, strength) in spectrum {
            let is_fine = period.secs() * 1e9 >= 4.0 * self.coarseness_nanos as f64;
            let is_stronger = best.is_none_or(|(before, _)| strength > before * (1.0 + ROUNDING));
            if is_fine && candidates.holds(period) && !taken.contains(&period) && is_stronger && strength > 0.0 {
                best = Some((strength, period));
            }
        }
        best.map(|(_, period)| period)
    }

    /// Sum of the spectrum: T_Σ of RA-L 2019 eq. 8, with the modulus outside the inner sum as in eq. 7.
    pub(super) fn total_strength(&self, candidates: &Candidates) -> f64 {
        self.spectrum(candidates).into_iter().map(|(_, strength)| strength).sum()
    }
}
