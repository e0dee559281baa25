//! Routes, policies and edges: requests and replies.
//!
//! Invariant: times become seconds after the reference time of the question; an error names the field, and the planner
//! checks the rest.

use tidemap_map::{
    edge_forecast::EdgeForecast,
    name::EdgeName,
    topology::{Edge, EdgeId, NodeId, Topology},
};
use tidemap_model::models::Interval;
use tidemap_plan::{
    policy::{PolicyAction, PolicyObjective, PolicyOptions, PolicyTable},
    route::{Certainty, DEPARTURES_MAX, Objective, Route, RouteOptions, RoutePlan, RouteStep, When},
};

use super::{
    InvalidField,
    query::{AvoidedPeople, avoided_from_wire},
    time::{duration, instant_from_wire, nanos_from_duration, nanos_from_timestamp, timestamp},
    topology::{edge_name_from_wire, edge_to_wire, node_name},
};
use crate::v1;

/// Maximum of nodes times slots of a policy.
pub const POLICY_CELLS_MAX: usize = 200_000;
/// Default interval between departures, seconds.
const DEPARTURE_STEP_SECS: f64 = 60.0;

/// The question of a route.
#[derive(Clone, Debug, PartialEq)]
pub struct RouteQuestion {
    /// The reference time of `when`, nanoseconds UTC.
    pub reference_nanos: i64,
    /// When to leave or arrive, in seconds after the reference time.
    pub when: When,
    /// Options of the search.
    pub options: RouteOptions,
    /// The people to avoid.
    pub avoided: Option<AvoidedPeople>,
}

/// The question of a request for a route.
///
/// # Errors
/// The invalid field.
pub fn route_from_wire(request: &v1::PlanRouteRequest) -> Result<RouteQuestion, InvalidField> {
    use v1::plan_route_request::When as WhenRequested;
    let default = RouteOptions::default();
    let horizon_secs = positive_secs("horizon", request.horizon, default.horizon_secs)?;
    let missing = || InvalidField::new("when", "set one of depart_time, arrive_by_time and depart_within");
    let (reference_nanos, when) = match request.when.as_ref().ok_or_else(missing)? {
        WhenRequested::DepartTime(time) => (nanos_from_timestamp("depart_time", *time)?, When::DepartAt(0.0)),
        WhenRequested::ArriveByTime(time) => {
            let nanos = nanos_from_timestamp("arrive_by_time", *time)?;
            // No time is before 1970.
            (nanos, When::ArriveBy { by_secs: 0.0, earliest_secs: -horizon_secs.min(nanos as f64 / 1e9) })
        }
        WhenRequested::DepartWithin(window) => {
            let from = instant_from_wire("depart_within.from_time", window.from_time)?;
            let to = instant_from_wire("depart_within.to_time", window.to_time)?;
            if to < from {
                return Err(InvalidField::new("depart_within", "to_time is before from_time"));
            }
            let to_secs = (to - from) as f64 / 1e9;
            let usual = (to_secs / (DEPARTURES_MAX - 1) as f64).max(DEPARTURE_STEP_SECS);
            let step_secs = positive_secs("depart_within.step", window.step, usual)?;
            (from, When::DepartWithin { from_secs: 0.0, to_secs, step_secs })
        }
    };
    let objective = match known_objective(request.objective)? {
        v1::RouteObjective::Unspecified | v1::RouteObjective::Success => Objective::Success,
        v1::RouteObjective::Time => Objective::Time,
        v1::RouteObjective::Blend => Objective::Blend { weight: within("doubt", request.doubt, 0.0, 1.0)? },
    };
    let avoided = avoided_from_wire(request)?;
    let options = RouteOptions {
        objective,
        recovery_secs: secs("recovery_secs", request.recovery_secs, default.recovery_secs)?,
        failure_cost_secs: secs("failure_cost_secs", request.failure_cost_secs, default.failure_cost_secs)?,
        encounter_cost_secs: match &avoided {
            Some(avoided) => secs("encounter_cost_secs", Some(avoided.encounter_cost_secs), 0.0)?,
            None => 0.0,
        },
        alternatives: usize::try_from(request.alternatives).unwrap_or(usize::MAX),
        confidence: request.confidence.unwrap_or(default.confidence),
        horizon_secs,
    };
    Ok(RouteQuestion { reference_nanos, when, options, avoided })
}

