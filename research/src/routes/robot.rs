//! A robot that drives from place to place, day and night, for weeks.
//!
//! Invariant: all robots with one seed have the same tasks and meet the same world. They differ only in how they choose
//! a path. An edge that failed is not tried again in the same task unless there is no other path.

use rand::Rng as _;
use tidemap_map::{
    edge_forecast::EdgeForecasts,
    topology::{Edge, EdgeId, NodeId, Roads, ShortestTimes},
    traversal::Traversal,
};
use tidemap_model::selector::{Blend, ModelSelector};
use tidemap_plan::route::{EdgeForecast, Objective, PlanRouteError, RouteOptions, SUCCESS_MIN, When, plan_routes};

use super::{
    DAY_SECS, RoutesError, RoutesProtocol, START_NANOS, WEEK_DAYS,
    building::{Building, draw},
    learner::Learner,
};

/// Minimum of the oracle's probability of success, so that a path through a shut door remains a path.
const TRUE_SUCCESS_MIN: f64 = 1e-6;
/// Number of reports that the truth counts as; only intervals depend on it.
const TRUE_EVIDENCE: f64 = 1e6;

/// The method by which a robot chooses its path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RobotKind {
    /// The shortest path, whatever happened there.
    Shortest,
    /// The route that tidemap plans by default: from the data that it learned until last midnight, and from the newest
    /// reports of each edge up to the lead time at which they have been right.
    Tidemap,
    /// The route from the data that was learned until last midnight alone.
    TidemapEnsemble,
    /// The route of [`TidemapEnsemble`](Self::TidemapEnsemble), with the last report of each edge while it is recent.
    TidemapPersistence,
    /// The route of [`TidemapPersistence`](Self::TidemapPersistence), by the rates of a two-state chain.
    TidemapMemory,
    /// The route with the least expected time, including failures, from the data that was learned until last midnight.
    TidemapTime,
    /// The route that tidemap plans from the true probabilities: no robot can do better except by luck.
    Oracle,
}

impl RobotKind {
    /// All kinds, the baseline first.
    pub const ALL: [RobotKind; 7] = [
        RobotKind::Shortest,
        RobotKind::Tidemap,
        RobotKind::TidemapEnsemble,
        RobotKind::TidemapPersistence,
        RobotKind::TidemapMemory,
        RobotKind::TidemapTime,
        RobotKind::Oracle,
    ];

    /// The name of the robot in results.
    pub fn name(self) -> &'static str {
        match self {
            RobotKind::Shortest => "shortest",
            RobotKind::Tidemap => "tidemap",
            RobotKind::TidemapEnsemble => "tidemap-ensemble",
            RobotKind::TidemapPersistence => "tidemap+persistence",
            RobotKind::TidemapMemory => "tidemap+memory",
            RobotKind::TidemapTime => "tidemap-time",
            RobotKind::Oracle => "oracle",
        }
    }
}

/// The totals of a robot's week.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Week {
    /// Tasks that started in the week.
    pub tasks: u64,
    /// Failed traversals of these tasks.
    pub failures: u64,
    /// Total duration of these tasks.
    pub secs: f64,
}

/// A robot that drives.
pub(crate) struct RouteRobot<'a> {
    kind: RobotKind,
    building: &'a Building,
    learner: Learner,
    /// The node where the robot is.
    pub(crate) at: NodeId,
    /// Seconds since midnight before the first Monday.
    pub(crate) now_secs: f64,
}

/// Lets a robot drive for all weeks of the protocol.
pub(super) fn run(kind: RobotKind, seed: u64, protocol: &RoutesProtocol) -> Result<Vec<Week>, RoutesError> {
    let learner = kind.learner()?;
    let building = Building::new(seed, learner.topology().clone());
    let nodes: Vec<NodeId> = building.topology().nodes().map(|node| node.id).collect();
    let mut robot = RouteRobot::new(kind, &building, learner)?;
    let mut weeks = vec![Week::default(); protocol.weeks];
    for day in 0..protocol.weeks * WEEK_DAYS {
        if day > 0 {
            robot.learn(day)?;
        }
        let mut random = draw(seed, [u64::MAX, 0, day as u64]);
        let mut times: Vec<f64> = (0..protocol.tasks).map(|_| random.random_range(0.0..DAY_SECS)).collect();
        times.sort_by(f64::total_cmp);
        for time in times {
            // All robots end each task at its goal, so the next task is the same for all.
            let others: Vec<NodeId> = nodes.iter().copied().filter(|&node| node != robot.at).collect();
            let goal = others[random.random_range(0..others.len())];
            robot.now_secs = robot.now_secs.max(day as f64 * DAY_SECS + time);
            let since = robot.now_secs;
            let failures = robot.go(goal)?;
            let week = &mut weeks[day / WEEK_DAYS];
            week.tasks += 1;
            week.failures += failures;
            week.secs += robot.now_secs - since;
        }
    }
    Ok(weeks)
}

impl RobotKind {
    fn learns(self) -> bool {
        !matches!(self, RobotKind::Shortest | RobotKind::Oracle)
    }

    /// The map of such a robot, which has learned nothing.
    pub(crate) fn learner(self) -> Result<Learner, RoutesError> {
        let auto = ModelSelector::default();
        Learner::new(match self {
            RobotKind::TidemapPersistence => ModelSelector { blend: Blend::Persistence, ..auto },
            RobotKind::TidemapMemory => ModelSelector { blend: Blend::Memory, ..auto },
            RobotKind::Tidemap => auto,
            _ => auto.long_term(),
        })
    }
}

