//! The spectral model with a fixed order, trained on readings at once: FreMEn without the choice of an update.
//!
//! Invariant: a prediction lies in the bounds of the state's kind.

use super::{CannotTrain, Moment, Readings, TemporalModel};
use crate::{Accumulator, Component, Periodicities, SpectralModel, StateKind};

/// The mean and the strongest components of the readings, of one order (T-RO 2017, section III).
#[derive(Clone, Debug, PartialEq)]
pub struct FixedOrder {
    model: SpectralModel,
    kind: StateKind,
    order: usize,
    periodicities: Periodicities,
}

impl FixedOrder {
    /// Trains the spectrum of a state of this kind, with readings of equal weight. `order`: number of components, 0 to
    /// [`crate::ORDER_MAX`].
    ///
    /// # Errors
    /// [`CannotTrain`] where there are no readings.
    pub fn train(
        readings: Readings<'_>,
        kind: StateKind,
        periodicities: &Periodicities,
        order: usize,
    ) -> Result<FixedOrder, CannotTrain> {
        if readings.samples.is_empty() {
            return Err(CannotTrain::NoReadings);
        }
        let mut accumulator = Accumulator::of_kind(kind);
        accumulator.add(periodicities, readings.samples);
        let model = SpectralModel::train(&accumulator, periodicities);
        Ok(FixedOrder { model, kind, order, periodicities: periodicities.clone() })
    }

    /// The mean of the readings, in the unit of their values.
    pub fn mean(&self) -> f64 {
        self.model.mean()
    }

    /// Period in seconds, amplitude in the unit of the values and phase in radians of each component that the model
    /// uses, the strongest first.
    pub fn rhythms(&self) -> Vec<(f64, f64, f64)> {
        let rhythm = |component: &Component| {
            let period_secs = self.periodicities.period_secs(component.periodicity as usize);
            (period_secs, component.amplitude(), component.phase_rad())
        };
        self.model.components().iter().take(self.order).map(rhythm).collect()
    }
}

impl TemporalModel for FixedOrder {
    fn predict(&self, at: Moment) -> f64 {
        self.model.predict_value(self.kind, &self.periodicities, self.order, at.civil_nanos())
    }
}
