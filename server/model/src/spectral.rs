//! The spectral model of a state: its mean and its strongest periodic components.
//!
//! p(t) = ς(μ + Σ 2|γ_k| cos(ω_k t + arg γ_k)), ς saturating to `[0,1]`, γ_k = (A_k - μB_k)/n. T-RO eq. 10 and 11
//! differ in normalisation. With the normalisation here, the prediction of a sine is that sine.
//! Invariant: components are finite, strongest first, at most [`ORDER_MAX`] of them.

use crate::instruction_set::arch;
use crate::{Accumulator, Gaps, InvalidParts, ORDER_MAX, Periodicities, PhasorTable, StateKind};

mod cell;
mod component;
mod instant;
mod score;
mod sweep;
mod values;

pub use cell::CellSums;
pub use component::Component;
use component::Strongest;
pub use instant::InstantPhasors;
pub use score::{ReadingSums, ScoreSums};
use sweep::{Predict, Term};

#[cfg(test)]
mod tests;

/// A state over time as mean and components. By default untrained: 0.5 at all times.
#[derive(Clone, Debug, PartialEq)]
pub struct SpectralModel {
    mean: f64,
    observations: u64,
    components: Vec<Component>,
}

impl Default for SpectralModel {
    fn default() -> SpectralModel {
        SpectralModel { mean: 0.5, observations: 0, components: Vec::new() }
    }
}

impl SpectralModel {
    /// Trains the model of an accumulator: its mean and the [`ORDER_MAX`] strongest components. Of components that are
    /// equal within rounding, the one with the longest period comes first. A periodicity is eligible if the observed
    /// span (last less first, UTC) holds 0.99 of its period; components of 0 are omitted.
    pub fn train(accumulator: &Accumulator, periodicities: &Periodicities) -> SpectralModel {
        SpectralModel::train_with_gaps(accumulator, periodicities, &Gaps::default())
    }

    /// Does the same as [`SpectralModel::train`], with known gaps between the readings. The observed span has the
    /// median gap added, since each reading represents the time until the next: twelve monthly readings hold a year. A
    /// period that the readings cannot resolve from slower ones is not eligible: regular gaps are too long for it, or
    /// all readings are in phase with less than twice that period, such as readings at the same hour of each day.
    pub fn train_with_gaps(accumulator: &Accumulator, periodicities: &Periodicities, gaps: &Gaps) -> SpectralModel {
        let (mean, observations) = (accumulator.mean(), accumulator.observations());
        let per_observation = if observations == 0 { 1.0 } else { 1.0 / accumulator.weight() };
        let span_nanos = accumulator.span_nanos().saturating_add(gaps.median_nanos());
        let spectrum = accumulator.unpacked_spectrum(periodicities);
        let squares = spectrum.iter().map(|&[_, _, b_re, b_im]| b_re * b_re + b_im * b_im);
        let in_phase_nanos = periodicities.in_phase_nanos(squares, accumulator.weight());
        let resolved_nanos = gaps.regular_nanos().unwrap_or(0).max(in_phase_nanos);
        let mut strongest = Strongest::new();
        for (k, &[a_re, a_im, b_re, b_im]) in spectrum.iter().enumerate() {
            let gamma_re = (a_re - mean * b_re) * per_observation;
            let gamma_im = (a_im - mean * b_im) * per_observation;
            let power = gamma_re * gamma_re + gamma_im * gamma_im;
            if power > strongest.to_beat()
                && periodicities.is_eligible(k, span_nanos)
                && periodicities.is_resolved(k, resolved_nanos)
            {
                strongest.offer(power, Component { periodicity: k as u32, gamma_re, gamma_im });
            }
        }
        let components = strongest.into_components(periodicities);
        debug_assert!(components.len() <= ORDER_MAX, "{} components", components.len());
        debug_assert!(components.iter().all(|component| component.amplitude().is_finite()), "{components:?}");
        SpectralModel { mean, observations, components }
    }

