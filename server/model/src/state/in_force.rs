//! The default predictions of a state: of the ensemble, else of the model that the last update chose.
//!
//! Invariant: a prediction lies in the bounds of the state's kind.

use super::{ActiveModel, StateModel};
use crate::special::square;
use crate::{
    Periodicities, PhasorTable, Sample,
    models::{Moment, TemporalModel as _},
};

/// Number of observations that share one table of phasors, so that the table stays in cache.
const CHUNK: usize = 1024;

impl StateModel {
    /// Predicts with the default model: the probability of 1, or the expected value. `out` is as long as the moments;
    /// `phasors`: the phasors of their times, with the components in use. `periodicities` are those of the map of the
    /// state.
    pub fn predict_in_force_into(
        &self,
        periodicities: &Periodicities,
        phasors: &PhasorTable,
        moments: &[Moment],
        out: &mut [f64],
    ) {
        let (kind, spectral, order) = (self.kind(), self.spectral(), self.order());
        if let Some(ensemble) = self.ensemble() {
            let predicted = ensemble.predict(moments, self.chosen_member(periodicities).others());
            out.iter_mut().zip(predicted).for_each(|(out, predicted)| *out = kind.saturate(predicted));
            return;
        }
        match self.chosen(periodicities) {
            None => spectral.predict_values_into(kind, order, phasors, out),
            // Faster than [`Combination`](super::Combination)'s own prediction: all times share their phasors.
            Some(ActiveModel::Combination(models)) => {
                let weight = models.spectral_weight();
                out.fill(0.0);
                if weight > 0.0 {
                    spectral.predict_values_into(kind, order, phasors, out);
                }
                for (out, &moment) in out.iter_mut().zip(moments) {
                    *out = kind.saturate(weight * *out + models.others_at(moment));
                }
            }
            Some(ActiveModel::Histogram(_) | ActiveModel::Trained(_)) => {
                let chosen = self.chosen_member(periodicities);
                out.iter_mut().zip(moments).for_each(|(out, &moment)| *out = chosen.predict(moment));
            }
        }
    }

    /// The expected squared distances of the means of the hours around moments from the default predictions without the
    /// newest reading; `None` where no ensemble of numbers predicts.
    pub fn variances(&self, moments: &[Moment]) -> Option<Vec<f64>> {
        let ensemble = self.ensemble()?.of_number()?;
        Some(moments.iter().map(|&at| ensemble.variance(at)).collect())
    }

    /// The expected squared distances of the means of the hours around moments from predictions of any model: the
    /// variance of the ensemble, plus the squared distance of its prediction from that of the model. `None` where no
    /// ensemble of numbers predicts. `periodicities` are those of the map of the state.
    pub fn variances_around(
        &self,
        periodicities: &Periodicities,
        moments: &[Moment],
        values: &[f64],
    ) -> Option<Vec<f64>> {
        let ensemble = self.ensemble()?.of_number()?;
        let own = ensemble.predict(moments, self.chosen_member(periodicities).others());
        let variance = |((&at, own), value): ((&Moment, f64), &f64)| {
            ensemble.variance(at) + square(self.kind().saturate(own) - value)
        };
        Some(moments.iter().zip(own).zip(values).map(variance).collect())
    }

    /// The predictions of the default model at the times of samples; `periodicities` are those of the map of the state.
    pub fn predict_in_force(&self, periodicities: &Periodicities, samples: &[Sample]) -> Vec<f64> {
        let components = self.spectral.components().iter().take(self.order());
        let components: Vec<u32> = components.map(|component| component.periodicity).collect();
        let mut predictions = vec![0.0; samples.len()];
        for (predictions, samples) in predictions.chunks_mut(CHUNK).zip(samples.chunks(CHUNK)) {
            let moments: Vec<Moment> = samples.iter().map(Sample::moment).collect();
            let civil_nanos: Vec<i64> = samples.iter().map(Sample::civil_nanos).collect();
            let phasors = PhasorTable::only(periodicities, &civil_nanos, &components);
            self.predict_in_force_into(periodicities, &phasors, &moments, predictions);
        }
        predictions
    }
}
