//! Departures: at a time, the best of several, or the latest that arrives in time.
//!
//! Invariant: each departure is a search of its own; what one has found limits the others only in what cannot be better.

use tidemap_map::topology::Edge;

use super::{
    Bounds, Certainty, DEPARTURES_MAX, Forecasts, Route, RouteError, RouteOptions, RouteStep, Routes, When,
    alternatives::next_best,
    beta::Chance,
    bounds::{Source, ToGo},
    cost::{Cost, Costing},
    labels::{Found, Labels, Marks, Task},
    network::Network,
    outlook::Outlook,
};

/// Labels of the first try of [`Bounds::Auto`], for one departure.
const AUTO_LABELS: usize = 5_000;
/// Times of its second.
const AUTO_SAMPLES: u32 = 4;
/// To which a departure for an arrival is found, in seconds.
const ARRIVAL_STEP_MIN_SECS: f64 = 0.1;

/// A question, with what is known of it so far.
pub(super) struct Planner<'a, F, U> {
    network: &'a Network<'a>,
    outlook: Outlook<'a, F>,
    until: U,
    start: usize,
    goal: usize,
    options: &'a RouteOptions,
    /// What [`Bounds::Auto`] has come to.
    bounds: Bounds,
    /// Known bounds for all departures of the question.
    known: Option<ToGo>,
    marks: Marks,
    is_sampled: bool,
    labels: usize,
}

/// The best way of a departure.
struct Departure {
    secs: f64,
    found: Found,
    to_go: Option<ToGo>,
}

impl<'a, F: Forecasts, U: FnMut() -> bool> Planner<'a, F, U> {
    pub fn new(
        network: &'a Network<'a>,
        forecasts: &'a mut F,
        until: U,
        start: usize,
        goal: usize,
        options: &'a RouteOptions,
    ) -> Self {
        let &RouteOptions { objective, recovery_secs, failure_cost_secs, .. } = options;
        let costing = Costing { objective, recovery_secs, failure_cost_secs };
        let outlook = Outlook::new(network, forecasts, costing, options.resolution_secs);
        let (bounds, marks) = (options.bounds, Marks::default());
        Planner {
            network,
            outlook,
            until,
            start,
            goal,
            options,
            bounds,
            known: None,
            marks,
            is_sampled: false,
            labels: 0,
        }
    }

    pub fn plan(mut self, when: When) -> Result<Routes, RouteError> {
        let departure = match when {
            When::DepartAt(secs) => self.depart(secs, (secs, secs), Cost::INFINITE)?,
            When::DepartWithin { from_secs, to_secs, step_secs } => self.within(from_secs, to_secs, step_secs)?,
            When::ArriveBy { by_secs, earliest_secs } => self.arriving(by_secs, earliest_secs)?,
        };
        let Some(departure) = departure else { return Err(self.nothing(when)) };
        self.answer(departure)
    }

    fn nothing(&self, when: When) -> RouteError {
        let (from, to) = (self.network.nodes[self.start].0, self.network.nodes[self.goal].0);
        let horizon_secs = self.options.horizon_secs;
        match when {
            _ if self.marks.cut_off || self.marks.stopped => RouteError::CutOff { labels: self.labels },
            When::ArriveBy { by_secs, earliest_secs } if self.known_way() => {
                RouteError::TooLate { earliest_secs: earliest_secs.max(by_secs - horizon_secs), by_secs }
            }
            _ if self.marks.too_long => RouteError::BeyondHorizon { from, to, horizon_secs },
            _ => RouteError::Unreachable { from, to, closed: self.outlook.closed() },
        }
    }

    /// Whether edges lead from the start to the goal at all.
    fn known_way(&self) -> bool {
        let mut is_seen = vec![false; self.network.nodes.len()];
        let mut open = vec![self.start];
        while let Some(node) = open.pop() {
            if !std::mem::replace(&mut is_seen[node], true) {
                open.extend(self.network.leaving(node).map(|edge| self.network.to(edge)));
            }
        }
        is_seen[self.goal]
    }

    /// The best way at a departure that costs less than `limit`; known bounds are taken over `departures`, first and last.
    fn depart(&mut self, secs: f64, departures: (f64, f64), limit: Cost) -> Result<Option<Departure>, RouteError> {
        let options = self.options;
        match self.bounds {
            Bounds::Known => self.depart_known(secs, departures, limit, options.labels_max),
            Bounds::Sampled(samples) => self.depart_sampled(secs, limit, samples),
            Bounds::Auto => {
                let marks = self.marks;
                let found = self.depart_known(secs, departures, limit, AUTO_LABELS.min(options.labels_max))?;
                if !self.marks.cut_off {
                    return Ok(found);
                }
                self.marks = marks;
                self.bounds = Bounds::Sampled(AUTO_SAMPLES);
                self.depart_sampled(secs, limit, AUTO_SAMPLES)
            }
        }
    }