    /// A model from stored parts: mean in `[0,1]`, components strongest first.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is outside its range or there are too many components.
    pub fn from_parts(mean: f64, observations: u64, components: Vec<Component>) -> Result<SpectralModel, InvalidParts> {
        SpectralModel::from_parts_of(StateKind::Probability, mean, observations, components)
    }

    /// A model of a state of the given kind from stored parts: mean in its bounds, components strongest first.
    ///
    /// # Errors
    /// The errors of [`SpectralModel::from_parts`].
    pub fn from_parts_of(
        kind: StateKind,
        mean: f64,
        observations: u64,
        components: Vec<Component>,
    ) -> Result<SpectralModel, InvalidParts> {
        InvalidParts::check("mean", mean, kind.bounds())?;
        if components.len() > ORDER_MAX {
            return Err(InvalidParts::OrderTooHigh { found: components.len() });
        }
        for component in &components {
            // |γ| is at most 1 for values in [0,1], and twice the magnitude of values that may be negative; leave room
            // for rounding.
            let max_amplitude = if kind == StateKind::Probability { 1.01 } else { 2.02 * kind.magnitude() };
            InvalidParts::check("gamma_re", component.gamma_re, -max_amplitude..=max_amplitude)?;
            InvalidParts::check("gamma_im", component.gamma_im, -max_amplitude..=max_amplitude)?;
        }
        Ok(SpectralModel { mean, observations, components })
    }

    /// Mean value μ; it is in `[0,1]` for a probability.
    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// Number of observations that the model was trained on.
    pub fn observations(&self) -> u64 {
        self.observations
    }

    /// The components, strongest first, at most [`ORDER_MAX`].
    pub fn components(&self) -> &[Component] {
        &self.components
    }

    /// The components that a prediction of that order uses.
    fn leading(&self, order: usize) -> &[Component] {
        &self.components[..order.min(self.components.len())]
    }

    /// Probability or expected value at a local civil time (nanoseconds since 1970 local) by the `order` strongest
    /// components, or all if there are fewer; in `[0,1]` (T-RO eq. 10).
    pub fn predict(&self, periodicities: &Periodicities, order: usize, civil_nanos: i64) -> f64 {
        self.sum(periodicities, order, civil_nanos).clamp(0.0, 1.0)
    }

    /// The sum of the mean and the leading components at a time, not saturated.
    fn sum(&self, periodicities: &Periodicities, order: usize, civil_nanos: i64) -> f64 {
        let mut p = self.mean;
        for component in self.leading(order) {
            // A periodicity that does not exist here adds nothing.
            if let Some(turns) = periodicities.turns(component.periodicity as usize, civil_nanos) {
                let (sin, cos) = libm::sincos(std::f64::consts::TAU * turns);
                p += 2.0 * (component.gamma_re * cos - component.gamma_im * sin);
            }
        }
        p
    }

    /// [`SpectralModel::predict`] at each time of a table, into the first `phasors.len()` places of `out`; if `out` is
    /// shorter, for the first times only. It is fast if the table holds the components' periodicities, and correct in
    /// any case.
    pub fn predict_into(&self, order: usize, phasors: &PhasorTable, out: &mut [f64]) {
        let mut terms = [Term::default(); ORDER_MAX];
        match self.terms(order, phasors, &mut terms) {
            Some(terms) => arch().dispatch(Predict { mean: self.mean, terms, times: phasors.len(), out }),
            None => {
                for (out, &civil) in out.iter_mut().zip(phasors.civil_nanos()) {
                    *out = self.predict(phasors.periodicities(), order, civil);
                }
            }
        }
    }

    /// The leading components in the form that the kernels need; `None` if the table lacks one.
    fn terms<'a, 'b>(
        &self,
        order: usize,
        phasors: &'a PhasorTable,
        terms: &'b mut [Term<'a>; ORDER_MAX],
    ) -> Option<&'b [Term<'a>]> {
        let leading = self.leading(order);
        for (term, component) in terms.iter_mut().zip(leading) {
            let (cos, sin) = phasors.row(component.periodicity)?;
            *term = Term { cos, sin, cos_weight: 2.0 * component.gamma_re, sin_weight: -2.0 * component.gamma_im };
        }
        terms.get(..leading.len())
    }
}
