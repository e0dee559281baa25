//! The edges of a map as the prior of each of them.
//!
//! Few reports are learned of an edge, most of them at hours at which robots used it. So the forecast of its success is
//! drawn to the mean over all edges of the map, as far as half-hour bins at that hour of the day are few. It never
//! reaches 0: a robot would never retry an edge that counts as impassable (STRANDS, IEEE RAM 2017, "Adaptive
//! Topological Navigation").
//!
//! Invariant: a success that is drawn to the mean lies strictly between 0 and 1, its evidence is above 0, and both
//! depend on what updates have learned alone.

use tidemap_model::models::Moment;

use crate::{ids::StateId, traversal::success_state, view::MapView};

/// Lowest success probability of an edge.
pub(crate) const LEARNED_SUCCESS_MIN: f64 = 0.001;
/// Success probability of an edge in a map without reports, and its weight in reports.
const SUCCESS_PRIOR: (f64, f64) = (0.9, 10.0);
/// Weight of the mean over all edges, in half-hour bins.
const MEAN_BINS: f64 = 0.3;
/// The evidence of the mean over all edges for the success of a single edge, in half-hour bins.
pub(crate) const EVIDENCE_MIN: f64 = 2.0;
/// Maximum weight of the reports at other hours of the day, in half-hour bins, and the number of reports with half of
/// it.
const OTHER_HOURS_BINS: f64 = 0.5;
const OTHER_HOURS_HALF: f64 = 4.0;

impl MapView {
    /// The mean success over all reports of edges that updates have learned.
    pub(crate) fn edge_success(&self) -> f64 {
        *self.edge_success.get_or_init(|| {
            let topology = self.site().topology();
            let (chance, weight) = SUCCESS_PRIOR;
            let states = topology.edges().filter_map(|edge| self.find(success_state(topology, edge).ok()?.as_str()));
            let add = |[sum, weight]: [f64; 2], id: StateId| {
                let learned = self.model(id).accumulator();
                // A state that learned nothing has no mean.
                match learned.observations() {
                    0 => [sum, weight],
                    _ => [sum + learned.mean() * learned.weight(), weight + learned.weight()],
                }
            };
            let [sum, weight] = states.fold([chance * weight, weight], add);
            (sum / weight).clamp(LEARNED_SUCCESS_MIN, 1.0 - f64::EPSILON)
        })
    }

    /// The number of half-hour bins that a forecast of an edge's success is worth at each moment, the mean over all
    /// edges included. `id`: the edge's success state; `None` before its first report.
    pub(crate) fn edge_evidence(&self, id: Option<StateId>, moments: &[Moment]) -> Vec<f64> {
        let Some(id) = id else { return vec![MEAN_BINS; moments.len()] };
        let model = self.model(id);
        let reports = model.accumulator().weight();
        let others = MEAN_BINS + OTHER_HOURS_BINS * reports / (reports + OTHER_HOURS_HALF);
        match model.predictive_around(moments, &vec![0.5; moments.len()]) {
            Some(around) => around.iter().map(|at| at.bins() + others).collect(),
            // A map without ensembles counts reports.
            None => vec![reports + others; moments.len()],
        }
    }

    /// Draws forecasts of the success of an edge to the mean over all edges; does nothing to another state.
    pub(crate) fn draw_to_edges(&self, id: StateId, moments: &[Moment], out: &mut [f64]) {
        if !self.info(id).is_some_and(|info| info.name.is_edge_success()) {
            return;
        }
        let mean = self.edge_success();
        for (success, evidence) in out.iter_mut().zip(self.edge_evidence(Some(id), moments)) {
            *success += MEAN_BINS / evidence * (mean - *success);
        }
    }
}