    fn depart_known(
        &mut self,
        secs: f64,
        departures: (f64, f64),
        limit: Cost,
        labels_max: usize,
    ) -> Result<Option<Departure>, RouteError> {
        let to_go = match self.known.take() {
            Some(to_go) => to_go,
            None => {
                let span = (departures.0, departures.1 + self.options.horizon_secs);
                ToGo::find(self.network, &mut self.outlook, self.goal, span, Source::Known, Cost::INFINITE)?
            }
        };
        let found = self.search(secs, &to_go, labels_max, |search, task| {
            let good = search.good(task, limit)?;
            search.best(task, good, limit)
        })?;
        self.known = Some(to_go);
        Ok(found.map(|found| Departure { secs, found, to_go: None }))
    }

    fn depart_sampled(&mut self, secs: f64, limit: Cost, samples: u32) -> Result<Option<Departure>, RouteError> {
        let nothing = ToGo::nothing(self.network);
        self.marks.latest_secs = secs;
        let good = self.search(secs, &nothing, usize::MAX, |search, task| search.good(task, limit))?;
        let end_secs = match &good {
            Some(good) => self.walk(secs, &good.edges)?.1,
            None => self.marks.latest_secs.max(secs),
        };
        let span_secs = (2.0 * (end_secs - secs)).min(self.options.horizon_secs);
        let worst = good.as_ref().map_or(limit, |good| good.cost);
        // Alternatives cost more than the best.
        let bounds_limit = if self.options.alternatives > 0 { Cost::INFINITE } else { worst };
        let (source, span) = (Source::Sampled(samples), (secs, secs + span_secs));
        let to_go = ToGo::find(self.network, &mut self.outlook, self.goal, span, source, bounds_limit)?;
        self.is_sampled = true;
        let found =
            self.search(secs, &to_go, self.options.labels_max, |search, task| search.best(task, good, limit))?;
        Ok(found.map(|found| Departure { secs, found, to_go: Some(to_go) }))
    }

