//! Questions of routes and policies, and what is told of edges.
//!
//! Invariant: times become seconds after the question's reference time; what is wrong is told with its field, and what the
//! planner itself checks is left to it.

use tidemap_plan::{
    policy::{PolicyObjective, PolicyOptions},
    route::{Certainty, DEPARTURES_MAX, Objective, RouteOptions, When},
};

use super::{
    InvalidField,
    time::{instant_from_wire, nanos_from_duration, nanos_from_timestamp},
};
use crate::v1;

/// Most nodes times slots of a policy that is told.
pub const POLICY_CELLS_MAX: usize = 200_000;
/// How far apart departures are by default, seconds.
const DEPARTURE_STEP_SECS: f64 = 60.0;

/// A question of a route.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RouteQuestion {
    /// What the seconds of `when` count from, nanoseconds UTC.
    pub reference_nanos: i64,
    /// When.
    pub when: When,
    /// How to search.
    pub options: RouteOptions,
}

/// What is asked of a route.
///
/// # Errors
/// The field that is wrong.
pub fn route_from_wire(request: &v1::PlanRouteRequest) -> Result<RouteQuestion, InvalidField> {
    use v1::plan_route_request::When as Asked;
    let default = RouteOptions::default();
    let horizon_secs = positive_secs("horizon", request.horizon, default.horizon_secs)?;
    let missing = || InvalidField::new("when", "say when: depart_time, arrive_by_time or depart_within");
    let (reference_nanos, when) = match request.when.as_ref().ok_or_else(missing)? {
        Asked::DepartTime(time) => (nanos_from_timestamp("depart_time", *time)?, When::DepartAt(0.0)),
        Asked::ArriveByTime(time) => {
            let nanos = nanos_from_timestamp("arrive_by_time", *time)?;
            // There is no time before 1970.
            (nanos, When::ArriveBy { by_secs: 0.0, earliest_secs: -horizon_secs.min(nanos as f64 / 1e9) })
        }
        Asked::DepartWithin(window) => {
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
    let objective = match objective_from_wire(request.objective)? {
        v1::RouteObjective::Unspecified | v1::RouteObjective::Success => Objective::Success,
        v1::RouteObjective::Time => Objective::Time,
        v1::RouteObjective::Blend => Objective::Blend { weight: within("doubt", request.doubt, 0.0, 1.0)? },
    };
    let options = RouteOptions {
        objective,
        recovery_secs: secs("recovery_secs", request.recovery_secs, default.recovery_secs)?,
        failure_cost_secs: secs("failure_cost_secs", request.failure_cost_secs, default.failure_cost_secs)?,
        alternatives: usize::try_from(request.alternatives).unwrap_or(usize::MAX),
        confidence: request.confidence.unwrap_or(default.confidence),
        horizon_secs,
        ..default
    };
    Ok(RouteQuestion { reference_nanos, when, options })
}

/// What is asked of a policy.
///
/// # Errors
/// The field that is wrong.
pub fn policy_from_wire(request: &v1::PlanPolicyRequest) -> Result<PolicyOptions, InvalidField> {
    let default = PolicyOptions::default();
    let objective = match objective_from_wire(request.objective)? {
        v1::RouteObjective::Unspecified | v1::RouteObjective::Success => PolicyObjective::Reach,
        v1::RouteObjective::Time => PolicyObjective::Time,
        v1::RouteObjective::Blend => {
            return Err(InvalidField::new("objective", "a policy has no blend: ask for success or time"));
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

/// How likely an interval is to hold what it is of.
///
/// # Errors
/// Not 0.5 to 1, or 1.
pub fn confidence_from_wire(confidence: Option<f64>) -> Result<f64, InvalidField> {
    match confidence.unwrap_or(RouteOptions::default().confidence) {
        confidence if (0.5..1.0).contains(&confidence) => Ok(confidence),
        wrong => Err(InvalidField::new("confidence", format!("{wrong}: expected 0.5 to 1, without 1"))),
    }
}

/// How sure an answer is, for the wire.
#[must_use]
pub fn certainty_to_wire(certainty: Certainty) -> v1::RouteCertainty {
    match certainty {
        Certainty::Proven => v1::RouteCertainty::Proven,
        Certainty::WithinResolution => v1::RouteCertainty::WithinResolution,
        Certainty::Sampled => v1::RouteCertainty::Sampled,
        Certainty::CutOff => v1::RouteCertainty::CutOff,
    }
}

fn objective_from_wire(objective: i32) -> Result<v1::RouteObjective, InvalidField> {
    v1::RouteObjective::try_from(objective)
        .map_err(|_| InvalidField::new("objective", format!("{objective} is not known")))
}

fn within(field: &'static str, value: f64, least: f64, most: f64) -> Result<f64, InvalidField> {
    let wrong = || InvalidField::new(field, format!("{value}: expected {least} to {most}"));
    if (least..=most).contains(&value) { Ok(value) } else { Err(wrong()) }
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
    use crate::convert::time::timestamp;

    const MINUTE: i64 = 60_000_000_000;

    fn asked(when: v1::plan_route_request::When) -> v1::PlanRouteRequest {
        v1::PlanRouteRequest { when: Some(when), ..Default::default() }
    }

    fn window(from_nanos: i64, to_nanos: i64) -> v1::DepartureWindow {
        let [from_time, to_time] = [from_nanos, to_nanos].map(|nanos| Some(timestamp(nanos)));
        v1::DepartureWindow { from_time, to_time, step: None }
    }

    #[test]
    fn a_plain_question_has_the_defaults() {
        use v1::plan_route_request::When as Asked;
        let question = route_from_wire(&asked(Asked::DepartTime(timestamp(7 * MINUTE)))).expect("right");
        let options = RouteOptions::default();
        assert_eq!(question, RouteQuestion { reference_nanos: 7 * MINUTE, when: When::DepartAt(0.0), options });
        let by =
            |minutes| route_from_wire(&asked(Asked::ArriveByTime(timestamp(minutes * MINUTE)))).expect("right").when;
        assert_eq!(by(7_000), When::ArriveBy { by_secs: 0.0, earliest_secs: -86_400.0 });
        assert_eq!(by(7), When::ArriveBy { by_secs: 0.0, earliest_secs: -420.0 }, "not before 1970");
        let window = window(MINUTE, 3 * MINUTE);
        let within = route_from_wire(&asked(Asked::DepartWithin(window))).expect("right");
        let steps = When::DepartWithin { from_secs: 0.0, to_secs: 120.0, step_secs: 60.0 };
        assert_eq!((within.reference_nanos, within.when), (MINUTE, steps));
        assert_eq!(policy_from_wire(&v1::PlanPolicyRequest::default()), Ok(PolicyOptions::default()));
    }

    #[test]
    fn what_is_wrong_is_named() {
        use v1::plan_route_request::When as Asked;
        let field = |request: v1::PlanRouteRequest| route_from_wire(&request).expect_err("wrong").field;
        assert_eq!(field(v1::PlanRouteRequest::default()), "when");
        let at = || asked(Asked::DepartTime(timestamp(0)));
        assert_eq!(field(asked(Asked::DepartTime(timestamp(-1)))), "depart_time");
        assert_eq!(field(v1::PlanRouteRequest { objective: 9, ..at() }), "objective");
        assert_eq!(field(v1::PlanRouteRequest { objective: 3, doubt: f64::NAN, ..at() }), "doubt");
        assert_eq!(field(v1::PlanRouteRequest { recovery_secs: Some(-1.0), ..at() }), "recovery_secs");
        let none = Some(prost_types::Duration { seconds: 0, nanos: 0 });
        assert_eq!(field(v1::PlanRouteRequest { horizon: none, ..at() }), "horizon");
        let window = window(MINUTE, 0);
        assert_eq!(field(asked(Asked::DepartWithin(window))), "depart_within");
        let field = |request: v1::PlanPolicyRequest| policy_from_wire(&request).expect_err("wrong").field;
        assert_eq!(field(v1::PlanPolicyRequest { objective: 3, ..Default::default() }), "objective");
        assert_eq!(field(v1::PlanPolicyRequest { slot: none, ..Default::default() }), "slot");
        assert!(confidence_from_wire(Some(1.0)).is_err() && confidence_from_wire(Some(f64::NAN)).is_err());
    }
}