/// The options of a request for a policy.
///
/// # Errors
/// The invalid field.
pub fn policy_from_wire(request: &v1::PlanPolicyRequest) -> Result<PolicyOptions, InvalidField> {
    let default = PolicyOptions::default();
    let objective = match known_objective(request.objective)? {
        v1::RouteObjective::Unspecified | v1::RouteObjective::Success => PolicyObjective::Reach,
        v1::RouteObjective::Time => PolicyObjective::Time,
        v1::RouteObjective::Blend => {
            return Err(InvalidField::new("objective", "a policy has no blend: request success or time"));
        }
    };
    let slot_secs = positive_secs("slot", request.slot, default.slot_secs)?;
    if slot_secs < 1.0 {
        return Err(InvalidField::new("slot", format!("{slot_secs} s: expected 1 s or more")));
    }
    let horizon_secs = positive_secs("horizon", request.horizon, default.slot_secs * default.slots as f64)?;
    Ok(PolicyOptions {
        objective,
        slot_secs,
        slots: (horizon_secs / slot_secs).ceil() as usize,
        recovery_secs: secs("recovery_secs", request.recovery_secs, default.recovery_secs)?,
    })
}

/// Confidence of the intervals of success.
///
/// # Errors
/// The confidence is not at least 0.5 and below 1.
pub fn confidence_from_wire(confidence: Option<f64>) -> Result<f64, InvalidField> {
    match confidence.unwrap_or(RouteOptions::default().confidence) {
        confidence if (0.5..1.0).contains(&confidence) => Ok(confidence),
        wrong => Err(InvalidField::new("confidence", format!("{wrong}: expected 0.5 to 1, without 1"))),
    }
}

both_ways!(
    /// How certain it is that no route is better, for the wire.
    route_certainty_to_wire, route_certainty_from_wire, Certainty, v1::RouteCertainty,
    [Proven = Proven, WithinResolution = WithinResolution, Sampled = Sampled, CutOff = CutOff]
);

/// The objective, and the doubt of a blend, for the wire.
#[must_use]
pub fn objective_to_wire(objective: Objective) -> (v1::RouteObjective, f64) {
    match objective {
        Objective::Success => (v1::RouteObjective::Success, 0.0),
        Objective::Time => (v1::RouteObjective::Time, 0.0),
        Objective::Blend { weight } => (v1::RouteObjective::Blend, weight),
    }
}

/// The time `secs` seconds after another, in nanoseconds UTC.
#[must_use]
pub fn later(reference_nanos: i64, secs: f64) -> i64 {
    reference_nanos.saturating_add((secs * 1e9).round() as i64)
}

/// Routes for the wire; `reports` returns the number of reports of an edge.
#[must_use]
pub fn routes_to_wire(
    planned: &RoutePlan,
    reference_nanos: i64,
    topology: &Topology,
    reports: impl Fn(EdgeId) -> [u64; 2],
) -> v1::PlanRouteResponse {
    let time = |secs| later(reference_nanos, secs);
    let step = |step: &RouteStep| {
        let [reports, pending_reports] = reports(step.edge);
        v1::RouteStep {
            edge: ends(topology, step.edge),
            start_nanos: time(step.start_secs),
            duration_secs: step.duration_secs,
            success: step.success,
            success_lower: step.success_interval.lower,
            success_upper: step.success_interval.upper,
            reports,
            pending_reports,
            encounters: step.encounters,
        }
    };
    let route = |route: &Route| v1::Route {
        steps: route.steps.iter().map(step).collect(),
        departure_nanos: time(route.departure_secs),
        arrival_nanos: time(route.arrival_secs),
        expected_secs: route.expected_secs,
        success: route.success,
        success_lower: route.success_interval.lower,
        success_upper: route.success_interval.upper,
        cost: route.cost,
        encounters: route.encounters,
    };
    v1::PlanRouteResponse {
        routes: planned.routes.iter().map(route).collect(),
        certainty: route_certainty_to_wire(planned.certainty).into(),
    }
}

