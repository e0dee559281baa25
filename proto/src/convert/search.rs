//! Searches and presence: the parameters of requests, and replies.
//!
//! Invariant: an error names the field; the planner checks the rest itself.

use tidemap_map::topology::{NodeId, Topology};
use tidemap_model::selector::ModelSelector;
use tidemap_plan::search::{Effort, SearchOptions, SearchPlan, Stop, StopReason};

use super::{
    InvalidField,
    query::selector_from_wire,
    time::{instant_from_wire, nanos_from_duration, times_from_wire, timestamp},
    topology::node_name,
};
use crate::v1;

/// Default time limit of planning, nanoseconds.
pub const PLAN_WITHIN_NANOS: i64 = 2_000_000_000;
/// Maximum time limit of planning, nanoseconds.
pub const PLAN_WITHIN_MAX_NANOS: i64 = 60_000_000_000;
/// Default speed of a robot on edges without nominal duration, metres per second.
pub const SPEED_M_PER_S: f64 = 0.5;

/// The options of a request for a search.
///
/// # Errors
/// The invalid field.
pub fn search_from_wire(request: &v1::PlanSearchRequest) -> Result<SearchOptions, InvalidField> {
    let default = SearchOptions::default();
    let effort = match v1::SearchEffort::try_from(request.effort) {
        Ok(effort) => effort_from_wire(effort).unwrap_or_default(),
        Err(_) => return Err(InvalidField::new("effort", format!("{} is not known", request.effort))),
    };
    let within_nanos = request.budget.map(|span| nanos_from_duration("budget", span)).transpose()?;
    if let Some(nanos) = within_nanos.filter(|&nanos| nanos < 0) {
        return Err(InvalidField::new("budget", format!("{} s: expected 0 up", nanos as f64 / 1e9)));
    }
    let share = |field: &str, value: Option<f64>, is_right: fn(f64) -> bool, right: &str| match value {
        Some(wrong) if !is_right(wrong) => Err(InvalidField::new(field, format!("{wrong}: expected {right}"))),
        value => Ok(value),
    };
    let stop = Stop {
        remains_below: share("remains_below", request.remains_below, |x| (0.0..=1.0).contains(&x), "0 to 1")?,
        cost_per_sec: share("cost_per_sec", request.cost_per_sec, |x| (0.0..=f64::MAX).contains(&x), "0 up")?,
        within_secs: within_nanos.map(|nanos| nanos as f64 / 1e9),
    };
    let floor = share("floor", request.floor, |x| x > 0.0 && x <= 1.0, "above 0, at most 1")?;
    Ok(SearchOptions { effort, floor: floor.unwrap_or(default.floor), seed: request.seed, stop })
}

/// Time limit of planning, nanoseconds.
///
/// # Errors
/// Negative, or more than [`PLAN_WITHIN_MAX_NANOS`].
pub fn plan_within_from_wire(span: Option<prost_types::Duration>) -> Result<u64, InvalidField> {
    let nanos = span.map_or(Ok(PLAN_WITHIN_NANOS), |span| nanos_from_duration("plan_within", span))?;
    let wrong = || InvalidField::new("plan_within", format!("{} s: expected 0 to 60 s", nanos as f64 / 1e9));
    u64::try_from(nanos).ok().filter(|_| nanos <= PLAN_WITHIN_MAX_NANOS).ok_or_else(wrong)
}

/// Speed of the robot, metres per second.
///
/// # Errors
/// Not a finite number above 0.
pub fn speed_from_wire(speed_m_per_s: f64) -> Result<f64, InvalidField> {
    match speed_m_per_s {
        0.0 => Ok(SPEED_M_PER_S),
        speed if speed > 0.0 && speed.is_finite() => Ok(speed),
        wrong => Err(InvalidField::new("speed_m_per_s", format!("{wrong} m/s: expected above 0"))),
    }
}

/// Maximum number of states of a joint question.
pub const JOINT_STATES_MAX: usize = 1_000;
/// Default length of time that is searched, nanoseconds.
const JOINT_WITHIN_NANOS: i64 = 7 * 86_400_000_000_000;
/// Default interval between times, nanoseconds.
const JOINT_STEP_NANOS: i64 = 600_000_000_000;
/// Maximum number of times.
const JOINT_TIMES_MAX: i64 = 1_000_000;

/// Threshold of the product of probabilities.
///
/// # Errors
/// The threshold is not in [0, 1].
fn threshold_from_wire(threshold: Option<f64>) -> Result<f64, InvalidField> {
    match threshold.unwrap_or(0.5) {
        threshold if (0.0..=1.0).contains(&threshold) => Ok(threshold),
        wrong => Err(InvalidField::new("threshold", format!("{wrong}: expected 0 to 1"))),
    }
}

