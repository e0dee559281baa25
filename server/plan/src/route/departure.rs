//! Plans routes for one departure, the best of several, or the latest that arrives in time.
//!
//! Invariant: each departure is a separate search; results of one prune the others only where they cannot be better.

use tidemap_map::topology::{NodeId, Topology};
use tidemap_model::models::Interval;

use super::{
    Certainty, Forecasts, PlanRouteError, Route, RouteOptions, RoutePlan, SearchWork, When,
    bounds::{Source, ToGo},
    cost::{Cost, Costing},
    error::check,
    forecast_cache::ForecastCache,
    labels::{EdgePath, Labels, Marks, Task},
    network::Network,
};

mod answer;
mod arrival;

/// Plans routes from one node to another. `until` is called at intervals; `true` ends the search with the best result
/// so far.
///
/// If both nodes are equal, the route has no steps and a success of 1. See [`Forecasts`] for `forecasts`.
///
/// # Errors
/// [`PlanRouteError`].
pub fn plan_routes(
    topology: &Topology,
    from: NodeId,
    to: NodeId,
    when: When,
    options: &RouteOptions,
    forecasts: &mut impl Forecasts,
    until: impl FnMut() -> bool,
) -> Result<RoutePlan, PlanRouteError> {
    plan_routes_with(&SearchWork::USUAL, topology, (from, to), when, options, forecasts, until)
}

/// Does the same as [`plan_routes`], with other search work.
pub(super) fn plan_routes_with(
    work: &SearchWork,
    topology: &Topology,
    (from, to): (NodeId, NodeId),
    when: When,
    options: &RouteOptions,
    forecasts: &mut impl Forecasts,
    until: impl FnMut() -> bool,
) -> Result<RoutePlan, PlanRouteError> {
    check(when, options)?;
    let network = Network::new(topology);
    let index = |node: NodeId| network.index_of(node).ok_or(PlanRouteError::UnknownNode(node.0));
    let (start, goal) = (index(from)?, index(to)?);
    if start == goal {
        let departure_secs = match when {
            When::DepartAt(secs)
            | When::DepartWithin { from_secs: secs, .. }
            | When::ArriveBy { by_secs: secs, .. } => secs,
        };
        return Ok(RoutePlan::standing(departure_secs));
    }
    Planner::new(&network, forecasts, until, (start, goal), options, work).plan(when)
}

impl RoutePlan {
    fn standing(departure_secs: f64) -> RoutePlan {
        let route = Route {
            steps: Vec::new(),
            departure_secs,
            arrival_secs: departure_secs,
            expected_secs: 0.0,
            encounters: 0.0,
            success: 1.0,
            success_interval: Interval { lower: 1.0, upper: 1.0 },
            cost: 0.0,
        };
        RoutePlan { routes: vec![route], certainty: Certainty::Proven, labels: 0, forecasts: 0 }
    }
}

/// If labels do not suffice, paths that arrive within this multiple of the resolution, or within this number of
/// seconds, count as arriving together.
const COARSE: f64 = 16.0;

/// A request, with its results so far.
pub(super) struct Planner<'a, F, U> {
    network: &'a Network<'a>,
    cache: ForecastCache<'a, F>,
    until: U,
    start: usize,
    goal: usize,
    options: &'a RouteOptions,
    work: &'a SearchWork,
    /// The attempt at a proof has failed, or was not requested: bounds are sampled.
    samples_bounds: bool,
    /// Known bounds for all departures of the request.
    known: Option<ToGo>,
    /// Sampled bounds of the previous departure, and the span of their samples: a heuristic.
    guide: Option<(ToGo, f64)>,
    marks: Marks,
    is_sampled: bool,
    /// A departure had a path, but the path arrived too late.
    is_late: bool,
    labels: usize,
}

/// The best path of a departure.
struct Departure {
    secs: f64,
    found: EdgePath,
    to_go: Option<ToGo>,
}