/// The prediction of an edge, as received.
#[derive(Clone, Debug, PartialEq)]
pub struct EdgePrediction {
    /// The edge.
    pub edge: EdgeName,
    /// Probability that the robot arrives.
    pub success: f64,
    /// Interval of the success.
    pub success_interval: [f64; 2],
    /// Expected duration, seconds.
    pub duration_secs: f64,
    /// Number of reports.
    pub reports: u64,
}

/// The predictions of edges.
///
/// # Errors
/// An edge without a valid name.
pub fn predictions_from_wire(reply: v1::PredictEdgesResponse) -> Result<Vec<EdgePrediction>, InvalidField> {
    let prediction = |(i, wire): (usize, v1::PredictedEdge)| {
        let v1::PredictedEdge { edge, success, success_lower, success_upper, duration_secs, reports } = wire;
        let edge = edge_name_from_wire(&format!("edges[{i}].edge"), edge.as_ref())?;
        Ok(EdgePrediction { edge, success, success_interval: [success_lower, success_upper], duration_secs, reports })
    };
    reply.edges.into_iter().enumerate().map(prediction).collect()
}

/// The forecast of an edge for the wire, with the interval of its success and the number of its reports.
#[must_use]
pub fn prediction_to_wire(
    (topology, edge): (&Topology, &Edge),
    forecast: EdgeForecast,
    success: Interval,
    reports: u64,
) -> v1::PredictedEdge {
    v1::PredictedEdge {
        edge: Some(edge_to_wire(topology, edge)),
        success: forecast.success,
        success_lower: success.lower,
        success_upper: success.upper,
        duration_secs: forecast.duration_secs,
        reports,
    }
}

fn ends(topology: &Topology, edge: EdgeId) -> Option<v1::EdgeEnds> {
    topology.edge(edge).ok().map(|edge| edge_to_wire(topology, edge))
}

/// A policy whose first slot begins at `start_nanos`, for the wire.
#[must_use]
pub fn policy_to_wire(table: &PolicyTable, start_nanos: i64, topology: &Topology) -> v1::PlanPolicyResponse {
    let node = |&node: &NodeId| {
        let mut wire = v1::NodePolicy { node: node_name(topology, node), ..v1::NodePolicy::default() };
        let mut edges: Vec<EdgeId> = Vec::new();
        for entry in (0..table.slots()).filter_map(|slot| table.entry(node, slot)) {
            let mut index = 0;
            let action = match entry.action {
                PolicyAction::Take(edge) => {
                    index = edges.iter().position(|&other| other == edge).unwrap_or_else(|| {
                        edges.push(edge);
                        edges.len() - 1
                    });
                    v1::PolicyAction::Edge
                }
                PolicyAction::Wait => v1::PolicyAction::Wait,
                PolicyAction::Arrived => v1::PolicyAction::Arrived,
                PolicyAction::Nothing => v1::PolicyAction::None,
            };
            wire.actions.push(action.into());
            wire.edge_indices.push(u32::try_from(index).unwrap_or(u32::MAX));
            wire.expected_secs.push(entry.expected_secs);
            wire.reach.push(entry.reach);
        }
        wire.edges = edges.into_iter().filter_map(|edge| ends(topology, edge)).collect();
        wire
    };
    v1::PlanPolicyResponse {
        start_time: Some(timestamp(start_nanos)),
        slot: Some(duration((table.slot_secs() * 1e9).round() as i64)),
        slots: u32::try_from(table.slots()).unwrap_or(u32::MAX),
        nodes: table.nodes().iter().map(node).collect(),
    }
}

fn known_objective(objective: i32) -> Result<v1::RouteObjective, InvalidField> {
    v1::RouteObjective::try_from(objective)
        .map_err(|_| InvalidField::new("objective", format!("{objective} is not known")))
}

fn within(field: &'static str, value: f64, least: f64, max: f64) -> Result<f64, InvalidField> {
    let wrong = || InvalidField::new(field, format!("{value}: expected {least} to {max}"));
    if (least..=max).contains(&value) { Ok(value) } else { Err(wrong()) }
}