/// The question when several states are 1 at once.
#[derive(Clone, Debug, PartialEq)]
pub struct JointQuestion {
    /// Names of states and cells: 1 to [`JOINT_STATES_MAX`].
    pub states: Vec<String>,
    /// The times to search, nanoseconds UTC; at least one.
    pub times_nanos: Vec<i64>,
    /// The product of the probabilities has to be above this.
    pub threshold: f64,
    /// The model.
    pub selector: ModelSelector,
}

/// The question when several states are 1 at once.
///
/// # Errors
/// The invalid field.
pub fn joint_from_wire(request: v1::NextJointRequest) -> Result<JointQuestion, InvalidField> {
    let selector = selector_from_wire("model", request.model)?;
    let threshold = threshold_from_wire(request.threshold)?;
    let times_nanos = joint_times_from_wire(&request)?;
    let states = request.states;
    if states.is_empty() || states.len() > JOINT_STATES_MAX {
        let text = format!("{} states: expected 1 to {JOINT_STATES_MAX}", states.len());
        return Err(InvalidField::new("states", text));
    }
    Ok(JointQuestion { states, times_nanos, threshold, selector })
}

/// The question where the target is.
#[derive(Clone, Debug, PartialEq)]
pub struct PresenceQuestion {
    /// Nanoseconds UTC; at least one.
    pub times_nanos: Vec<i64>,
    /// The model.
    pub selector: ModelSelector,
    /// The kind of presence; empty: the default kind.
    pub object: String,
}

/// The question where the target is.
///
/// # Errors
/// The invalid field.
pub fn presence_from_wire(request: v1::PredictPresenceRequest) -> Result<PresenceQuestion, InvalidField> {
    let v1::PredictPresenceRequest { object, times_nanos, model, .. } = request;
    let selector = selector_from_wire("model", model)?;
    times_from_wire("times_nanos", &times_nanos)?;
    Ok(PresenceQuestion { times_nanos, selector, object: object_from_wire(object)? })
}

/// The probability that the target is there at the first time of a reply, by the name of the node.
pub fn presence_of_nodes(reply: v1::PredictPresenceResponse) -> impl Iterator<Item = (String, f64)> {
    let probabilities = reply.times.into_iter().next().unwrap_or_default().probabilities;
    reply.nodes.into_iter().zip(probabilities)
}

/// The requested kind of presence; empty: the default kind.
///
/// # Errors
/// It contains '/', which separates it from the node in the names of states.
pub fn object_from_wire(object: String) -> Result<String, InvalidField> {
    if object.contains('/') {
        return Err(InvalidField::new("object", format!("{object:?} contains '/'")));
    }
    Ok(object)
}

/// The times of a joint question, nanoseconds UTC; at least one.
///
/// # Errors
/// The invalid field.
fn joint_times_from_wire(request: &v1::NextJointRequest) -> Result<Vec<i64>, InvalidField> {
    let from = instant_from_wire("from_time", request.from_time)?;
    let span = |field: &'static str, span: Option<prost_types::Duration>, default: i64, least: i64| {
        let nanos = span.map_or(Ok(default), |span| nanos_from_duration(field, span))?;
        let text = format!("{} s: expected {} s or more", nanos as f64 / 1e9, least / 1_000_000_000);
        if nanos >= least { Ok(nanos) } else { Err(InvalidField::new(field, text)) }
    };
    let within = span("within", request.within, JOINT_WITHIN_NANOS, 0)?;
    let step = span("step", request.step, JOINT_STEP_NANOS, 1_000_000_000)?;
    let steps = within / step;
    if steps >= JOINT_TIMES_MAX {
        let text = format!("{} times: at most {JOINT_TIMES_MAX} are examined; use longer steps", steps + 1);
        return Err(InvalidField::new("step", text));
    }
    let last = from.checked_add(within).ok_or_else(|| InvalidField::new("within", "the end is after the year 2262"))?;
    Ok((0..=steps).map(|k| from + k * step).filter(|&time| time <= last).collect())
}

both_ways!(
    /// Why a walk ends early, for the wire.
    stop_to_wire, stop_from_wire, StopReason, v1::SearchStop,
    [Unlikely = Unlikely, NotWorthIt = NotWorthIt, OutOfTime = OutOfTime]
);

both_ways!(
    /// How to search for the best order, for the wire.
    effort_to_wire, effort_from_wire, Effort, v1::SearchEffort,
    [Auto = Auto, Exact = Exact, Heuristic = Heuristic]
);

