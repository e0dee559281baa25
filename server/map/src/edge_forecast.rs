//! The forecast of an edge of the topological map: its success probability, the evidence for it, and its duration.
//!
//! The success probability is the forecast of the state `edge/A/B[/ACTION]`, to the last bit: planners and queries of
//! the state get the same answer (see [`crate::edge_prior`] for edges with few reports). The duration follows from the
//! forecast of the edge's speed or pace, and from the means over the edges of the map as long as reports are few.
//!
//! Invariant: a success lies in `[LEARNED_SUCCESS_MIN, 1)`, evidence is at least 2, a duration is above 0 and finite.
//! All data comes from one view.

use std::{
    collections::HashMap,
    sync::{Arc, OnceLock},
};

use tidemap_model::selector::ModelSelector;

use crate::{
    edge_prior::{EVIDENCE_MIN, LEARNED_SUCCESS_MIN},
    ids::StateId,
    predict::PreparedTimes,
    topology::{Edge, EdgeId, Extent, NOMINAL_MAX_SECS, Topology},
    traversal::{success_state, travel_state},
    view::MapView,
};

#[cfg(test)]
mod tests;

/// Weight, in reports, of the means over the edges of the map as the prior of an edge's speed or pace.
const PRIOR_REPORTS: f64 = 2.0;
/// Maximum ratio between the speed of an edge and the usual speed, both ways.
const SPEED_RATIO_MAX: f64 = 20.0;

/// The forecast of an edge at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeForecast {
    /// Probability that an attempt succeeds.
    pub success: f64,
    /// Number of half-hour bins of reports that `success` is worth, at least 2: the probability is believed to follow
    /// Beta(success · evidence, (1 - success) · evidence).
    pub evidence: f64,
    /// Duration of a successful attempt, in seconds, above 0, at most [`NOMINAL_MAX_SECS`].
    pub duration_secs: f64,
}

/// The states that learn from traversals of an edge; none before its first report.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct EdgeStates {
    /// State of whether the edge was passed.
    success: Option<StateId>,
    /// State of the speed in metres per second for an edge with a length, otherwise of nominal time over time taken.
    travel: Option<StateId>,
}

/// Mean speeds over the edges of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TravelPrior {
    /// Speed, metres per second.
    speed_m_per_s: f64,
    /// Pace, nominal seconds per second.
    pace: f64,
}

impl TravelPrior {
    /// Means over all reports that updates have learned. `speed_m_per_s`: the speed without reports, above 0.
    fn new<'a>(
        view: &MapView,
        edges: impl IntoIterator<Item = &'a (Extent, EdgeStates)>,
        speed_m_per_s: f64,
    ) -> TravelPrior {
        let mut speed = [speed_m_per_s * PRIOR_REPORTS, PRIOR_REPORTS];
        let mut pace = [PRIOR_REPORTS, PRIOR_REPORTS];
        for (extent, states) in edges {
            let Some(id) = states.travel else { continue };
            let learned = view.model(id).accumulator();
            if learned.observations() > 0 {
                let sums = if extent.length_m.is_some() { &mut speed } else { &mut pace };
                *sums = [sums[0] + learned.mean() * learned.weight(), sums[1] + learned.weight()];
            }
        }
        let mean = |[sum, weight]: [f64; 2]| sum / weight;
        let above = |value: f64, otherwise: f64| if value > 0.0 && value.is_finite() { value } else { otherwise };
        TravelPrior { speed_m_per_s: above(mean(speed), speed_m_per_s), pace: above(mean(pace), 1.0) }
    }

    /// Duration of an edge of this extent, in seconds. `speed` turns the usual speed, or the usual pace, into that of
    /// the edge.
    fn duration_secs(&self, extent: Extent, speed: impl Fn(f64) -> f64) -> f64 {
        let (distance, usual) = match (extent.length_m, extent.nominal_secs) {
            // A nominal time is better evidence than the speed of other edges.
            (Some(length_m), Some(secs)) => (length_m, length_m / secs * self.pace),
            (Some(length_m), None) => (length_m, self.speed_m_per_s),
            (None, secs) => (secs.unwrap_or(1.0), self.pace),
        };
        let speed = speed(usual).clamp(usual / SPEED_RATIO_MAX, usual * SPEED_RATIO_MAX);
        (distance / speed).clamp(1e-9, NOMINAL_MAX_SECS)
    }
}