fn secs(field: &'static str, value: Option<f64>, default: f64) -> Result<f64, InvalidField> {
    within(field, value.unwrap_or(default), 0.0, 1e9)
}

fn positive_secs(field: &'static str, span: Option<prost_types::Duration>, default: f64) -> Result<f64, InvalidField> {
    let secs = span.map_or(Ok(default), |span| nanos_from_duration(field, span).map(|nanos| nanos as f64 / 1e9))?;
    if secs > 0.0 && secs <= 1e9 {
        Ok(secs)
    } else {
        Err(InvalidField::new(field, format!("{secs} s: expected above 0 s, at most 1e9 s")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MINUTE: i64 = 60_000_000_000;

    fn request_at(when: v1::plan_route_request::When) -> v1::PlanRouteRequest {
        v1::PlanRouteRequest { when: Some(when), ..Default::default() }
    }

    fn window(from_nanos: i64, to_nanos: i64) -> v1::DepartureWindow {
        let [from_time, to_time] = [from_nanos, to_nanos].map(|nanos| Some(timestamp(nanos)));
        v1::DepartureWindow { from_time, to_time, step: None }
    }

    #[test]
    fn a_plain_question_has_the_defaults() {
        use v1::plan_route_request::When as WhenRequested;
        let question = route_from_wire(&request_at(WhenRequested::DepartTime(timestamp(7 * MINUTE)))).expect("right");
        let options = RouteOptions::default();
        assert_eq!(
            question,
            RouteQuestion { reference_nanos: 7 * MINUTE, when: When::DepartAt(0.0), options, avoided: None }
        );
        let by = |minutes| {
            route_from_wire(&request_at(WhenRequested::ArriveByTime(timestamp(minutes * MINUTE)))).expect("right").when
        };
        assert_eq!(by(7_000), When::ArriveBy { by_secs: 0.0, earliest_secs: -86_400.0 });
        assert_eq!(by(7), When::ArriveBy { by_secs: 0.0, earliest_secs: -420.0 }, "not before 1970");
        let window = window(MINUTE, 3 * MINUTE);
        let within = route_from_wire(&request_at(WhenRequested::DepartWithin(window))).expect("right");
        let steps = When::DepartWithin { from_secs: 0.0, to_secs: 120.0, step_secs: 60.0 };
        assert_eq!((within.reference_nanos, within.when), (MINUTE, steps));
        assert_eq!(policy_from_wire(&v1::PlanPolicyRequest::default()), Ok(PolicyOptions::default()));
    }

    #[test]
    fn what_is_wrong_is_named() {
        use v1::plan_route_request::When as WhenRequested;
        let field = |request: v1::PlanRouteRequest| route_from_wire(&request).expect_err("wrong").field;
        assert_eq!(field(v1::PlanRouteRequest::default()), "when");
        let at = || request_at(WhenRequested::DepartTime(timestamp(0)));
        assert_eq!(field(request_at(WhenRequested::DepartTime(timestamp(-1)))), "depart_time");
        assert_eq!(field(v1::PlanRouteRequest { objective: 9, ..at() }), "objective");
        assert_eq!(field(v1::PlanRouteRequest { objective: 3, doubt: f64::NAN, ..at() }), "doubt");
        assert_eq!(field(v1::PlanRouteRequest { recovery_secs: Some(-1.0), ..at() }), "recovery_secs");
        let none = Some(prost_types::Duration { seconds: 0, nanos: 0 });
        assert_eq!(field(v1::PlanRouteRequest { horizon: none, ..at() }), "horizon");
        let window = window(MINUTE, 0);
        assert_eq!(field(request_at(WhenRequested::DepartWithin(window))), "depart_within");
        let field = |request: v1::PlanPolicyRequest| policy_from_wire(&request).expect_err("wrong").field;
        assert_eq!(field(v1::PlanPolicyRequest { objective: 3, ..Default::default() }), "objective");
        assert_eq!(field(v1::PlanPolicyRequest { slot: none, ..Default::default() }), "slot");
        assert!(confidence_from_wire(Some(1.0)).is_err() && confidence_from_wire(Some(f64::NAN)).is_err());
    }
}
