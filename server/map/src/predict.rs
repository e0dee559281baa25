//! Predictions of states and cells at given times.
//!
//! Invariant: a prediction lies in the bounds of its state's kind, a probability in [0, 1]. The phasors of a set of
//! times are computed once and shared by all states.

use tidemap_model::{
    ActiveModel, InstantPhasors, OffsetCache, Persistence, PhasorTable, Sample, SpectralModel, StateKind,
    models::{Moment, TemporalModel},
};

use crate::{
    grid::view::CellDescription,
    ids::StateId,
    selector::{ModelKind, ModelSelector},
    view::MapView,
};

impl ModelSelector {
    /// Order of the spectral model that predicts this cell; 0 for a constant model.
    pub fn order_for_cell(&self, cell: &CellDescription) -> usize {
        if self.kind.has_order() { self.order_or(cell.order) } else { 0 }
    }
}

/// Times with their phasors, ready for any number of states of one map.
#[derive(Debug)]
pub struct PreparedTimes {
    moments: Vec<Moment>,
    phasors: PhasorTable,
}

impl PreparedTimes {
    /// Number of times.
    pub fn len(&self) -> usize {
        self.moments.len()
    }

    /// Whether there is no time.
    pub fn is_empty(&self) -> bool {
        self.moments.is_empty()
    }

    /// The times, with the local time of the map.
    pub fn moments(&self) -> &[Moment] {
        &self.moments
    }
}

impl MapView {
    /// Computes the phasors of times in nanoseconds UTC. Memory: 16 bytes per time and candidate periodicity.
    pub fn prepare(&self, utc_nanos: &[i64]) -> PreparedTimes {
        let moments = self.moments(utc_nanos);
        let civil: Vec<i64> = moments.iter().map(|moment| moment.civil_nanos()).collect();
        PreparedTimes { moments, phasors: PhasorTable::new(&self.spec.periodicities, &civil) }
    }

    /// Times in nanoseconds UTC, with the local time of the map: the input of models that were fitted to readings.
    pub fn moments(&self, utc_nanos: &[i64]) -> Vec<Moment> {
        let mut offsets = self.spec.zone.offset_cache();
        let moment = |&utc_nanos| Moment { utc_nanos, offset_secs: offsets.offset_secs(utc_nanos) };
        utc_nanos.iter().map(moment).collect()
    }

    /// Predicts a state at each moment by a model that was fitted to its readings: the probability of 1, or the
    /// expected value. `out` is as long as the moments.
    pub fn predict_fitted_into(
        &self,
        id: StateId,
        moments: &[Moment],
        fitted: &dyn TemporalModel,
        with_persistence: bool,
        out: &mut [f64],
    ) {
        let kind = self.kind(id);
        for (probability, &moment) in out.iter_mut().zip(moments) {
            // A sum of Gaussians or of components may be off by rounding.
            *probability = kind.saturate(fitted.predict(moment));
        }
        if with_persistence {
            blend(&self.live(id).persistence, self.model(id).usual_change(), moments, out);
        }
    }