    /// Searches from the start at a time.
    fn search<T>(
        &mut self,
        secs: f64,
        to_go: &ToGo,
        mut labels_left: usize,
        find: impl FnOnce(&mut Labels<'a, '_, F, U>, &Task) -> Result<T, RouteError>,
    ) -> Result<T, RouteError> {
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
        };
        let counts = (&mut labels_left, &mut self.labels);
        let mut search = Labels::new(self.network, &mut self.outlook, to_go, &mut self.until, counts, &mut self.marks);
        find(&mut search, &task)
    }

    fn within(&mut self, from_secs: f64, to_secs: f64, step_secs: f64) -> Result<Option<Departure>, RouteError> {
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

    /// The last departure that is expected to arrive in time, of steps backwards, and then onwards from it: who leaves at D and
    /// takes E may as well try T - E, and what lies halfway where that is too late.
    fn arriving(&mut self, by_secs: f64, earliest_secs: f64) -> Result<Option<Departure>, RouteError> {
        let first_secs = earliest_secs.max(by_secs - self.options.horizon_secs);
        if first_secs > by_secs {
            return Ok(None);
        }
        let step_secs = self.options.arrival_step_secs.max((by_secs - first_secs) / (DEPARTURES_MAX - 1) as f64);
        let departures = (first_secs, by_secs);
        let mut later_secs = by_secs;
        let mut in_time = None;
        for step in 1..=DEPARTURES_MAX {
            let secs = (by_secs - step as f64 * step_secs).max(first_secs);
            in_time = self.arrives(secs, departures, by_secs)?;
            if in_time.is_some() || secs <= first_secs {
                break;
            }
            if (self.until)() {
                self.marks.stopped = true;
                break;
            }
            later_secs = secs;
        }
        let Some((mut best, mut spare_secs)) = in_time else { return Ok(None) };
        while spare_secs > ARRIVAL_STEP_MIN_SECS && later_secs - best.secs > ARRIVAL_STEP_MIN_SECS {
            let next = best.secs + spare_secs;
            let next = if next < later_secs { next } else { 0.5 * (best.secs + later_secs) };
            match self.arrives(next, departures, by_secs)? {
                Some(found) => (best, spare_secs) = found,
                None => {
                    later_secs = next;
                    spare_secs = 0.5 * (next - best.secs);
                }
            }
        }
        Ok(Some(best))
    }

    /// The best way of a departure with the time that it leaves to spare, if it is expected to arrive in time.
    fn arrives(
        &mut self,
        secs: f64,
        departures: (f64, f64),
        by_secs: f64,
    ) -> Result<Option<(Departure, f64)>, RouteError> {
        let Some(departure) = self.depart(secs, departures, Cost::INFINITE)? else { return Ok(None) };
        let (steps, _) = self.walk(secs, &departure.found.edges)?;
        let spare_secs = by_secs - secs - steps.iter().map(|step| step.expected_secs).sum::<f64>();
        Ok((spare_secs >= 0.0).then_some((departure, spare_secs)))
    }

    /// The steps of a way, and when it ends.
    fn walk(&mut self, departure_secs: f64, edges: &[usize]) -> Result<(Vec<Walked<'a>>, f64), RouteError> {
        let mut at_secs = departure_secs;
        let mut steps = Vec::with_capacity(edges.len());
        for &edge in edges {
            // It was open to the search.
            let Some(traversal) = self.outlook.at(edge, at_secs)? else { continue };
            steps.push(Walked {
                edge: self.network.edges[edge],
                start_secs: at_secs,
                duration_secs: traversal.duration_secs,
                expected_secs: traversal.expected_secs,
                success: traversal.success,
                chance: Chance::new(traversal.success, traversal.evidence),
            });
            at_secs += traversal.duration_secs;
        }
        Ok((steps, at_secs))
    }

    fn route(&mut self, departure_secs: f64, found: &Found) -> Result<Route, RouteError> {
        let (walked, arrival_secs) = self.walk(departure_secs, &found.edges)?;
        let confidence = self.options.confidence;
        let chance = walked.iter().fold(Chance::CERTAIN, |all, step| all.and(step.chance));
        Ok(Route {
            departure_secs,
            arrival_secs,
            expected_secs: walked.iter().map(|step| step.expected_secs).sum(),
            success: walked.iter().map(|step| step.success).product(),
            success_interval: chance.interval(confidence),
            cost: self.outlook.costing.shown(found.cost),
            steps: walked.into_iter().map(|step| step.shown(confidence)).collect(),
        })
    }

    /// The best way of a departure with the next best ones. Where [`Bounds::Auto`] has few labels it samples after all.
    fn alternatives(&mut self, departure: Departure) -> Result<Vec<Found>, RouteError> {
        let Departure { secs, found, to_go } = departure;
        let to_go = to_go.or(self.known.take()).unwrap_or_else(|| ToGo::nothing(self.network));
        let (ends, span) = ((self.start, self.goal), (secs, secs + self.options.horizon_secs));
        let (count, labels_max) = (self.options.alternatives, self.options.labels_max);
        let is_try = self.bounds == Bounds::Auto && !self.marks.cut_off;
        let most = if is_try { AUTO_LABELS.min(labels_max) } else { labels_max };
        let marks = self.marks;
        let again = found.clone();
        let all = self.search(secs, &to_go, most, |search, _| next_best(search, found, ends, span, count))?;
        if !is_try || !self.marks.cut_off {
            return Ok(all);
        }
        self.marks = marks;
        self.bounds = Bounds::Sampled(AUTO_SAMPLES);
        let sampled = self.depart_sampled(secs, Cost::INFINITE, AUTO_SAMPLES)?;
        let to_go = sampled.and_then(|sampled| sampled.to_go).unwrap_or(to_go);
        self.search(secs, &to_go, labels_max, |search, _| next_best(search, again, ends, span, count))
    }

    fn answer(&mut self, departure: Departure) -> Result<Routes, RouteError> {
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
        Ok(Routes { routes, certainty, labels: self.labels, forecasts: self.outlook.asked })
    }
}

/// An edge on a way, as it was forecast.
struct Walked<'a> {
    edge: &'a Edge,
    start_secs: f64,
    duration_secs: f64,
    expected_secs: f64,
    success: f64,
    chance: Chance,
}

impl Walked<'_> {
    fn shown(&self, confidence: f64) -> RouteStep {
        RouteStep {
            edge: self.edge.id,
            from: self.edge.from,
            to: self.edge.to,
            start_secs: self.start_secs,
            duration_secs: self.duration_secs,
            success: self.success,
            success_interval: self.chance.interval(confidence),
        }
    }
}
