//! The forecasts of all edges of a map, at any time.
//!
//! Invariant: all data comes from one view. Speeds are predicted by the model that the last update chose; success by
//! that model too, or by a model that the caller provides.

use std::{
    collections::HashMap,
    sync::{Arc, OnceLock},
};
use tidemap_model::selector::{Blend, ModelSelector};

use super::{EdgeForecast, EdgePrior, EdgeRecord, EdgeStates, LEARNED_SUCCESS_MIN};

use crate::{
    ids::StateId,
    predict::PreparedTimes,
    topology::{Edge, EdgeId, Topology},
    traversal::{success_state, travel_state},
    view::MapView,
};

/// Longest memory of an edge's last report. Robots avoid an edge that failed, so that the report after a failure comes
/// late, and the rates of change that follow from reports are too low. Chosen in the simulated building of `tidemap
/// experiment routes` with the seeds 100 to 103, among 300 s, 900 s and no limit.
const MEMORY_MAX_SECS: f64 = 900.0;
/// Weight, in reports of about that hour, of the last report of an edge while it is new: a well-known edge that fails
/// once is hardly doubted. Chosen with the seeds 100 to 119, among 1, 3 and 8.
const LAST_REPORTS: f64 = 3.0;

/// An edge with reports.
#[derive(Debug)]
struct ReportedEdge {
    /// The record is built on first use: a route uses few of the edges of a large map.
    record: OnceLock<EdgeRecord>,
    states: EdgeStates,
}

/// The edges of a map.
#[derive(Debug)]
pub struct EdgeForecasts {
    view: Arc<MapView>,
    prior: EdgePrior,
    known: HashMap<EdgeId, ReportedEdge>,
    blend: Blend,
}

impl EdgeForecasts {
    /// The edges of a view. `speed_m_per_s`: the speed without reports, above 0. `blend`: whether and how the last
    /// report of an edge still counts: with persistence (T-RO 2017, eq. 12 and 13), with belief, or with memory (the
    /// fading weight of RAS 2017, eq. 6, as the weight of some reports beside the forecast's evidence). The kind and
    /// the order of the blend are ignored.
    pub fn new(view: Arc<MapView>, speed_m_per_s: f64, blend: Blend) -> EdgeForecasts {
        let topology = view.site().topology();
        let reported: Vec<(&Edge, EdgeStates)> = topology
            .edges()
            .map(|edge| (edge, states_of(&view, topology, edge)))
            .filter(|(_, states)| *states != EdgeStates::default())
            .collect();
        let prior = EdgePrior::of(&view, reported.iter().map(|(edge, states)| (edge.extent, *states)), speed_m_per_s);
        let known = |(edge, states): (&Edge, EdgeStates)| (edge.id, ReportedEdge { record: OnceLock::new(), states });
        let known = reported.into_iter().map(known).collect();
        EdgeForecasts { view, prior, known, blend }
    }

    /// The success states of all edges, in no order.
    pub fn success_states(&self) -> impl Iterator<Item = StateId> {
        self.known.values().filter_map(|known| known.states.success)
    }

    /// The forecast of an edge at a time in nanoseconds UTC.
    pub fn forecast(&self, edge: &Edge, time_nanos: i64) -> EdgeForecast {
        let by_chosen = |id: StateId, times: &PreparedTimes| self.predict(id, times);
        self.forecast_with(edge, time_nanos, by_chosen)
    }

    /// The forecast of an edge with a success model of the caller: `success` predicts the success state at the single
    /// time given.
    pub fn forecast_with(
        &self,
        edge: &Edge,
        time_nanos: i64,
        success: impl FnOnce(StateId, &PreparedTimes) -> f64,
    ) -> EdgeForecast {
        let Some(ReportedEdge { record, states }) = self.known.get(&edge.id) else {
            let record = EdgeRecord::of(&self.view, edge.extent, EdgeStates::default(), &self.prior);
            return record.forecast(&self.prior, f64::NAN, f64::NAN, self.view.moments(&[time_nanos])[0]);
        };
        let record = record.get_or_init(|| EdgeRecord::of(&self.view, edge.extent, *states, &self.prior));
        let times = self.view.prepare(&[time_nanos]);
        let success = states.success.map_or(f64::NAN, |id| success(id, &times));
        let travel = states.travel.map_or(f64::NAN, |id| self.predict(id, &times));
        let mut forecast = record.forecast(&self.prior, success, travel, times.moments()[0]);
        if let Some(id) = states.success.filter(|_| self.blend != Blend::None) {
            let persistence = &self.view.live(id).persistence;
            let blended = match self.blend {
                Blend::None => forecast.success,
                Blend::Persistence => persistence.blend(forecast.success, time_nanos),
                Blend::Belief => {
                    let mut success = [forecast.success];
                    self.view.believe(id, times.moments(), &mut success);
                    success[0]
                }
                Blend::Memory => {
                    let basis = self.view.model(id).memory_basis();
                    let weight = persistence.memory_weight(basis, Some(MEMORY_MAX_SECS), time_nanos);
                    let last_value = persistence.last().map_or(0.0, |(_, value)| value);
                    let last = LAST_REPORTS * weight;
                    (last * last_value + forecast.evidence * forecast.success) / (last + forecast.evidence)
                }
            };
            forecast.success = blended.clamp(LEARNED_SUCCESS_MIN, 1.0 - 1e-9);
        }
        forecast
    }

    fn predict(&self, id: StateId, times: &PreparedTimes) -> f64 {
        let mut predicted = [f64::NAN];
        self.view.predict_into(id, times, ModelSelector::default(), &mut predicted);
        predicted[0]
    }

    /// Number of reports of an edge.
    pub fn reports(&self, edge: EdgeId) -> u64 {
        let success = self.known.get(&edge).and_then(|known| known.states.success);
        success.map_or(0, |id| self.view.live(id).observations)
    }

    /// Number of reports of an edge that no update has learned yet.
    pub fn pending_reports(&self, edge: EdgeId) -> u64 {
        let success = self.known.get(&edge).and_then(|known| known.states.success);
        success.map_or(0, |id| self.view.pending_of(id))
    }
}

fn states_of(view: &MapView, topology: &Topology, edge: &Edge) -> EdgeStates {
    EdgeStates {
        success: success_state(topology, edge).ok().and_then(|name| view.find(name.as_str())),
        travel: travel_state(topology, edge).ok().and_then(|(_, name)| view.find(name.as_str())),
    }
}