    /// Predicts a state at each time: the probability of 1, or the expected value. `out` is as long as the times. A
    /// kind that must be fitted to readings first ([`ModelKind::needs_readings`]) predicts as [`ModelKind::Auto`].
    pub fn predict_into(&self, id: StateId, times: &PreparedTimes, selector: ModelSelector, out: &mut [f64]) {
        let model = self.model(id);
        let live = self.live(id);
        let chosen = if selector.kind == ModelKind::Auto && selector.order.is_none() {
            model.chosen(&self.spec.periodicities)
        } else {
            None
        };
        match chosen {
            // Faster than [`Combination`]'s own prediction: all times share their phasors.
            Some(ActiveModel::Combination(models)) => {
                let (kind, weight) = (model.kind(), models.spectral_weight());
                out.fill(0.0);
                if weight > 0.0 {
                    model.spectral().predict_values_into(kind, model.order(), &times.phasors, out);
                }
                for (out, &moment) in out.iter_mut().zip(&times.moments) {
                    *out = kind.saturate(weight * *out + models.others_at(moment));
                }
                if selector.persistence {
                    blend(&live.persistence, model.usual_change(), &times.moments, out);
                }
            }
            Some(chosen) => {
                self.predict_fitted_into(id, &times.moments, &chosen, false, out);
                for (probability, &moment) in out.iter_mut().zip(&times.moments) {
                    if !chosen.covers(moment) {
                        let (kind, periodicities) = (model.kind(), &self.spec.periodicities);
                        let (spectral, civil_nanos) = (model.spectral(), moment.civil_nanos());
                        *probability = spectral.predict_value(kind, periodicities, model.order(), civil_nanos);
                    }
                }
                if selector.persistence {
                    blend(&live.persistence, model.usual_change(), &times.moments, out);
                }
            }
            None if selector.kind == ModelKind::Latest && live.persistence.last().is_none() => {
                out.fill(self.prior_models.of(model.kind()).spectral().mean());
            }
            None => {
                let parts = (model.spectral(), selector.order_for(model), &live.persistence);
                predict_state(model.kind(), parts, model.usual_change(), times, selector, out);
            }
        }
    }

    /// Predicts the probability that a cell is occupied at each time. `out` is as long as the times.
    pub fn predict_cell_into(
        &self,
        cell: &CellDescription,
        times: &PreparedTimes,
        selector: ModelSelector,
        out: &mut [f64],
    ) {
        let parts = (&cell.spectral, selector.order_for_cell(cell), &cell.persistence);
        predict_state(StateKind::Probability, parts, 1.0, times, selector, out);
    }

    /// Predicts the probability that a cell is occupied at each moment by a model that was fitted to its readings.
    /// `out` is as long as the moments.
    pub fn predict_fitted_cell_into(
        &self,
        cell: &CellDescription,
        moments: &[Moment],
        fitted: &dyn TemporalModel,
        with_persistence: bool,
        out: &mut [f64],
    ) {
        for (probability, &moment) in out.iter_mut().zip(moments) {
            *probability = StateKind::Probability.saturate(fitted.predict(moment));
        }
        if with_persistence {
            blend(&cell.persistence, 1.0, moments, out);
        }
    }

    /// The phasors of one time in nanoseconds UTC, for many cells.
    pub(crate) fn instant(&self, utc_nanos: i64) -> InstantPhasors {
        let civil = civil_nanos(&mut self.spec.zone.offset_cache(), utc_nanos);
        InstantPhasors::new(&self.spec.periodicities, civil)
    }

    /// Makes samples on the map's civil time, for observations from outside.
    pub fn sample_maker(&self) -> impl FnMut(i64, f64) -> Sample + use<> {
        let mut offsets = self.spec.zone.offset_cache();
        move |utc_nanos, value| Sample { utc_nanos, offset_secs: offsets.offset_secs(utc_nanos), value }
    }
}

fn civil_nanos(offsets: &mut OffsetCache, utc_nanos: i64) -> i64 {
    utc_nanos.saturating_add(i64::from(offsets.offset_secs(utc_nanos)) * 1_000_000_000)
}

fn predict_state(
    kind: StateKind,
    (spectral, order, persistence): (&SpectralModel, usize, &Persistence),
    usual_change: f64,
    times: &PreparedTimes,
    selector: ModelSelector,
    out: &mut [f64],
) {
    match selector.kind {
        ModelKind::Mean => out.fill(kind.saturate(spectral.mean())),
        ModelKind::Latest => out.fill(persistence.last().map_or_else(|| kind.untrained(), |(_, value)| value)),
        _ => spectral.predict_values_into(kind, order, &times.phasors, out),
    }
    if selector.persistence {
        blend(persistence, usual_change, &times.moments, out);
    }
}

fn blend(persistence: &Persistence, usual_change: f64, moments: &[Moment], out: &mut [f64]) {
    for (probability, moment) in out.iter_mut().zip(moments) {
        *probability = persistence.blend_of(usual_change, *probability, moment.utc_nanos);
    }
}