/// The forecasts of all edges of a map, at any time.
#[derive(Debug)]
pub struct EdgeForecasts {
    view: Arc<MapView>,
    selector: ModelSelector,
    speed_m_per_s: f64,
    prior: OnceLock<TravelPrior>,
    /// The edges with reports.
    known: HashMap<EdgeId, (Extent, EdgeStates)>,
}

impl EdgeForecasts {
    /// The edges of a view. `speed_m_per_s`: the speed without reports, above 0. `selector`: the model that predicts
    /// success; speeds are predicted by the default model.
    pub fn new(view: Arc<MapView>, speed_m_per_s: f64, selector: ModelSelector) -> EdgeForecasts {
        let topology = view.site().topology();
        let known = topology
            .edges()
            .map(|edge| (edge.id, (edge.extent, states_of(&view, topology, edge))))
            .filter(|(_, (_, states))| *states != EdgeStates::default())
            .collect();
        EdgeForecasts { view, selector, speed_m_per_s, prior: OnceLock::new(), known }
    }

    /// The success states of all edges, in no order.
    pub fn success_states(&self) -> impl Iterator<Item = StateId> {
        self.known.values().filter_map(|(_, states)| states.success)
    }

    /// The forecast of an edge at a time in nanoseconds UTC.
    pub fn forecast(&self, edge: &Edge, time_nanos: i64) -> EdgeForecast {
        self.forecast_with(edge, time_nanos, |id, times| self.predict(id, times, self.selector))
    }

    /// The forecast of an edge with a success model of the caller: `success` predicts the success state at the single
    /// time given.
    pub fn forecast_with(
        &self,
        edge: &Edge,
        time_nanos: i64,
        success: impl FnOnce(StateId, &PreparedTimes) -> f64,
    ) -> EdgeForecast {
        let states = self.known.get(&edge.id).map_or_else(EdgeStates::default, |(_, states)| *states);
        let times = self.view.prepare(&[time_nanos]);
        let (success, evidence) = match states.success {
            Some(id) => (success(id, &times), self.view.edge_evidence(Some(id), times.moments())),
            None => (self.view.edge_success(), self.view.edge_evidence(None, times.moments())),
        };
        let (travelled, travel) = states.travel.map_or((0.0, f64::NAN), |id| {
            (self.view.model(id).accumulator().weight(), self.predict(id, &times, ModelSelector::default()))
        });
        let drawn = |usual: f64| {
            let own = if travel.is_finite() { travel } else { usual };
            (travelled * own + PRIOR_REPORTS * usual) / (travelled + PRIOR_REPORTS)
        };
        let prior = self.prior.get_or_init(|| TravelPrior::new(&self.view, self.known.values(), self.speed_m_per_s));
        let success = if success.is_finite() { success } else { self.view.edge_success() };
        let forecast = EdgeForecast {
            success: success.clamp(LEARNED_SUCCESS_MIN, 1.0 - 1e-9),
            evidence: evidence.first().copied().unwrap_or_default().max(EVIDENCE_MIN),
            duration_secs: prior.duration_secs(edge.extent, drawn),
        };
        debug_assert!(forecast.evidence > 0.0, "{forecast:?}");
        debug_assert!(forecast.duration_secs > 0.0 && forecast.duration_secs.is_finite(), "{forecast:?}");
        forecast
    }

    fn predict(&self, id: StateId, times: &PreparedTimes, selector: ModelSelector) -> f64 {
        let mut predicted = [f64::NAN];
        self.view.predict_into(id, times, selector, &mut predicted);
        predicted[0]
    }

    /// Number of reports of an edge.
    pub fn reports(&self, edge: EdgeId) -> u64 {
        self.success_of(edge).map_or(0, |id| self.view.live(id).observations)
    }

    /// Number of reports of an edge that no update has learned yet.
    pub fn pending_reports(&self, edge: EdgeId) -> u64 {
        self.success_of(edge).map_or(0, |id| self.view.pending_of(id))
    }

    fn success_of(&self, edge: EdgeId) -> Option<StateId> {
        self.known.get(&edge)?.1.success
    }
}

fn states_of(view: &MapView, topology: &Topology, edge: &Edge) -> EdgeStates {
    EdgeStates {
        success: success_state(topology, edge).ok().and_then(|name| view.find(name.as_str())),
        travel: travel_state(topology, edge).ok().and_then(|(_, name)| view.find(name.as_str())),
    }
}