/// A planned search for the wire; the caller adds the nodes that were never observed.
#[must_use]
pub fn plan_to_wire(plan: &SearchPlan, topology: &Topology) -> v1::PlanSearchResponse {
    let steps = plan.steps.iter().map(|step| v1::SearchStep {
        node: node_name(topology, step.node),
        arrival_secs: step.arrival_secs,
        probability: step.probability,
    });
    let walk = plan
        .walk
        .iter()
        .map(|at| v1::SearchPassage { node: node_name(topology, at.node), arrival_secs: at.arrival_secs });
    v1::PlanSearchResponse {
        steps: steps.collect(),
        walk: walk.collect(),
        expected_secs: plan.expected_secs,
        lower_bound_secs: plan.lower_bound_secs,
        optimal: plan.optimal,
        remains: plan.remains,
        stop: plan.stopped.map_or(v1::SearchStop::Unspecified, stop_to_wire).into(),
        unreachable: plan.unreachable.iter().map(|goal| node_name(topology, goal.node)).collect(),
        ..v1::PlanSearchResponse::default()
    }
}

/// The presence of a target at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct NodePresence {
    /// The time, nanoseconds UTC.
    pub time_nanos: i64,
    /// Probability of presence at each node.
    pub probabilities: Vec<f64>,
    /// Share of each node in the sum of the probabilities; empty if the sum is 0.
    pub shares: Vec<f64>,
    /// Probability of presence at any node.
    pub anybody: f64,
}

/// The presence of a target at these nodes for the wire; the caller adds the nodes that were never observed.
#[must_use]
pub fn presence_to_wire(
    topology: &Topology,
    nodes: &[NodeId],
    times: Vec<NodePresence>,
) -> v1::PredictPresenceResponse {
    let at = |NodePresence { time_nanos, probabilities, shares, anybody }| v1::PresenceAt {
        time_nanos,
        probabilities,
        shares,
        anybody,
    };
    v1::PredictPresenceResponse {
        nodes: nodes.iter().map(|&node| node_name(topology, node)).collect(),
        times: times.into_iter().map(at).collect(),
        ..v1::PredictPresenceResponse::default()
    }
}

/// A time with the probability that several states are 1 at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointAt {
    /// The time, nanoseconds UTC.
    pub time_nanos: i64,
    /// The joint probability.
    pub probability: f64,
}

/// The first time that passes the threshold of a joint question, if there is one, and the best of the examined times,
/// for the wire.
#[must_use]
pub fn joint_to_wire(passed: Option<JointAt>, best: JointAt) -> v1::NextJointResponse {
    v1::NextJointResponse {
        time: passed.map(|joint| timestamp(joint.time_nanos)),
        probability: passed.unwrap_or(best).probability,
        best_time: Some(timestamp(best.time_nanos)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_question_has_the_defaults() {
        let request = v1::PlanSearchRequest::default();
        assert_eq!(search_from_wire(&request), Ok(SearchOptions::default()));
        assert_eq!(plan_within_from_wire(None), Ok(2_000_000_000));
        assert_eq!(speed_from_wire(0.0), Ok(SPEED_M_PER_S));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let field = |request: v1::PlanSearchRequest| search_from_wire(&request).expect_err("wrong").field;
        assert_eq!(field(v1::PlanSearchRequest { effort: 9, ..Default::default() }), "effort");
        assert_eq!(field(v1::PlanSearchRequest { floor: Some(0.0), ..Default::default() }), "floor");
        assert_eq!(
            field(v1::PlanSearchRequest { remains_below: Some(f64::NAN), ..Default::default() }),
            "remains_below"
        );
        assert_eq!(field(v1::PlanSearchRequest { cost_per_sec: Some(-1.0), ..Default::default() }), "cost_per_sec");
        let negative = Some(prost_types::Duration { seconds: -1, nanos: 0 });
        assert_eq!(field(v1::PlanSearchRequest { budget: negative, ..Default::default() }), "budget");
        assert!(plan_within_from_wire(negative).is_err());
        assert!(plan_within_from_wire(Some(prost_types::Duration { seconds: 61, nanos: 0 })).is_err());
        for wrong in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(speed_from_wire(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_joint_answer_has_the_probability_of_the_time_that_passed_or_else_of_the_best() {
        let at = |time_nanos, probability| JointAt { time_nanos, probability };
        let passed = joint_to_wire(Some(at(5, 0.75)), at(7, 0.875));
        assert_eq!((passed.time, passed.probability), (Some(timestamp(5)), 0.75));
        assert_eq!(passed.best_time, Some(timestamp(7)));
        let best = joint_to_wire(None, at(7, 0.25));
        assert_eq!((best.time, best.probability, best.best_time), (None, 0.25, Some(timestamp(7))));
    }
}
