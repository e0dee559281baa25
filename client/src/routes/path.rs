//! Routes, policies, and forecasts of edges.
//!
//! Invariant: times are nanoseconds UTC; each edge is predicted for the time at which the robot reaches it.

use tidemap_proto::{
    convert::{
        query::{flow_source_to_wire, selector_to_wire},
        route::{EdgePrediction, objective_to_wire, predictions_from_wire, route_certainty_from_wire},
        time::{duration, instant, timestamp},
        topology::edge_name_from_wire,
    },
    v1::{self, plan_route_request},
};

use super::{Certainty, EdgeName, Objective, PolicyAction, PolicyEntry};
use crate::{
    connection::Client,
    error::Error,
    queries::{AvoidedPeople, ModelSelector},
};

/// The time to leave or to arrive, nanoseconds UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RouteTime {
    /// Leave at this time.
    Depart(i64),
    /// Arrive by this time.
    ArriveBy(i64),
    /// Leave at the best time of a window.
    DepartWithin {
        /// Earliest departure.
        from_nanos: i64,
        /// Latest departure.
        to_nanos: i64,
        /// Interval between the departures that are tried; `None`: the daemon's default.
        step_nanos: Option<i64>,
    },
}

/// A request for a route. `None`: the daemon's default.
#[derive(Clone, Debug, PartialEq)]
pub struct RouteQuery {
    /// Name of the map.
    pub map: String,
    /// Name of the node where the robot is.
    pub from: String,
    /// Name of the node to reach.
    pub to: String,
    /// The time to leave or to arrive.
    pub when: RouteTime,
    /// The objective.
    pub objective: Objective,
    /// Cost of a failed attempt in addition to its own time, seconds.
    pub recovery_secs: Option<f64>,
    /// Cost of a failure in a blend, seconds.
    pub failure_cost_secs: Option<f64>,
    /// Number of alternative routes.
    pub alternatives: u32,
    /// Confidence of the intervals of success.
    pub confidence: Option<f64>,
    /// The longest duration of a route, nanoseconds.
    pub horizon_nanos: Option<i64>,
    /// The model that predicts success.
    pub model: ModelSelector,
    /// Speed on edges without nominal duration, metres per second.
    pub speed_m_per_s: Option<f64>,
    /// Time limit of planning, nanoseconds.
    pub plan_within_nanos: Option<i64>,
    /// People to avoid.
    pub avoided: Option<AvoidedPeople>,
}

impl RouteQuery {
    /// A request with the daemon's defaults.
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
            avoided: None,
        }
    }
}

/// A step of a route: the name of its edge, and when the robot is there.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedRouteStep {
    /// The name of the edge.
    pub edge: EdgeName,
    /// The time at which the robot reaches the edge if nothing fails.
    pub start_nanos: i64,
    /// Forecast duration.
    pub duration_secs: f64,
    /// Probability that the robot passes the edge.
    pub success: f64,
    /// Lower and upper end of the interval of `success`.
    pub success_interval: [f64; 2],
    /// Number of reports of the edge.
    pub reports: u64,
    /// Number of reports that no update has learned yet.
    pub pending_reports: u64,
    /// Expected encounters with people; 0 if none are avoided.
    pub encounters: f64,
}

/// A route from one node to another, by the names of its edges, in times UTC.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedRoute {
    /// The edges of the route, in order.
    pub steps: Vec<NamedRouteStep>,
    /// Departure.
    pub departure_nanos: i64,
    /// Arrival if nothing fails.
    pub arrival_nanos: i64,
    /// Expected duration, failed attempts included.
    pub expected_secs: f64,
    /// Probability that nothing fails.
    pub success: f64,
    /// Lower and upper end of the interval of `success`.
    pub success_interval: [f64; 2],
    /// Cost under the objective.
    pub cost: f64,
    /// Expected encounters with people if nothing fails; 0 if none are avoided.
    pub encounters: f64,
}

/// A request for a policy. `None`: the daemon's default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PolicyQuery {
    /// Name of the map.
    pub map: String,
    /// Name of the node to reach.
    pub to: String,
    /// The begin of the first slot.
    pub time_nanos: i64,
    /// Length of time that the policy covers, nanoseconds.
    pub horizon_nanos: Option<i64>,
    /// Length of a slot, nanoseconds.
    pub slot_nanos: Option<i64>,
    /// The objective.
    pub objective: Objective,
    /// Cost of a failed attempt in addition to its own time, seconds.
    pub recovery_secs: Option<f64>,
    /// The model that predicts success.
    pub model: ModelSelector,
    /// Speed on edges without nominal duration, metres per second.
    pub speed_m_per_s: Option<f64>,
}

