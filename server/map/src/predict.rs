//! Predictions of states and cells at given times.
//!
//! Invariant: a prediction lies in the bounds of its state's kind, a probability in [0, 1]. The phasors of a set of
//! times are computed once and shared by all states.

use std::borrow::Cow;

use tidemap_grid::{
    predict::{GridQuestion, GridSelection, TileCells},
    tile::TileUnavailable,
    view::{CellDescription, GridView},
};
use tidemap_model::{
    Belief, InstantPhasors, KnownAtNewest, MemoryBasis, OffsetCache, Persistence, PhasorTable, Sample, SpectralModel,
    StateKind,
    models::{Moment, TemporalModel},
    selector::{Blend, ModelKind, ModelSelector},
};

use crate::{
    ids::StateId,
    view::{LiveState, MapView},
};

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
    /// The predictions of the selected tiles, in their order; nothing if the map has no grid.
    pub fn predict_grid<'a>(
        &'a self,
        question: &'a GridQuestion,
        selection: &'a GridSelection,
    ) -> impl Iterator<Item = Result<TileCells, TileUnavailable>> + 'a {
        let predict = |grid: &'a GridView| grid.predict(question, selection, self.instant(question.utc_nanos));
        self.grid().map(predict).into_iter().flatten()
    }

    /// Computes the phasors of times in nanoseconds UTC. Memory: 16 bytes per time and candidate periodicity.
    pub fn prepare(&self, utc_nanos: &[i64]) -> PreparedTimes {
        let moments = self.moments(utc_nanos);
        let civil: Vec<i64> = moments.iter().map(|moment| moment.civil_nanos()).collect();
        PreparedTimes { moments, phasors: PhasorTable::new(&self.spec.periodicities, &civil) }
    }

    /// Times in nanoseconds UTC, with the local time of the map: the input of models that were trained on readings.
    pub fn moments(&self, utc_nanos: &[i64]) -> Vec<Moment> {
        let mut offsets = self.spec.zone.offset_cache();
        let moment = |&utc_nanos| Moment { utc_nanos, offset_secs: offsets.offset_secs(utc_nanos) };
        utc_nanos.iter().map(moment).collect()
    }

    /// Predicts a state at each moment by a model that was trained on its readings: the probability of 1, or the
    /// expected value. `out` is as long as the moments.
    pub fn predict_trained_into(
        &self,
        id: StateId,
        moments: &[Moment],
        trained: &dyn TemporalModel,
        selector: ModelSelector,
        out: &mut [f64],
    ) {
        let kind = self.kind(id);
        for (probability, &moment) in out.iter_mut().zip(moments) {
            // A sum of Gaussians or of components may be off by rounding.
            *probability = kind.saturate(trained.predict(moment));
        }
        self.blend(id, moments, selector, out);
    }

    /// Predicts a state at each time: the probability of 1, or the expected value. `out` is as long as the times. A
    /// kind of model that must be trained on readings first ([`ModelKind::needs_readings`]) predicts as
    /// [`ModelKind::Spectral`]. An ensemble predicts a state that has none by the chosen model.
    pub fn predict_into(&self, id: StateId, times: &PreparedTimes, selector: ModelSelector, out: &mut [f64]) {
        let model = self.model(id);
        let live = self.live(id);
        let is_default = selector.kind == ModelKind::Ensemble || selector.leaves_choice();
        match selector.kind {
            _ if is_default => {
                model.predict_in_force_into(&self.spec.periodicities, &times.phasors, &times.moments, out);
                self.draw_to_edges(id, &times.moments, out);
                match selector.knows_newest() {
                    true => self.believe(id, &times.moments, out),
                    false => self.blend(id, &times.moments, selector, out),
                }
            }
            ModelKind::Latest if live.persistence.last().is_none() => {
                out.fill(self.prior_models.of(model.kind()).spectral().mean());
            }
            _ => {
                let parts = (model.spectral(), selector.order_for(model), &live.persistence);
                predict_state(model.kind(), parts, times, selector, out);
                self.blend(id, &times.moments, selector, out);
            }
        }
    }

    /// Blends the newest readings of a state into predictions, if the selector requests it.
    fn blend(&self, id: StateId, moments: &[Moment], selector: ModelSelector, out: &mut [f64]) {
        let live = self.live(id);
        let moments = self.held_moments(id, &live, moments);
        blend(&live.persistence, self.model(id).memory_basis(), &moments, selector.blend, out);
    }

    /// The moments at which the newest readings are blended in. For a state that reports changes, the moments since its
    /// newest row are replaced by the last moment at which the value is known, because the value has held all the time.
    fn held_moments<'a>(&self, id: StateId, live: &LiveState, moments: &'a [Moment]) -> Cow<'a, [Moment]> {
        // The number of events of a step does not hold until the next one.
        let is_of_changes = self.info(id).is_some_and(|info| info.reporting.is_changes());
        let Some((until, _)) = live.persistence.last().filter(|_| is_of_changes) else {
            return Cow::Borrowed(moments);
        };
        let since = self.as_observed(id).newest_row.filter(|row| row.has_value).map_or(until, |row| row.nanos);
        if since >= until || !moments.iter().any(|moment| (since..until).contains(&moment.utc_nanos)) {
            return Cow::Borrowed(moments);
        }
        let held = |moment: &Moment| match (since..until).contains(&moment.utc_nanos) {
            true => Moment { utc_nanos: until, ..*moment },
            false => *moment,
        };
        Cow::Owned(moments.iter().map(held).collect())
    }

    /// Draws long-term predictions of a state towards its newest readings, by their weights at each lead time. Before
    /// the state's first update they count as with persistence, unless its sensor is known.
    fn believe(&self, id: StateId, moments: &[Moment], out: &mut [f64]) {
        let (live, model) = (self.live(id), self.model(id));
        let Some(newest) = live.persistence.last() else { return };
        let moments = &*self.held_moments(id, &live, moments);
        if !moments.iter().any(|at| Belief::is_near(newest.0, at.utc_nanos)) {
            return;
        }
        let blend_in = |belief: &Belief, out: &mut [f64]| {
            belief.blend_into(&live.recent, newest, self.known_at_newest(id, newest.0), moments, out);
        };
        match (model.belief(), self.info(id).and_then(|info| info.sensor)) {
            (Some(belief), _) => blend_in(belief, out),
            (None, Some(sensor)) => blend_in(&Belief::of_sensor(sensor), out),
            (None, None) => blend(&live.persistence, model.memory_basis(), moments, Blend::Persistence, out),
        }
        let kind = model.kind();
        out.iter_mut().for_each(|value| *value = kind.saturate(*value));
    }

    /// The long-term prediction for the newest reading of a state, and whether updates have learned it.
    fn known_at_newest(&self, id: StateId, nanos: i64) -> KnownAtNewest {
        let (times, mut out) = (self.prepare(&[nanos]), [0.0]);
        self.predict_into(id, &times, ModelSelector::default().long_term(), &mut out);
        KnownAtNewest { predicted: out[0], is_learned: self.has_learned(id, nanos) }
    }

    /// Whether updates have learned a reading of a state.
    pub(crate) fn has_learned(&self, id: StateId, utc_nanos: i64) -> bool {
        self.model(id).accumulator().last_nanos().is_some_and(|last| utc_nanos <= last)
    }

    /// Predicts the probability that a cell is occupied at each time. `out` is as long as the times.
    pub fn predict_cell_into(
        &self,
        cell: &CellDescription,
        times: &PreparedTimes,
        selector: ModelSelector,
        out: &mut [f64],
    ) {
        let parts = (&cell.spectral, cell.order_for(selector), &cell.persistence);
        predict_state(StateKind::Probability, parts, times, selector, out);
        cell.temper(selector, &times.moments, out);
        blend(&cell.persistence, cell.memory_basis(), &times.moments, selector.blend, out);
    }

    /// Predicts the probability that a cell is occupied at each moment by a model that was trained on its readings.
    /// `out` is as long as the moments.
    pub fn predict_trained_cell_into(
        &self,
        cell: &CellDescription,
        moments: &[Moment],
        trained: &dyn TemporalModel,
        selector: ModelSelector,
        out: &mut [f64],
    ) {
        for (probability, &moment) in out.iter_mut().zip(moments) {
            *probability = StateKind::Probability.saturate(trained.predict(moment));
        }
        blend(&cell.persistence, cell.memory_basis(), moments, selector.blend, out);
    }

    /// The phasors of one time in nanoseconds UTC, for many cells.
    pub(crate) fn instant(&self, utc_nanos: i64) -> InstantPhasors {
        let civil = civil_nanos(&mut self.spec.zone.offset_cache(), utc_nanos);
        InstantPhasors::new(&self.spec.periodicities, civil)
    }

    /// Makes samples on the map's civil time, for observations from outside the map.
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
    times: &PreparedTimes,
    selector: ModelSelector,
    out: &mut [f64],
) {
    match selector.kind {
        ModelKind::Mean => out.fill(kind.saturate(spectral.mean())),
        ModelKind::Latest => out.fill(persistence.last().map_or_else(|| kind.untrained(), |(_, value)| value)),
        _ => spectral.predict_values_into(kind, order, &times.phasors, out),
    }
}

/// Draws predictions towards the newest value of a state or cell.
fn blend(persistence: &Persistence, basis: MemoryBasis, moments: &[Moment], blend: Blend, out: &mut [f64]) {
    if blend == Blend::None {
        return;
    }
    for (probability, moment) in out.iter_mut().zip(moments) {
        *probability = blend.draw(persistence, basis, *probability, moment.utc_nanos);
    }
}