impl<'a, F: Forecasts, U: FnMut() -> bool> Planner<'a, F, U> {
    pub(super) fn new(
        network: &'a Network<'a>,
        forecasts: &'a mut F,
        until: U,
        (start, goal): (usize, usize),
        options: &'a RouteOptions,
        work: &'a SearchWork,
    ) -> Self {
        let &RouteOptions { objective, recovery_secs, failure_cost_secs, encounter_cost_secs, .. } = options;
        let costing = Costing { objective, recovery_secs, failure_cost_secs, encounter_cost_secs };
        let cache = ForecastCache::new(network, forecasts, costing, work.resolution_secs);
        Planner {
            network,
            cache,
            until,
            start,
            goal,
            options,
            work,
            samples_bounds: work.proof_labels == 0,
            known: None,
            guide: None,
            marks: Marks::default(),
            is_sampled: false,
            is_late: false,
            labels: 0,
        }
    }

    pub(super) fn plan(mut self, when: When) -> Result<RoutePlan, PlanRouteError> {
        let departure = match when {
            When::DepartAt(secs) => self.depart(secs, (secs, secs), Cost::INFINITE)?,
            When::DepartWithin { from_secs, to_secs, step_secs } => self.within(from_secs, to_secs, step_secs)?,
            When::ArriveBy { by_secs, earliest_secs } => self.arriving(by_secs, earliest_secs)?,
        };
        let Some(departure) = departure else { return Err(self.nothing(when)) };
        self.answer(departure)
    }

    fn nothing(&self, when: When) -> PlanRouteError {
        let (from, to) = (self.network.nodes[self.start].0, self.network.nodes[self.goal].0);
        let horizon_secs = self.options.horizon_secs;
        match when {
            _ if self.marks.cut_off || self.marks.stopped => PlanRouteError::CutOff { labels: self.labels },
            When::ArriveBy { by_secs, earliest_secs } if self.is_late => {
                PlanRouteError::TooLate { earliest_secs: earliest_secs.max(by_secs - horizon_secs), by_secs }
            }
            _ if self.marks.too_long => PlanRouteError::BeyondHorizon { from, to, horizon_secs },
            _ => PlanRouteError::Unreachable { from, to, closed: self.cache.closed() },
        }
    }

    /// The best path of a departure that costs less than `limit`; known bounds cover `departures`, first to last.
    fn depart(&mut self, secs: f64, departures: (f64, f64), limit: Cost) -> Result<Option<Departure>, PlanRouteError> {
        if !self.samples_bounds {
            let marks = self.marks;
            let found = self.depart_known(secs, departures, limit, self.work.proof_labels.min(self.work.labels_max))?;
            if !self.marks.cut_off || !self.may_sample() {
                return Ok(found);
            }
            self.marks = marks;
            self.samples_bounds = true;
        }
        self.depart_sampled(secs, limit)
    }

    /// Whether bounds are sampled if the labels for a proof do not suffice.
    fn may_sample(&self) -> bool {
        self.work.proof_labels < self.work.labels_max
    }

    fn depart_known(
        &mut self,
        secs: f64,
        departures: (f64, f64),
        limit: Cost,
        labels_max: usize,
    ) -> Result<Option<Departure>, PlanRouteError> {
        let to_go = match self.known.take() {
            Some(to_go) => to_go,
            None => {
                let span = (departures.0, departures.1 + self.options.horizon_secs);
                ToGo::find(self.network, &mut self.cache, self.goal, span, Source::Known, Cost::INFINITE)?
            }
        };
        let found = self.search(secs, &to_go, labels_max, |search, task| {
            let good = search.good(task, limit)?;
            search.best(task, good, limit)
        })?;
        self.known = Some(to_go);
        Ok(found.map(|found| Departure { secs, found, to_go: None }))
    }