/// A policy: the action at each node in each slot.
#[derive(Clone, Debug, PartialEq)]
pub struct Policy {
    /// The begin of the first slot.
    pub time_nanos: i64,
    /// Length of a slot.
    pub slot_nanos: i64,
    /// The name of each node, and its entries by slot.
    pub nodes: Vec<(String, Vec<PolicyEntry<EdgeName>>)>,
}

fn edge_of(edge: Option<&v1::EdgeEnds>) -> Result<EdgeName, Error> {
    edge_name_from_wire("edge", edge).map_err(|_| Error::Protocol("no valid edge in the answer"))
}

fn route(route: v1::Route) -> Result<NamedRoute, Error> {
    let step = |step: v1::RouteStep| {
        Ok(NamedRouteStep {
            edge: edge_of(step.edge.as_ref())?,
            start_nanos: step.start_nanos,
            duration_secs: step.duration_secs,
            success: step.success,
            success_interval: [step.success_lower, step.success_upper],
            reports: step.reports,
            pending_reports: step.pending_reports,
            encounters: step.encounters,
        })
    };
    Ok(NamedRoute {
        departure_nanos: route.departure_nanos,
        arrival_nanos: route.arrival_nanos,
        expected_secs: route.expected_secs,
        success: route.success,
        success_interval: [route.success_lower, route.success_upper],
        cost: route.cost,
        encounters: route.encounters,
        steps: route.steps.into_iter().map(step).collect::<Result<_, Error>>()?,
    })
}

fn entries(node: v1::NodePolicy) -> Result<(String, Vec<PolicyEntry<EdgeName>>), Error> {
    let actions: Vec<v1::PolicyAction> = node.actions().collect();
    let entry = |(slot, action): (usize, v1::PolicyAction)| {
        let index = node.edge_indices.get(slot).map_or(0, |&index| index as usize);
        let action = match action {
            v1::PolicyAction::Edge => PolicyAction::Take(edge_of(node.edges.get(index))?),
            v1::PolicyAction::Wait => PolicyAction::Wait,
            v1::PolicyAction::Arrived => PolicyAction::Arrived,
            v1::PolicyAction::None | v1::PolicyAction::Unspecified => PolicyAction::Nothing,
        };
        let expected_secs = node.expected_secs.get(slot).copied().unwrap_or(f64::INFINITY);
        Ok(PolicyEntry { action, expected_secs, reach: node.reach.get(slot).copied().unwrap_or_default() })
    };
    let entries = actions.into_iter().enumerate().map(entry).collect::<Result<_, Error>>()?;
    Ok((node.node, entries))
}

impl Client {
    /// Plans the best route from one node to another, and its alternatives, best first.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or node does not exist, `FAILED_PRECONDITION` if no route exists.
    pub async fn plan_route(&self, query: RouteQuery) -> Result<(Vec<NamedRoute>, Certainty), Error> {
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
            encounter_cost_secs: query.avoided.as_ref().map(|avoided| avoided.encounter_cost_secs),
            near_m: query.avoided.as_ref().map_or(0.0, |avoided| avoided.near_m),
            avoid_people: query.avoided.map(|avoided| flow_source_to_wire(avoided.source)),
        };
        let answer = self.route_service().plan_route(request).await.map_err(|status| self.error(&status))?;
        let reply = answer.into_inner();
        let certainty = route_certainty_from_wire(reply.certainty()).unwrap_or(Certainty::CutOff);
        Ok((reply.routes.into_iter().map(route).collect::<Result<_, _>>()?, certainty))
    }

    /// Plans a policy: the action at each node in each time slot to reach a node.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or node does not exist, `RESOURCE_EXHAUSTED` if there are too many
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
        let reply = self.route_service().plan_policy(request).await.map_err(|status| self.error(&status))?.into_inner();
        let slot = reply.slot.unwrap_or_default();
        Ok(Policy {
            time_nanos: instant(reply.start_time).unwrap_or(query.time_nanos),
            slot_nanos: slot.seconds.saturating_mul(1_000_000_000).saturating_add(slot.nanos.into()),
            nodes: reply.nodes.into_iter().map(entries).collect::<Result<_, _>>()?,
        })
    }

    /// Forecasts success and duration of each edge of a map at a time.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn predict_edges(
        &self,
        map: &str,
        time_nanos: i64,
        model: ModelSelector,
        speed_m_per_s: Option<f64>,
    ) -> Result<Vec<EdgePrediction>, Error> {
        let request = v1::PredictEdgesRequest {
            map: map.to_owned(),
            time: Some(timestamp(time_nanos)),
            model: Some(selector_to_wire(model)),
            speed_m_per_s: speed_m_per_s.unwrap_or_default(),
            confidence: None,
        };
        let reply =
            self.route_service().predict_edges(request).await.map_err(|status| self.error(&status))?.into_inner();
        predictions_from_wire(reply).map_err(|_| Error::Protocol("no valid edge in the answer"))
    }
}
