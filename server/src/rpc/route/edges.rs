//! What is to be expected of the edges of a map at any time, for routes, policies and whoever asks.
//!
//! Invariant: all of it is of one view. Success is predicted by the model that was asked for, speeds by the one that the last
//! update chose.

use std::{collections::HashMap, sync::Arc};

use tidemap_map::{
    outlook::{EdgeRecord, EdgeStates, LEAST_SUCCESS, Outlook, UsualEdge},
    predict::ModelSelector,
    topology::{Edge, EdgeId, Topology},
    traversal::{success_state, travel_state},
    view::MapView,
};
use tidemap_plan::route::{EdgeForecast, Forecasts};

use super::Routes;
use crate::{
    ingest::handle::MapHandle,
    rpc::{series::Predictor, status::RpcError},
};

/// An edge of which something was reported.
struct Known {
    record: EdgeRecord,
    /// Place of its success among the states of the predictor.
    success: Option<usize>,
    states: EdgeStates,
}

/// The edges of a map, ready to be asked for any time.
pub(super) struct Edges {
    view: Arc<MapView>,
    usual: UsualEdge,
    known: HashMap<EdgeId, Known>,
    predictor: Predictor,
    /// Whether the last report counts, for as long as it does.
    persistence: bool,
}

impl Edges {
    /// # Errors
    /// The model cannot be fitted.
    pub(super) async fn new(
        routes: &Routes,
        handle: &Arc<MapHandle>,
        view: &Arc<MapView>,
        selector: ModelSelector,
        speed_m_per_sec: f64,
    ) -> Result<Edges, RpcError> {
        let of = Arc::clone(view);
        let (usual, known) = routes.off_threads(move || known_edges(&of, speed_m_per_sec)).await?;
        let mut known: HashMap<EdgeId, Known> = known.into_iter().collect();
        let mut states = Vec::with_capacity(known.len());
        for known in known.values_mut() {
            known.success = known.states.success.map(|id| {
                states.push(id);
                states.len() - 1
            });
        }
        let alone = ModelSelector { persistence: false, ..selector };
        let predictor = Predictor::new(routes.means(), handle, view, states, alone).await?;
        Ok(Edges { view: Arc::clone(view), usual, known, predictor, persistence: selector.persistence })
    }

    /// What is to be expected of an edge at a time in nanoseconds UTC.
    pub(super) fn outlook(&self, edge: &Edge, time_nanos: i64) -> Outlook {
        let times = self.view.prepare(&[time_nanos]);
        let Some(&at) = times.moments().first() else { return self.unknown(edge, time_nanos) };
        let Some(known) = self.known.get(&edge.id) else { return self.unknown(edge, time_nanos) };
        let success = known.success.map_or(f64::NAN, |index| self.predictor.at_prepared(index, &times));
        let mut travel = [f64::NAN];
        if let Some(id) = known.states.travel {
            self.view.predict_into(id, &times, ModelSelector::default(), &mut travel);
        }
        let mut outlook = known.record.outlook(&self.usual, success, travel[0], at);
        if let Some(id) = known.states.success.filter(|_| self.persistence) {
            let blended = self.view.live(id).persistence.blend(outlook.success, time_nanos);
            outlook.success = blended.clamp(LEAST_SUCCESS, 1.0 - 1e-9);
        }
        outlook
    }

    fn unknown(&self, edge: &Edge, time_nanos: i64) -> Outlook {
        let record = EdgeRecord::of(&self.view, edge.extent, EdgeStates::default());
        let at = self.view.moments(&[time_nanos]);
        record.outlook(&self.usual, f64::NAN, f64::NAN, at[0])
    }

    /// How often an edge was reported.
    pub(super) fn reports(&self, edge: EdgeId) -> u64 {
        let success = self.known.get(&edge).and_then(|known| known.states.success);
        success.map_or(0, |id| self.view.live(id).observations)
    }
}

/// What the edges of the map have in common, and what is known of each of which anything was reported.
fn known_edges(view: &MapView, speed_m_per_sec: f64) -> (UsualEdge, Vec<(EdgeId, Known)>) {
    let topology = view.site().topology();
    let states = |edge: &Edge| states_of(view, topology, edge);
    let reported: Vec<(&Edge, EdgeStates)> = topology
        .edges()
        .map(|edge| (edge, states(edge)))
        .filter(|(_, states)| *states != EdgeStates::default())
        .collect();
    let usual = UsualEdge::of(view, reported.iter().map(|(edge, states)| (edge.extent, *states)), speed_m_per_sec);
    let known = reported.into_iter().map(|(edge, states)| {
        (edge.id, Known { record: EdgeRecord::of(view, edge.extent, states), success: None, states })
    });
    (usual, known.collect())
}

fn states_of(view: &MapView, topology: &Topology, edge: &Edge) -> EdgeStates {
    EdgeStates {
        success: success_state(topology, edge).ok().and_then(|name| view.find(name.as_str())),
        travel: travel_state(topology, edge).ok().and_then(|(_, name)| view.find(name.as_str())),
    }
}

/// Edges as a plan asks for them, in seconds after a reference time in nanoseconds UTC.
pub(super) struct Ahead<'a> {
    pub(super) edges: &'a Edges,
    pub(super) reference_nanos: i64,
}

impl Forecasts for Ahead<'_> {
    fn at(&mut self, edge: &Edge, at_secs: f64) -> Option<EdgeForecast> {
        let Outlook { success, evidence, duration_secs } =
            self.edges.outlook(edge, later(self.reference_nanos, at_secs));
        Some(EdgeForecast { success, duration_secs, evidence })
    }
}

/// A time so many seconds after another, in nanoseconds UTC.
pub(super) fn later(reference_nanos: i64, secs: f64) -> i64 {
    reference_nanos.saturating_add((secs * 1e9).round() as i64)
}