    fn depart_sampled(&mut self, secs: f64, limit: Cost) -> Result<Option<Departure>, PlanRouteError> {
        self.marks.latest_secs = secs;
        let (guide, span_before_secs) = match self.guide.take() {
            Some((to_go, span_secs)) => (to_go, Some(span_secs)),
            None => (ToGo::nothing(self.network), None),
        };
        let good = self.search(secs, &guide, usize::MAX, |search, task| search.good(task, limit))?;
        let span_secs = match (&good, span_before_secs) {
            (Some(good), _) => 2.0 * (self.walk(secs, &good.edges)?.1 - secs),
            (None, Some(span_secs)) => span_secs,
            (None, None) => 2.0 * (self.marks.latest_secs - secs),
        };
        let span_secs = span_secs.min(self.options.horizon_secs);
        let worst = good.as_ref().map_or(limit, |good| good.cost);
        // Alternatives cost more than the best.
        let bounds_limit = if self.options.alternatives > 0 { Cost::INFINITE } else { worst };
        let samples = self.work.samples;
        let (source, span) = (Source::Sampled(samples), (secs, secs + span_secs));
        let mut to_go = ToGo::find(self.network, &mut self.cache, self.goal, span, source, bounds_limit)?;
        self.is_sampled = true;
        self.guide = Some((to_go.clone(), span_secs));
        let (labels_max, cut_off) = (self.work.labels_max, self.marks.cut_off);
        self.marks.cut_off = false;
        let few = labels_max.div_ceil(4);
        let mut found = self.search(secs, &to_go, few, |search, task| search.best(task, good, limit))?;
        if self.marks.cut_off {
            self.marks.cut_off = false;
            if let Some(EdgePath { edges, cost }) = &found {
                let (source, span) = (Source::About { samples, cost: *cost }, (secs, self.walk(secs, edges)?.1));
                to_go = ToGo::find(self.network, &mut self.cache, self.goal, span, source, bounds_limit)?;
            }
            found = self.search(secs, &to_go, labels_max, |search, task| search.best(task, found, limit))?;
        }
        if self.marks.cut_off {
            let join_secs = COARSE * self.work.resolution_secs.max(1.0);
            found = self.search(secs, &to_go, labels_max, |search, task| {
                search.best(&Task { join_secs, ..*task }, found, limit)
            })?;
        }
        self.marks.cut_off |= cut_off;
        Ok(found.map(|found| Departure { secs, found, to_go: Some(to_go) }))
    }

    /// Searches from the start at a time.
    fn search<T>(
        &mut self,
        secs: f64,
        to_go: &ToGo,
        mut labels_left: usize,
        find: impl FnOnce(&mut Labels<'a, '_, F, U>, &Task) -> Result<T, PlanRouteError>,
    ) -> Result<T, PlanRouteError> {
        let is_passed = vec![false; self.network.nodes.len()];
        let task = Task {
            before: &[],
            node: self.start,
            at_secs: secs,
            cost: Cost::ZERO,
            is_passed: &is_passed,
            closed_first: &[],
            goal: self.goal,
            latest_secs: secs + self.options.horizon_secs,
            join_secs: 0.0,
        };
        let counts = (&mut labels_left, &mut self.labels);
        let mut search = Labels::new(self.network, &mut self.cache, to_go, &mut self.until, counts, &mut self.marks);
        find(&mut search, &task)
    }

    fn within(&mut self, from_secs: f64, to_secs: f64, step_secs: f64) -> Result<Option<Departure>, PlanRouteError> {
        let mut best: Option<Departure> = None;
        let steps = ((to_secs - from_secs) / step_secs).floor() as usize;
        for step in 0..=steps {
            let limit = best.as_ref().map_or(Cost::INFINITE, |best| best.found.cost);
            let found = self.depart(from_secs + step as f64 * step_secs, (from_secs, to_secs), limit)?;
            if let Some(found) = found.filter(|found| found.found.cost < limit) {
                best = Some(found);
            }
            if step < steps && (self.until)() {
                self.marks.stopped = true;
                break;
            }
        }
        Ok(best)
    }
}
