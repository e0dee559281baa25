//! Turns found paths into reported routes.
//!
//! Invariant: all numbers are of the forecasts that the search has used.

use tidemap_map::topology::Edge;

use super::{Departure, Planner};
use crate::route::{
    Certainty, Forecasts, PlanRouteError, Route, RoutePlan, RouteStep,
    alternatives::next_best,
    bounds::ToGo,
    chance::Chance,
    cost::Cost,
    labels::{EdgePath, Marks},
};

impl<'a, F: Forecasts, U: FnMut() -> bool> Planner<'a, F, U> {
    /// The steps of a path, and its arrival.
    pub(super) fn walk(
        &mut self,
        departure_secs: f64,
        edges: &[usize],
    ) -> Result<(Vec<RouteLeg<'a>>, f64), PlanRouteError> {
        let mut at_secs = departure_secs;
        let mut steps = Vec::with_capacity(edges.len());
        for &edge in edges {
            // The edge was open in the search.
            let Some(traversal) = self.cache.at(edge, at_secs)? else { continue };
            steps.push(RouteLeg {
                edge: self.network.edges[edge],
                start_secs: at_secs,
                duration_secs: traversal.duration_secs,
                expected_secs: traversal.expected_secs,
                encounters: traversal.encounters,
                success: traversal.success,
                chance: Chance::new(traversal.success, traversal.evidence),
            });
            at_secs += traversal.duration_secs;
        }
        Ok((steps, at_secs))
    }

    fn route(&mut self, departure_secs: f64, found: &EdgePath) -> Result<Route, PlanRouteError> {
        let (walked, arrival_secs) = self.walk(departure_secs, &found.edges)?;
        let confidence = self.options.confidence;
        let chance = walked.iter().fold(Chance::CERTAIN, |all, step| all.and(step.chance));
        Ok(Route {
            departure_secs,
            arrival_secs,
            expected_secs: walked.iter().map(|step| step.expected_secs).sum(),
            encounters: walked.iter().map(|step| step.encounters).sum(),
            success: walked.iter().map(|step| step.success).product(),
            success_interval: chance.interval(confidence),
            cost: self.cache.costing.reported(found.cost),
            steps: walked.into_iter().map(|leg| leg.step(confidence)).collect(),
        })
    }

    /// The best path of a departure with its alternatives. Falls back to sampling if the labels for a proof run out.
    fn alternatives(&mut self, departure: Departure) -> Result<Vec<EdgePath>, PlanRouteError> {
        let Departure { secs, found, to_go } = departure;
        let to_go = to_go.or(self.known.take()).unwrap_or_else(|| ToGo::nothing(self.network));
        let (ends, span) = ((self.start, self.goal), (secs, secs + self.options.horizon_secs));
        let (count, labels_max) = (self.options.alternatives, self.work.labels_max);
        let is_try = !self.samples_bounds && self.may_sample() && !self.marks.cut_off;
        let max_labels = if is_try { self.work.proof_labels } else { labels_max };
        let marks = self.marks;
        let again = found.clone();
        let all = self.search(secs, &to_go, max_labels, |search, _| next_best(search, found, ends, span, count))?;
        if !is_try || !self.marks.cut_off {
            return Ok(all);
        }
        self.marks = marks;
        self.samples_bounds = true;
        let sampled = self.depart_sampled(secs, Cost::INFINITE)?;
        let to_go = sampled.and_then(|sampled| sampled.to_go).unwrap_or(to_go);
        self.search(secs, &to_go, labels_max, |search, _| next_best(search, again, ends, span, count))
    }

    pub(super) fn answer(&mut self, departure: Departure) -> Result<RoutePlan, PlanRouteError> {
        let (secs, count) = (departure.secs, self.options.alternatives);
        let mut all = vec![departure.found.clone()];
        if count > 0 {
            all = self.alternatives(departure)?;
        }
        let routes = all.iter().map(|found| self.route(secs, found)).collect::<Result<_, _>>()?;
        let Marks { joined, cut_off, stopped, .. } = self.marks;
        let certainty = [
            (cut_off || stopped, Certainty::CutOff),
            (self.is_sampled, Certainty::Sampled),
            (joined, Certainty::WithinResolution),
            (true, Certainty::Proven),
        ];
        let certainty = certainty.into_iter().find(|found| found.0).map_or(Certainty::Proven, |found| found.1);
        Ok(RoutePlan { routes, certainty, labels: self.labels, forecasts: self.cache.requests })
    }
}

/// One edge of a path with its forecast.
pub(super) struct RouteLeg<'a> {
    edge: &'a Edge,
    start_secs: f64,
    duration_secs: f64,
    pub expected_secs: f64,
    encounters: f64,
    success: f64,
    chance: Chance,
}

impl RouteLeg<'_> {
    fn step(&self, confidence: f64) -> RouteStep {
        RouteStep {
            edge: self.edge.id,
            from: self.edge.from,
            to: self.edge.to,
            start_secs: self.start_secs,
            duration_secs: self.duration_secs,
            encounters: self.encounters,
            success: self.success,
            success_interval: self.chance.interval(confidence),
        }
    }
}
