//! Predictions and errors of states of any kind.
//!
//! Probabilities use the kernels that saturate to `[0,1]`; other kinds use plain loops and the bounds of the kind.
//! Invariant: a prediction lies in the bounds of the kind.

use super::{SpectralModel, sweep::Term};
use crate::{ORDER_MAX, Periodicities, PhasorTable, StateKind};

impl SpectralModel {
    /// [`SpectralModel::predict`] for a state of the given kind.
    pub fn predict_value(&self, kind: StateKind, periodicities: &Periodicities, order: usize, civil_nanos: i64) -> f64 {
        kind.saturate(self.sum(periodicities, order, civil_nanos))
    }

    /// [`SpectralModel::predict_into`] for a state of the given kind.
    pub fn predict_values_into(&self, kind: StateKind, order: usize, phasors: &PhasorTable, out: &mut [f64]) {
        if kind == StateKind::Probability {
            return self.predict_into(order, phasors, out);
        }
        let mut terms = [Term::default(); ORDER_MAX];
        match self.terms(order, phasors, &mut terms) {
            Some(terms) => {
                let times = phasors.len().min(out.len());
                let out = &mut out[..times];
                out.fill(self.mean);
                for term in terms {
                    for ((out, cos), sin) in out.iter_mut().zip(term.cos).zip(term.sin) {
                        *out += term.cos_weight * cos + term.sin_weight * sin;
                    }
                }
                out.iter_mut().for_each(|out| *out = kind.saturate(*out));
            }
            None => {
                for (out, &civil) in out.iter_mut().zip(phasors.civil_nanos()) {
                    *out = self.predict_value(kind, phasors.periodicities(), order, civil);
                }
            }
        }
    }

    /// Adds the squared errors of every order 0..=[`ORDER_MAX`] at predicting values of a state of that kind at the
    /// times of the table, which holds the components' periodicities.
    pub(crate) fn score_values(
        &self,
        kind: StateKind,
        phasors: &PhasorTable,
        values: &[f64],
        squared: &mut [f64; ORDER_MAX + 1],
    ) {
        let mut terms = [Term::default(); ORDER_MAX];
        let terms = self.terms(ORDER_MAX, phasors, &mut terms).unwrap_or(&[]);
        for (time, &value) in values.iter().enumerate().take(phasors.len()) {
            let mut sum = self.mean;
            for (order, squared) in squared.iter_mut().enumerate() {
                // Every order above the number of components has the same prediction.
                if let Some(term) = order.checked_sub(1).and_then(|index| terms.get(index)) {
                    sum += term.cos_weight * term.cos[time] + term.sin_weight * term.sin[time];
                }
                let error = kind.saturate(sum) - value;
                *squared += error * error;
            }
        }
    }
}
