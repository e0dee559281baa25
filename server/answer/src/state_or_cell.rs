//! A named state or a cell of the grid, as one view has it: every model that predicts one predicts the other.
//!
//! Invariant: a cell is described once, by the view in which it was looked up. Its readings count as the values that
//! the map's own sensor gives them; a model of the readings predicts probabilities.

use std::{borrow::Cow, sync::Arc};

use tidemap_grid::{
    index::{CellIndex, TileId},
    view::CellDescription,
};
use tidemap_map::{
    event::{Reporting, StateKind},
    history::Subject,
    ids::StateId,
    interval::cell_intervals,
    predict::PreparedTimes,
    view::MapView,
};
use tidemap_model::{
    HeldInterval, Persistence, Predictive, Sample,
    models::{Moment, TemporalModel},
    selector::{ModelKind, ModelSelector},
};

/// A named state or a cell.
#[derive(Clone, Debug)]
pub enum StateOrCell {
    /// A named state.
    State(StateId),
    /// A cell that was observed.
    Cell(Arc<KnownCell>),
}

/// A cell that was observed.
#[derive(Clone, Debug)]
pub struct KnownCell {
    /// Index of the cell.
    pub index: CellIndex,
    /// The tile that holds the cell.
    pub tile: TileId,
    /// The description of the cell in the view.
    pub description: CellDescription,
}

impl From<StateId> for StateOrCell {
    fn from(id: StateId) -> Self {
        Self::State(id)
    }
}

impl StateOrCell {
    /// The source of the readings, which identifies the state or cell in its map.
    pub fn subject(&self) -> Subject {
        match self {
            Self::State(id) => Subject::State(*id),
            Self::Cell(cell) => Subject::Cell(cell.tile, cell.index.tile().1),
        }
    }