impl<'a> RouteRobot<'a> {
    /// A robot at its dock, on the first midnight.
    pub(crate) fn new(kind: RobotKind, building: &'a Building, learner: Learner) -> Result<Self, RoutesError> {
        let at = building.topology().node_named("dock").map_err(RoutesError::setting)?.id;
        Ok(RouteRobot { kind, building, learner, at, now_secs: 0.0 })
    }

    /// The learned data of the edges.
    pub(crate) fn edges(&self) -> &EdgeForecasts {
        self.learner.edges()
    }

    /// Learns the robot's traversals until the midnight before a day, counted from 0, if the robot learns at all.
    pub(crate) fn learn(&mut self, day: usize) -> Result<(), RoutesError> {
        if self.kind.learns() { self.learner.midnight(nanos(day as f64 * DAY_SECS)) } else { Ok(()) }
    }

    /// Drives to a node, and returns the number of failed traversals.
    pub(crate) fn go(&mut self, goal: NodeId) -> Result<u64, RoutesError> {
        let topology = self.building.topology();
        let mut shunned: Vec<EdgeId> = Vec::new();
        let mut failures = 0;
        while self.at != goal {
            let route = match self.route(goal, &shunned)? {
                Some(route) => route,
                None => {
                    shunned.clear();
                    self.route(goal, &shunned)?.ok_or_else(|| RoutesError::Setting("no path to a node".to_owned()))?
                }
            };
            let mut driven = Vec::with_capacity(route.len());
            for id in route {
                let edge = topology.edge(id).map_err(RoutesError::setting)?;
                let attempt = self.building.attempt(edge, self.now_secs);
                let start_nanos = nanos(self.now_secs);
                self.now_secs += attempt.secs;
                driven.push(Traversal {
                    edge: topology.edge_in_words(edge).map_err(RoutesError::setting)?,
                    start_nanos,
                    end_nanos: nanos(self.now_secs),
                    success: attempt.reason.is_none(),
                    reason: attempt.reason.unwrap_or_default().to_owned(),
                });
                if attempt.reason.is_some() {
                    shunned.push(id);
                    failures += 1;
                    break;
                }
                self.at = edge.to;
            }
            if self.kind.learns() {
                self.learner.report(&driven)?;
            }
        }
        Ok(failures)
    }

    /// The edges of a path to a node that avoids the shunned edges; none if there is no such path.
    fn route(&self, goal: NodeId, shunned: &[EdgeId]) -> Result<Option<Vec<EdgeId>>, RoutesError> {
        let is_open = |edge: &Edge| !shunned.contains(&edge.id);
        let now_secs = self.now_secs;
        match self.kind {
            RobotKind::Shortest => self.shortest(goal, is_open),
            RobotKind::Tidemap
            | RobotKind::TidemapEnsemble
            | RobotKind::TidemapPersistence
            | RobotKind::TidemapMemory
            | RobotKind::TidemapTime => {
                let edges = self.learner.edges();
                self.planned(goal, |edge, at_secs| {
                    is_open(edge).then(|| edges.forecast(edge, nanos(now_secs + at_secs)))
                })
            }
            RobotKind::Oracle => self.planned(goal, |edge, at_secs| {
                let (success, duration_secs) = self.building.truth(edge, now_secs + at_secs);
                let success = success.max(TRUE_SUCCESS_MIN.max(SUCCESS_MIN));
                is_open(edge).then_some(EdgeForecast { success, duration_secs, evidence: TRUE_EVIDENCE })
            }),
        }
    }

    /// The best route as `PlanRoute` returns it by default: the most likely to succeed, or for
    /// [`RobotKind::TidemapTime`] the fastest.
    fn planned(
        &self,
        goal: NodeId,
        mut forecast: impl FnMut(&Edge, f64) -> Option<EdgeForecast>,
    ) -> Result<Option<Vec<EdgeId>>, RoutesError> {
        let mut options = RouteOptions::default();
        if self.kind == RobotKind::TidemapTime {
            options.objective = Objective::Time;
        }
        let never = || false;
        let topology = self.building.topology();
        match plan_routes(topology, self.at, goal, When::DepartAt(0.0), &options, &mut forecast, never) {
            Ok(planned) => Ok(planned.routes.first().map(|route| route.steps.iter().map(|step| step.edge).collect())),
            Err(PlanRouteError::Unreachable { .. }) => Ok(None),
            Err(other) => Err(other.into()),
        }
    }

    fn shortest(&self, goal: NodeId, is_open: impl Fn(&Edge) -> bool) -> Result<Option<Vec<EdgeId>>, RoutesError> {
        let topology = self.building.topology();
        let length = |edge: &Edge| edge.extent.length_m.filter(|_| is_open(edge));
        let roads = Roads::new(topology, length).map_err(RoutesError::setting)?;
        let (Some(from), Some(to)) = (roads.index_of(self.at), roads.index_of(goal)) else { return Ok(None) };
        let mut shortest = ShortestTimes::default();
        shortest.between(&roads, from, to);
        if !shortest.secs()[to].is_finite() {
            return Ok(None);
        }
        let nodes: Vec<NodeId> = std::iter::once(self.at)
            .chain(shortest.way_to(to).into_iter().map(|arrival| roads.node(arrival.node)))
            .collect();
        let edge = |ends: &[NodeId]| topology.edge_between(ends[0], ends[1], None).map(|edge| edge.id);
        Ok(nodes.windows(2).filter(|ends| ends[0] != ends[1]).map(edge).collect())
    }
}

/// Nanoseconds UTC of a time in seconds since the first midnight.
pub(crate) fn nanos(secs: f64) -> i64 {
    START_NANOS + (secs * 1e9).round() as i64
}
