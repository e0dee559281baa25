//! Routes, policies, and what is to be expected of edges.
//!
//! Invariant: times are nanoseconds UTC, and each edge is told for when the robot reaches it.

use tidemap_proto::convert::query::selector_to_wire;
use tidemap_proto::convert::route::{objective_to_wire, route_certainty_from_wire};
use tidemap_proto::convert::time::{duration, instant, timestamp};
use tidemap_proto::v1::{self, plan_route_request};

use super::{Certainty, EdgeEnds, Objective};
use crate::{connection::Client, error::Error, queries::ModelSelector};

/// When to go, nanoseconds UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RouteTime {
    /// Leaving then.
    Depart(i64),
    /// Arriving by then.
    ArriveBy(i64),
    /// Leaving when that is best.
    DepartWithin {
        /// Not before.
        from_nanos: i64,
        /// Not after.
        to_nanos: i64,
        /// Distance of the departures that are tried; `None`: the daemon's default.
        step_nanos: Option<i64>,
    },
}

/// What is asked of a route. `None`: the daemon's default.
#[derive(Clone, Debug, PartialEq)]
pub struct RouteQuery {
    /// Name of the map.
    pub map: String,
    /// Name of the node where the robot is.
    pub from: String,
    /// Name of the node where it wants to be.
    pub to: String,
    /// When.
    pub when: RouteTime,
    /// What the route is best at.
    pub objective: Objective,
    /// What a failed attempt costs beside its own time, seconds.
    pub recovery_secs: Option<f64>,
    /// What a failure costs in a blend, seconds.
    pub failure_cost_secs: Option<f64>,
    /// How many next best routes.
    pub alternatives: u32,
    /// How likely the intervals hold what they are of.
    pub confidence: Option<f64>,
    /// No route takes longer, nanoseconds.
    pub horizon_nanos: Option<i64>,
    /// Which model predicts success.
    pub model: ModelSelector,
    /// Metres a second, for edges with a length alone.
    pub speed_m_per_s: Option<f64>,
    /// How long to look for it, nanoseconds.
    pub plan_within_nanos: Option<i64>,
}

impl RouteQuery {
    /// A question with the daemon's defaults.
    #[must_use]
    pub fn new(map: &str, from: &str, to: &str, when: RouteTime) -> RouteQuery {
        RouteQuery {
            map: map.to_owned(),
            from: from.to_owned(),
            to: to.to_owned(),
            when,
            objective: Objective::default(),
            recovery_secs: None,
            failure_cost_secs: None,
            alternatives: 0,
            confidence: None,
            horizon_nanos: None,
            model: ModelSelector::default(),
            speed_m_per_s: None,
            plan_within_nanos: None,
        }
    }
}

/// An edge on a route.
#[derive(Clone, Debug, PartialEq)]
pub struct RouteStep {
    /// Which.
    pub edge: EdgeEnds,
    /// When the robot reaches it if all goes well.
    pub start_nanos: i64,
    /// How long it takes.
    pub duration_secs: f64,
    /// How likely it is passed.
    pub success: f64,
    /// Where that lies: lower and upper end.
    pub success_interval: [f64; 2],
    /// How often it was reported so far.
    pub reports: u64,
}

/// A way from one node to another.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// Its edges, in order.
    pub steps: Vec<RouteStep>,
    /// When it begins.
    pub departure_nanos: i64,
    /// When it ends if all goes well.
    pub arrival_nanos: i64,
    /// How long it takes on average, failures included.
    pub expected_secs: f64,
    /// How likely nothing fails.
    pub success: f64,
    /// Where that lies: lower and upper end.
    pub success_interval: [f64; 2],
    /// What it costs by the objective.
    pub cost: f64,
}

