//! Forecasts of the edges of a map at any time, for routes and policies.
//!
//! Invariant: all forecasts are of one view. Success is predicted by the requested model, as a query of the edge's
//! state predicts it; speeds are predicted by the default model.

use std::{collections::HashMap, sync::Arc};

use tidemap_ingest::handle::MapHandle;
use tidemap_map::{
    edge_forecast::{EdgeForecast, EdgeForecasts},
    ids::StateId,
    predict::PreparedTimes,
    topology::{Edge, EdgeId, NodeId, Topology},
    view::MapView,
};
use tidemap_model::{models::FlowModel, selector::ModelSelector};
use tidemap_plan::{encounters::Encounters, route::Forecasts};
use tidemap_proto::convert::route::later;

use super::Routes;
use crate::{series::Predictor, status::RpcError};

/// The edges of a map, ready for forecasts.
pub(super) struct Edges {
    edges: EdgeForecasts,
    /// Index of each edge's success among the states of the predictor.
    indices: HashMap<StateId, usize>,
    predictor: Predictor,
}

impl Edges {
    /// # Errors
    /// The model cannot be trained.
    pub(super) async fn new(
        routes: &Routes,
        handle: &Arc<MapHandle>,
        view: &Arc<MapView>,
        selector: ModelSelector,
        speed_m_per_s: f64,
    ) -> Result<Edges, RpcError> {
        let forecast_view = Arc::clone(view);
        let edges = routes.run_blocking(move || EdgeForecasts::new(forecast_view, speed_m_per_s, selector)).await?;
        let states: Vec<StateId> = edges.success_states().collect();
        let indices = states.iter().enumerate().map(|(index, &id)| (id, index)).collect();
        let predictor = Predictor::new(routes.predict_context(), handle, view, states, selector).await?;
        Ok(Edges { edges, indices, predictor })
    }

    /// The forecast of an edge at a time in nanoseconds UTC.
    pub(super) fn forecast(&self, edge: &Edge, time_nanos: i64) -> EdgeForecast {
        let success = |id: StateId, times: &PreparedTimes| {
            self.indices.get(&id).map_or(f64::NAN, |&index| self.predictor.at_prepared(index, times))
        };
        self.edges.forecast_with(edge, time_nanos, success)
    }

    /// The number of reports of an edge.
    pub(super) fn reports(&self, edge: EdgeId) -> u64 {
        self.edges.reports(edge)
    }

    /// Number of reports of an edge that no update has learned yet.
    pub(super) fn pending_reports(&self, edge: EdgeId) -> u64 {
        self.edges.pending_reports(edge)
    }
}

/// The forecasts for a planner, in seconds after a reference time in nanoseconds UTC.
pub(super) struct ForecastsFrom<'a> {
    pub(super) edges: &'a Edges,
    pub(super) reference_nanos: i64,
    /// The people to avoid.
    pub(super) people: Option<PeopleAhead<'a>>,
}

/// Encounters with people on straight edges between nodes that have positions.
pub(super) struct PeopleAhead<'a> {
    encounters: Encounters<'a>,
    view: &'a MapView,
    topology: &'a Topology,
}

impl<'a> PeopleAhead<'a> {
    pub(super) fn new(flow: &'a FlowModel, near_m: f64, view: &'a MapView, topology: &'a Topology) -> Self {
        Self { encounters: Encounters::new(flow, near_m), view, topology }
    }

    fn on(&mut self, edge: &Edge, enter_nanos: i64, duration_secs: f64) -> f64 {
        let place = |node: NodeId| {
            let pose = self.topology.node(node).ok()?.pose?;
            Some([pose.x_m, pose.y_m])
        };
        let moment = self.view.moments(&[enter_nanos]).first().copied();
        match (place(edge.from), place(edge.to), moment) {
            (Some(from), Some(to), Some(enter)) => self.encounters.along(from, to, enter, duration_secs),
            _ => 0.0,
        }
    }
}

impl Forecasts for ForecastsFrom<'_> {
    fn at(&mut self, edge: &Edge, at_secs: f64) -> Option<EdgeForecast> {
        Some(self.edges.forecast(edge, later(self.reference_nanos, at_secs)))
    }

    fn encounters(&mut self, edge: &Edge, at_secs: f64, duration_secs: f64) -> f64 {
        let enter_nanos = later(self.reference_nanos, at_secs);
        self.people.as_mut().map_or(0.0, |people| people.on(edge, enter_nanos, duration_secs))
    }
}
