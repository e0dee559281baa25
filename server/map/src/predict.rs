//! Questions to a view: what a state is at given times, and how well a model tells given observations.
//!
//! Invariant: a probability that leaves here lies in [0, 1]. The phasors of a set of times are computed once and shared
//! by all states.

use tidemap_model::{
    InstantPhasors, MAX_ORDER, OffsetCache, Persistence, PhasorTable, Sample, SpectralModel, StateModel,
};

use crate::{event::StateId, grid::view::CellDescription, view::MapView};

/// Which model answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ModelKind {
    /// The model and order that the last update chose.
    #[default]
    Auto,
    /// The mean of the values folded in.
    Mean,
    /// The last acknowledged value; 0.5 before the first.
    Latest,
    /// The mean and the strongest spectral components (T-RO 2017, section III).
    Spectral,
}

/// A model as a question names it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ModelSelector {
    /// Which model.
    pub kind: ModelKind,
    /// Number of spectral components, at most [`MAX_ORDER`]; by default the order that the last update chose. Without
    /// effect on kinds that have none.
    pub order: Option<usize>,
    /// Blends the last value in (T-RO eq. 12 and 13).
    pub persistence: bool,
}

impl ModelSelector {
    /// Order of the spectral model that answers for this state; 0 for a constant one.
    #[must_use]
    pub fn order_for(&self, model: &StateModel) -> usize {
        match self.kind {
            ModelKind::Auto | ModelKind::Spectral => self.order_or(model.order()),
            ModelKind::Mean | ModelKind::Latest => 0,
        }
    }

    /// The order asked for, or else the one that the last update chose.
    #[must_use]
    pub(crate) fn order_or(&self, chosen: usize) -> usize {
        self.order.unwrap_or(chosen).min(MAX_ORDER)
    }

    /// Order of the spectral model that answers for this cell; 0 for a constant one.
    #[must_use]
    pub fn order_for_cell(&self, cell: &CellDescription) -> usize {
        match self.kind {
            ModelKind::Auto | ModelKind::Spectral => self.order_or(cell.order),
            ModelKind::Mean | ModelKind::Latest => 0,
        }
    }
}

/// Times with their phasors, ready for any number of states of one map.
#[derive(Debug)]
pub struct PreparedTimes {
    utc_nanos: Vec<i64>,
    phasors: PhasorTable,
}

impl PreparedTimes {
    /// Number of times.
    #[must_use]
    pub fn len(&self) -> usize {
        self.utc_nanos.len()
    }

    /// Whether there is no time.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.utc_nanos.is_empty()
    }
}

impl MapView {
    /// Computes the phasors of times in nanoseconds UTC. Memory: 16 bytes per time and candidate periodicity.
    #[must_use]
    pub fn prepare(&self, utc_nanos: &[i64]) -> PreparedTimes {
        let mut offsets = self.spec.zone.offset_cache();
        let civil: Vec<i64> = utc_nanos.iter().map(|&nanos| civil_nanos(&mut offsets, nanos)).collect();
        PreparedTimes { utc_nanos: utc_nanos.to_vec(), phasors: PhasorTable::new(&self.spec.periodicities, &civil) }
    }

    /// Probability that a state is 1 at each of the times, written to `out`, which is as long as the times.
    pub fn predict_into(&self, id: StateId, times: &PreparedTimes, selector: ModelSelector, out: &mut [f64]) {
        let model = self.model(id);
        let live = self.live(id);
        predict_state((model.spectral(), selector.order_for(model), &live.persistence), times, selector, out);
    }

    /// Probability that a cell is occupied at each of the times, written to `out`, which is as long as the times.
    pub fn predict_cell_into(
        &self,
        cell: &CellDescription,
        times: &PreparedTimes,
        selector: ModelSelector,
        out: &mut [f64],
    ) {
        let parts = (&cell.spectral, selector.order_for_cell(cell), &cell.persistence);
        predict_state(parts, times, selector, out);
    }

    /// The phasors of one time in nanoseconds UTC, for many cells.
    pub(crate) fn instant(&self, utc_nanos: i64) -> InstantPhasors {
        let civil = civil_nanos(&mut self.spec.zone.offset_cache(), utc_nanos);
        InstantPhasors::new(&self.spec.periodicities, civil)
    }

    /// Observations given from outside, on the map's civil time.
    pub fn sample_maker(&self) -> impl FnMut(i64, f64) -> Sample + use<> {
        let mut offsets = self.spec.zone.offset_cache();
        move |utc_nanos, value| Sample { utc_nanos, offset_secs: offsets.offset_secs(utc_nanos), value }
    }
}

fn civil_nanos(offsets: &mut OffsetCache, utc_nanos: i64) -> i64 {
    utc_nanos.saturating_add(i64::from(offsets.offset_secs(utc_nanos)) * 1_000_000_000)
}

fn predict_state(
    (spectral, order, persistence): (&SpectralModel, usize, &Persistence),
    times: &PreparedTimes,
    selector: ModelSelector,
    out: &mut [f64],
) {
    match selector.kind {
        ModelKind::Auto | ModelKind::Spectral => spectral.predict_into(order, &times.phasors, out),
        ModelKind::Mean => out.fill(spectral.mean().clamp(0.0, 1.0)),
        ModelKind::Latest => out.fill(persistence.last().map_or(0.5, |(_, value)| value)),
    }
    if selector.persistence {
        for (probability, &nanos) in out.iter_mut().zip(&times.utc_nanos) {
            *probability = persistence.blend(*probability, nanos);
        }
    }
}
