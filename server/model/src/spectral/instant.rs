//! Predictions of many states at one time: a cell of a map costs a few multiplications and no trigonometry.
//!
//! Invariant: predictions are equal to those of [`SpectralModel::predict`], bit by bit.

use super::SpectralModel;
use crate::Periodicities;

#[cfg(test)]
mod tests;

/// Cosines and sines of the phases of one time in all periodicities.
#[derive(Clone, Debug)]
pub struct InstantPhasors {
    civil_nanos: i64,
    /// (cos, sin) per periodicity.
    phasors: Box<[(f64, f64)]>,
}

impl InstantPhasors {
    /// Phasors of a local civil time (nanoseconds since 1970 local) in every periodicity.
    pub fn new(periodicities: &Periodicities, civil_nanos: i64) -> InstantPhasors {
        let phasor = |k: usize| {
            let turns = periodicities.turns(k, civil_nanos).unwrap_or(0.0);
            let (sin, cos) = libm::sincos(std::f64::consts::TAU * turns);
            (cos, sin)
        };
        InstantPhasors { civil_nanos, phasors: (0..periodicities.len()).map(phasor).collect() }
    }

    /// The time, local civil, in nanoseconds since 1970 local.
    pub fn civil_nanos(&self) -> i64 {
        self.civil_nanos
    }
}

impl SpectralModel {
    /// [`SpectralModel::predict`] at the time of the phasors: by the `order` strongest components, or all if there are
    /// fewer; in `[0,1]`.
    #[inline]
    pub fn predict_at(&self, order: usize, phasors: &InstantPhasors) -> f64 {
        let mut p = self.mean;
        for component in self.leading(order) {
            // A periodicity that does not exist here adds nothing.
            if let Some((cos, sin)) = phasors.phasors.get(component.periodicity as usize) {
                p += 2.0 * (component.gamma_re * cos - component.gamma_im * sin);
            }
        }
        p.clamp(0.0, 1.0)
    }
}