    /// Name of the state, or `cell/X/Y/Z`.
    pub fn name<'a>(&self, view: &'a MapView) -> Cow<'a, str> {
        match self {
            Self::State(id) => Cow::Borrowed(view.info(*id).map_or("", |info| info.name.as_str())),
            Self::Cell(cell) => Cow::Owned(cell.index.name()),
        }
    }

    /// The meaning of the values.
    pub fn kind(&self, view: &MapView) -> StateKind {
        match self {
            Self::State(id) => view.kind(*id),
            Self::Cell(_) => StateKind::Probability,
        }
    }

    /// The way in which the observations are reported.
    pub fn reporting(&self, view: &MapView) -> Reporting {
        match self {
            Self::State(id) => view.info(*id).map_or(Reporting::Samples, |info| info.reporting),
            Self::Cell(_) => Reporting::Samples,
        }
    }

    /// Number of observations that updates have learned.
    pub fn learned(&self, view: &MapView) -> u64 {
        match self {
            Self::State(id) => view.model(*id).learned_observations(),
            Self::Cell(cell) => cell.description.folded,
        }
    }

    /// Number of acknowledged observations that no update has learned; of a cell, at most this number. A cell learns
    /// from bins, so that the difference of its observations and the learned ones is another number.
    pub fn pending(&self, view: &MapView) -> u64 {
        match self {
            Self::State(id) => view.pending_of(*id),
            Self::Cell(cell) => {
                let last = cell.description.persistence.last();
                let is_newer = last.is_some_and(|(nanos, _)| view.cut_nanos().is_none_or(|cut| nanos >= cut));
                let scans = view.grid().filter(|_| is_newer).map_or(0, |grid| grid.pending_scans());
                scans.min(cell.description.observations)
            }
        }
    }

    /// Number of observations acknowledged.
    pub fn observations(&self, view: &MapView) -> u64 {
        match self {
            Self::State(id) => view.as_observed(*id).observations,
            Self::Cell(cell) => cell.description.observations,
        }
    }

    /// The last value, and the duration of values.
    pub fn persistence(&self, view: &MapView) -> Persistence {
        match self {
            Self::State(id) => view.live(*id).persistence,
            Self::Cell(cell) => cell.description.persistence,
        }
    }

    /// The mean of the learned observations; before the first one, the prior.
    pub fn mean(&self, view: &MapView) -> f64 {
        match self {
            Self::State(id) => view.model(*id).spectral().mean(),
            Self::Cell(cell) => cell.description.spectral.mean(),
        }
    }

    /// Order of the spectral model that predicts the state or cell; 0 for a constant model or another kind.
    pub fn order(&self, view: &MapView, selector: ModelSelector) -> usize {
        match self {
            Self::State(id) => selector.order_for(view.model(*id)),
            Self::Cell(cell) => cell.description.order_for(selector),
        }
    }

    /// The model that predicts the state or cell. `None`: the prior predicts it, because nothing was learned.
    pub fn answered_by(&self, view: &MapView, selector: ModelSelector) -> Option<ModelSelector> {
        let is_learned = matches!(selector.kind, ModelKind::Auto | ModelKind::Mean | ModelKind::Spectral);
        if is_learned && !selector.is_blended() && self.learned(view) == 0 {
            return None;
        }
        Some(match self {
            Self::State(id) => selector.answering(view.model(*id)),
            Self::Cell(cell) => selector.answering_with(cell.description.order),
        })
    }

    /// Predicts the state or cell by the view's models. `out` is as long as the times.
    pub fn predict_into(&self, view: &MapView, times: &PreparedTimes, selector: ModelSelector, out: &mut [f64]) {
        match self {
            Self::State(id) => view.predict_into(*id, times, selector, out),
            Self::Cell(cell) => view.predict_cell_into(&cell.description, times, selector, out),
        }
    }

    /// Does the same as [`StateOrCell::predict_into`], without the newest readings: for models that are compared with
    /// observations.
    pub fn predict_long_term_into(
        &self,
        view: &MapView,
        times: &PreparedTimes,
        selector: ModelSelector,
        out: &mut [f64],
    ) {
        match self {
            Self::State(id) => view.predict_into(*id, times, selector.long_term(), out),
            Self::Cell(_) => self.predict_into(view, times, selector, out),
        }
    }

    /// Predicts the state or cell by a model that was trained on its readings. `out` is as long as the moments.
    pub fn predict_trained_into(
        &self,
        view: &MapView,
        moments: &[Moment],
        trained: &dyn TemporalModel,
        selector: ModelSelector,
        out: &mut [f64],
    ) {
        match self {
            Self::State(id) => view.predict_trained_into(*id, moments, trained, selector, out),
            Self::Cell(cell) => {
                view.predict_trained_cell_into(&cell.description, moments, trained, selector, out);
            }
        }
    }

    /// The predictive distributions around the predictions; `None` where bins are not counted: for a cell, and for a
    /// learned state without an ensemble.
    pub fn predictive_around(
        &self,
        view: &MapView,
        moments: &[Moment],
        probabilities: &[f64],
    ) -> Option<Vec<Predictive>> {
        let Self::State(id) = self else { return None };
        if self.learned(view) == 0 {
            // There are no observations yet.
            return Some(probabilities.iter().map(|&p| Predictive::new(p, 0.0, 0.0)).collect());
        }
        view.model(*id).predictive_around(moments, probabilities)
    }

    /// The bands of predictions by a model; none without a level.
    pub fn intervals(
        &self,
        view: &MapView,
        (moments, values): (&[Moment], &[f64]),
        selector: ModelSelector,
        level: Option<f64>,
    ) -> Vec<HeldInterval> {
        match self {
            Self::State(id) => view.intervals(*id, (moments, values), selector, level),
            Self::Cell(cell) => cell_intervals(&cell.description, values, level),
        }
    }

    /// The readings as samples on the map's civil time, with the values that they count as.
    pub fn samples(&self, view: &MapView, readings: impl IntoIterator<Item = (i64, f64)>) -> Vec<Sample> {
        let mut make = view.sample_maker();
        let levels = match self {
            Self::State(_) => None,
            Self::Cell(_) => view.grid().map(|grid| grid.levels()),
        };
        let value = |value: f64| levels.map_or(value, |(free, occupied)| free + value * (occupied - free));
        readings.into_iter().map(|(nanos, reading)| make(nanos, value(reading))).collect()
    }
}
