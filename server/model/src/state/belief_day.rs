//! The daily learning of the short-term forecasts of a state.
//!
//! Invariant: the belief is scored against the default predictions from before the day.

use super::StateModel;
use crate::special::square;
use crate::{Belief, MemoryBasis, Periodicities, Sample, StateKind, StateSensor};

/// The variance of a probability counts as at least this: smaller squared distances carry no information.
const UNIT_MIN: f64 = 0.01;

impl StateModel {
    /// The data for short-term forecasts; `None` while the state is untrained, unless its sensor is known.
    pub fn belief(&self) -> Option<&Belief> {
        self.belief.as_deref()
    }

    /// This state with stored data for short-term forecasts.
    #[must_use]
    pub fn with_belief(self, belief: Belief) -> StateModel {
        StateModel { belief: Some(Box::new(belief)), ..self }
    }

    /// This state with a known sensor, to be set before its first observation; only a probability has one.
    #[must_use]
    pub fn with_sensor(self, sensor: StateSensor) -> StateModel {
        if self.kind() != StateKind::Probability {
            return self;
        }
        let belief = self.belief.as_deref().cloned().unwrap_or_else(|| Belief::new(true));
        self.with_belief(belief.with_sensor(sensor))
    }

    /// The sensor that was stated for the state.
    pub fn sensor(&self) -> Option<StateSensor> {
        self.belief().and_then(Belief::sensor)
    }

    /// The data that the memory of the state needs beside its last values.
    pub fn memory_basis(&self) -> MemoryBasis {
        let mean = if self.kind() == StateKind::Probability { self.spectral().mean() } else { 0.5 };
        let rates = self.belief().and_then(Belief::rates_of_readings);
        MemoryBasis {
            usual_change: self.usual_change(),
            mean,
            first_nanos: self.accumulator().first_nanos(),
            most_likely_secs: rates.map(|rates| 1.0 / rates.sum()),
        }
    }

    /// Learns a day, before the other parts of the state learn it.
    pub(super) fn learn_belief(&mut self, periodicities: &Periodicities, of_day: &[Sample]) {
        let kind = self.kind();
        let mut belief = self.belief.take().unwrap_or_else(|| Box::new(Belief::new(kind == StateKind::Probability)));
        let variance =
            if self.accumulator.last_nanos().is_some() { self.accumulator.variance() } else { variance(of_day) };
        let unit = if kind == StateKind::Probability { variance.max(UNIT_MIN) } else { variance };
        if unit > 0.0 && unit.is_finite() {
            let predict = |samples: &[Sample]| self.predict_in_force(periodicities, samples);
            let is_trained = self.accumulator.last_nanos().is_some();
            belief.learn_day(of_day, is_trained.then_some(&predict), unit);
        } else {
            belief.learn_day(of_day, None, 1.0);
        }
        self.belief = Some(belief);
    }
}

fn variance(samples: &[Sample]) -> f64 {
    let count = samples.len().max(1) as f64;
    let mean = samples.iter().map(|sample| sample.value).sum::<f64>() / count;
    samples.iter().map(|sample| square(sample.value - mean)).sum::<f64>() / count
}
