//! The immutable view of a map that queries read.
//!
//! Invariant: a view never changes. It is complete up to one log position: every observation acknowledged before the
//! view was taken counts in it.

use std::sync::{Arc, OnceLock};

use tidemap_grid::view::GridView;
use tidemap_model::StateModel;

pub use crate::{directory::StateInfo, live_state::LiveState};

use crate::{
    directory::Directory,
    event::{StateKind, StateShape},
    ids::StateId,
    name::StateName,
    prior_models::PriorModels,
    site::Site,
    spec::MapSpec,
};

/// Live values are copied on publication in pieces of this many states.
pub(crate) const LIVE_CHUNK: usize = 128;

/// An immutable view of a map.
#[derive(Clone, Debug)]
pub struct MapView {
    pub(crate) spec: Arc<MapSpec>,
    pub(crate) position: u64,
    pub(crate) generation: u64,
    pub(crate) cut_nanos: i64,
    pub(crate) observations: u64,
    pub(crate) pending: u64,
    pub(crate) ahead: u64,
    pub(crate) waiting_rows: u64,
    /// Latest time of the observations that did not have to wait.
    pub(crate) newest_nanos: i64,
    /// Whether any state reports changes or events.
    pub(crate) has_rows: bool,
    /// The time for which the view is evaluated, if it is known.
    pub(crate) now_nanos: Option<i64>,
    pub(crate) directory: Directory,
    pub(crate) live: Vec<Arc<[LiveState]>>,
    pub(crate) models: Arc<Vec<Arc<StateModel>>>,
    pub(crate) prior_models: PriorModels,
    pub(crate) site: Arc<Site>,
    pub(crate) grid: Option<GridView>,
    /// The mean success of the edges, computed at the first request.
    pub(crate) edge_success: OnceLock<f64>,
}

/// The number of observations and scans that an update would learn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotLearned {
    /// Number of observations.
    pub observations: u64,
    /// Number of scans.
    pub scans: u64,
    /// Whether no update has learned anything of the map.
    pub is_all: bool,
}

impl MapView {
    /// The fixed properties of the map.
    pub fn spec(&self) -> &MapSpec {
        &self.spec
    }

    /// The grid, where the map has one.
    pub fn grid(&self) -> Option<&GridView> {
        self.grid.as_ref()
    }

    /// The site: the data that people and robots give the map besides observations.
    pub fn site(&self) -> &Site {
        &self.site
    }

    /// Log position up to which the view is complete.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Number of updates published so far.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Cut of the last update in nanoseconds UTC: older observations are learned. `None` before the first update.
    pub fn cut_nanos(&self) -> Option<i64> {
        (self.generation > 0).then_some(self.cut_nanos)
    }

    /// Observations acknowledged, refused ones not counted.
    pub fn observations(&self) -> u64 {
        self.observations
    }

    /// Observations that no update has learned yet.
    pub fn pending(&self) -> u64 {
        self.pending
    }

    /// The data that an update would learn now, without the data that waits ahead of the clock. `None`: there is none.
    pub fn not_learned(&self) -> Option<NotLearned> {
        let (scans, pending_scans, scans_ahead) =
            self.grid().map_or((0, 0, 0), |grid| (grid.scans(), grid.pending_scans(), grid.scans_ahead()));
        let waiting = NotLearned {
            observations: self.pending.saturating_sub(self.ahead),
            scans: pending_scans.saturating_sub(scans_ahead),
            is_all: self.pending == self.observations && pending_scans == scans,
        };
        (waiting.observations > 0 || waiting.scans > 0).then_some(waiting)
    }

    /// Pending rows of changes or events for which the update that took them had no room: they represent too many
    /// readings. The next update learns more of them.
    pub fn waiting_rows(&self) -> u64 {
        self.waiting_rows
    }

    /// Pending observations that wait because their time is more than
    /// [`FUTURE_MAX_NANOS`](tidemap_model::time::FUTURE_MAX_NANOS) later than the clock.
    pub fn ahead(&self) -> u64 {
        self.ahead
    }

    /// Whether the current value of a state depends on the current time: some states report changes or events.
    pub fn depends_on_now(&self) -> bool {
        self.has_rows
    }

    /// This view evaluated for a time: values that were reported as changes hold up to that time.
    #[must_use]
    pub fn as_of(&self, now_nanos: i64) -> MapView {
        MapView { now_nanos: Some(now_nanos), ..self.clone() }
    }

    /// Number of states.
    pub fn len(&self) -> usize {
        self.directory.len()
    }

    /// Whether the map has no state yet.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The state of this name.
    pub fn find(&self, name: &str) -> Option<StateId> {
        self.directory.find(name)
    }

    /// The shape of the observations of a name, with the id of its state, or of its first axis or label.
    pub fn shape(&self, name: &str) -> Option<(StateId, StateShape)> {
        self.directory.shape(name)
    }

    /// The labels of the categorical state of this name with their states, in order; empty for other states.
    pub fn labels(&self, name: &str) -> Vec<(StateId, &str)> {
        let Some((first, StateShape::Categorical(count))) = self.shape(name) else { return Vec::new() };
        let ids = (first.0..).map(StateId).take(usize::from(count));
        ids.filter_map(|id| Some((id, self.info(id)?.name.as_label()?.1))).collect()
    }

    /// The names of all categorical states, in no order.
    pub fn categorical_states(&self) -> impl Iterator<Item = &StateName> {
        self.directory.categorical_states()
    }

    /// Name, kind and sensor of a state.
    pub fn info(&self, id: StateId) -> Option<&StateInfo> {
        self.directory.info(id)
    }

    /// All states, in order of first appearance.
    pub fn infos(&self) -> impl Iterator<Item = &StateInfo> {
        self.directory.iter()
    }

    /// Last value, persistence and number of observations of a state. If the state reports changes or events, the
    /// current value follows from its newest row.
    pub fn live(&self, id: StateId) -> LiveState {
        let live = self.as_observed(id);
        match self.info(id) {
            Some(info) if live.newest_row.is_some() => live.at(info.reporting, self.now_nanos, self.newest_nanos),
            _ => live,
        }
    }

    /// Last value, persistence and number of observations of a state by its observations alone.
    pub fn as_observed(&self, id: StateId) -> LiveState {
        let index = id.0 as usize;
        self.live.get(index / LIVE_CHUNK).and_then(|chunk| chunk.get(index % LIVE_CHUNK)).copied().unwrap_or_default()
    }

    /// Number of acknowledged observations of a state that no update has learned yet.
    pub fn pending_of(&self, id: StateId) -> u64 {
        self.as_observed(id).observations.saturating_sub(self.model(id).learned_observations())
    }

    /// Kind of a state; probability for an unknown state.
    pub fn kind(&self, id: StateId) -> StateKind {
        self.info(id).map_or_else(StateKind::default, |info| info.kind)
    }

    /// The model of a state from the last update; the prior model before the state's first update.
    pub fn model(&self, id: StateId) -> &StateModel {
        self.models.get(id.0 as usize).unwrap_or_else(|| self.prior_models.of(self.kind(id)))
    }
}
