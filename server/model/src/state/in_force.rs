//! What the model in force says of observations, as a query of `auto` would be answered.
//!
//! Invariant: a prediction lies in the bounds of the state's kind.

use super::{ActiveModel, StateModel};
use crate::{
    Periodicities, PhasorTable, Sample,
    models::{Moment, TemporalModel as _},
};

/// Observations that share one table of phasors; it stays in cache.
const CHUNK: usize = 1024;

impl StateModel {
    /// The predictions of the model in force at the times of samples; `periodicities` are those of its map.
    pub fn predict_in_force(&self, periodicities: &Periodicities, samples: &[Sample]) -> Vec<f64> {
        if self.ensemble().is_some() {
            let moments: Vec<Moment> = samples.iter().map(Sample::moment).collect();
            let predicted = self.predictive(periodicities, &moments).unwrap_or_default();
            return predicted.into_iter().map(|predicted| predicted.value()).collect();
        }
        let (kind, spectral, order) = (self.kind(), self.spectral(), self.order());
        let chosen = self.chosen(periodicities);
        let mut predictions = vec![0.0; samples.len()];
        if let Some(model @ (ActiveModel::Histogram(_) | ActiveModel::Trained(_))) = &chosen {
            for (prediction, sample) in predictions.iter_mut().zip(samples) {
                let at = sample.moment();
                *prediction = match model.covers(at) {
                    true => kind.saturate(model.predict(at)),
                    false => spectral.predict_value(kind, periodicities, order, at.civil_nanos()),
                };
            }
            return predictions;
        }
        let components: Vec<u32> = spectral.components().iter().take(order).map(|part| part.periodicity).collect();
        for (predictions, samples) in predictions.chunks_mut(CHUNK).zip(samples.chunks(CHUNK)) {
            let civil_nanos: Vec<i64> = samples.iter().map(Sample::civil_nanos).collect();
            let phasors = PhasorTable::only(periodicities, &civil_nanos, &components);
            spectral.predict_values_into(kind, order, &phasors, predictions);
            if let Some(ActiveModel::Combination(models)) = &chosen {
                let weight = models.spectral_weight();
                for (prediction, sample) in predictions.iter_mut().zip(samples) {
                    *prediction = kind.saturate(weight * *prediction + models.others_at(sample.moment()));
                }
            }
        }
        predictions
    }
}