/// What is asked of a policy. `None`: the daemon's default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PolicyQuery {
    /// Name of the map.
    pub map: String,
    /// Name of the node to reach.
    pub to: String,
    /// When the first slot begins.
    pub time_nanos: i64,
    /// When the last slot ends, nanoseconds after that.
    pub horizon_nanos: Option<i64>,
    /// How long a slot is, nanoseconds.
    pub slot_nanos: Option<i64>,
    /// What the policy is best at.
    pub objective: Objective,
    /// What a failed attempt costs beside its own time, seconds.
    pub recovery_secs: Option<f64>,
    /// Which model predicts success.
    pub model: ModelSelector,
    /// Metres a second, for edges with a length alone.
    pub speed_m_per_s: Option<f64>,
}

/// What to do at a node in a slot.
#[derive(Clone, Debug, PartialEq)]
pub enum PolicyAction {
    /// Take this edge.
    Take(EdgeEnds),
    /// Stay for a slot.
    Wait,
    /// Nothing that is done here helps any more.
    Nothing,
    /// The node is the one to reach.
    Arrived,
}

/// A node in a slot.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyEntry {
    /// What to do.
    pub action: PolicyAction,
    /// How long it takes on average, from the beginning of the slot; infinite where it is not certain to be reached.
    pub expected_secs: f64,
    /// How likely the node is reached before the last slot ends.
    pub reach: f64,
}

/// What to do at each node in each slot.
#[derive(Clone, Debug, PartialEq)]
pub struct Policy {
    /// When the first slot begins.
    pub time_nanos: i64,
    /// How long a slot is.
    pub slot_nanos: i64,
    /// By node its name, and by slot what to do.
    pub nodes: Vec<(String, Vec<PolicyEntry>)>,
}

/// What is to be expected of an edge.
#[derive(Clone, Debug, PartialEq)]
pub struct PredictedEdge {
    /// Which.
    pub edge: EdgeEnds,
    /// How likely it is passed.
    pub success: f64,
    /// Where that lies: lower and upper end.
    pub success_interval: [f64; 2],
    /// How long it takes.
    pub duration_secs: f64,
    /// How often it was reported so far.
    pub reports: u64,
}

fn ends(edge: Option<v1::EdgeEnds>) -> EdgeEnds {
    let v1::EdgeEnds { from, to, action, both_ways } = edge.unwrap_or_default();
    EdgeEnds { from, to, action, both_ways }
}

fn route(route: v1::Route) -> Route {
    let step = |step: v1::RouteStep| RouteStep {
        edge: ends(step.edge),
        start_nanos: step.start_nanos,
        duration_secs: step.duration_secs,
        success: step.success,
        success_interval: [step.success_lower, step.success_upper],
        reports: step.reports,
    };
    Route {
        departure_nanos: route.departure_nanos,
        arrival_nanos: route.arrival_nanos,
        expected_secs: route.expected_secs,
        success: route.success,
        success_interval: [route.success_lower, route.success_upper],
        cost: route.cost,
        steps: route.steps.into_iter().map(step).collect(),
    }
}

fn entries(node: v1::NodePolicy) -> (String, Vec<PolicyEntry>) {
    let actions: Vec<v1::PolicyAction> = node.actions().collect();
    let entry = |(slot, action): (usize, v1::PolicyAction)| {
        let index = node.edge_indices.get(slot).map_or(0, |&index| index as usize);
        let action = match action {
            v1::PolicyAction::Edge => PolicyAction::Take(ends(node.edges.get(index).cloned())),
            v1::PolicyAction::Wait => PolicyAction::Wait,
            v1::PolicyAction::Arrived => PolicyAction::Arrived,
            v1::PolicyAction::None | v1::PolicyAction::Unspecified => PolicyAction::Nothing,
        };
        let expected_secs = node.expected_secs.get(slot).copied().unwrap_or(f64::INFINITY);
        PolicyEntry { action, expected_secs, reach: node.reach.get(slot).copied().unwrap_or_default() }
    };
    let entries = actions.into_iter().enumerate().map(entry).collect();
    (node.node, entries)
}

impl Client {
    /// The best way from one node to another at a time, and its alternatives, from the best.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` where there is no such map or node, `FAILED_PRECONDITION` where no way leads there.
    pub async fn plan_route(&self, query: RouteQuery) -> Result<(Vec<Route>, Certainty), Error> {
        let (objective, doubt) = objective_to_wire(query.objective);
        let when = match query.when {
            RouteTime::Depart(nanos) => plan_route_request::When::DepartTime(timestamp(nanos)),
            RouteTime::ArriveBy(nanos) => plan_route_request::When::ArriveByTime(timestamp(nanos)),
            RouteTime::DepartWithin { from_nanos, to_nanos, step_nanos } => {
                let [from_time, to_time] = [from_nanos, to_nanos].map(|nanos| Some(timestamp(nanos)));
                let step = step_nanos.map(duration);
                plan_route_request::When::DepartWithin(v1::DepartureWindow { from_time, to_time, step })
            }
        };
        let request = v1::PlanRouteRequest {
            map: query.map,
            from: query.from,
            to: query.to,
            when: Some(when),
            objective: objective.into(),
            doubt,
            recovery_secs: query.recovery_secs,
            failure_cost_secs: query.failure_cost_secs,
            alternatives: query.alternatives,
            confidence: query.confidence,
            horizon: query.horizon_nanos.map(duration),
            model: Some(selector_to_wire(query.model)),
            speed_m_per_s: query.speed_m_per_s.unwrap_or_default(),
            plan_within: query.plan_within_nanos.map(duration),
        };
        let answer = self.route_service().plan_route(request).await.map_err(|status| self.error(&status))?;
        let told = answer.into_inner();
        let certainty = route_certainty_from_wire(told.certainty()).unwrap_or(Certainty::CutOff);
        Ok((told.routes.into_iter().map(route).collect(), certainty))
    }

    /// What to do at each node in each slot of time so as to reach a node.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` where there is no such map or node, `RESOURCE_EXHAUSTED` where there are too many
    /// slots.
    pub async fn plan_policy(&self, query: PolicyQuery) -> Result<Policy, Error> {
        let (objective, _) = objective_to_wire(query.objective);
        let request = v1::PlanPolicyRequest {
            map: query.map,
            to: query.to,
            start_time: Some(timestamp(query.time_nanos)),
            horizon: query.horizon_nanos.map(duration),
            slot: query.slot_nanos.map(duration),
            objective: objective.into(),
            recovery_secs: query.recovery_secs,
            model: Some(selector_to_wire(query.model)),
            speed_m_per_s: query.speed_m_per_s.unwrap_or_default(),
        };
        let told = self.route_service().plan_policy(request).await.map_err(|status| self.error(&status))?.into_inner();
        let slot = told.slot.unwrap_or_default();
        Ok(Policy {
            time_nanos: instant(told.start_time).unwrap_or(query.time_nanos),
            slot_nanos: slot.seconds.saturating_mul(1_000_000_000).saturating_add(slot.nanos.into()),
            nodes: told.nodes.into_iter().map(entries).collect(),
        })
    }

    /// How likely each edge of a map is passed at a time, and how long it takes.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` where there is no such map.
    pub async fn predict_edges(
        &self,
        map: &str,
        time_nanos: i64,
        model: ModelSelector,
        speed_m_per_s: Option<f64>,
    ) -> Result<Vec<PredictedEdge>, Error> {
        let request = v1::PredictEdgesRequest {
            map: map.to_owned(),
            time: Some(timestamp(time_nanos)),
            model: Some(selector_to_wire(model)),
            speed_m_per_s: speed_m_per_s.unwrap_or_default(),
            confidence: None,
        };
        let told =
            self.route_service().predict_edges(request).await.map_err(|status| self.error(&status))?.into_inner();
        let edge = |edge: v1::PredictedEdge| PredictedEdge {
            edge: ends(edge.edge),
            success: edge.success,
            success_interval: [edge.success_lower, edge.success_upper],
            duration_secs: edge.duration_secs,
            reports: edge.reports,
        };
        Ok(told.edges.into_iter().map(edge).collect())
    }
}
