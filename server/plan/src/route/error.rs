//! The errors of route planning, and the check of a request.
//!
//! Invariant: each message names the invalid value and the valid range.

use super::{ALTERNATIVES_MAX, DEPARTURES_MAX, ForecastError, Objective, RouteOptions, TIME_MAX_SECS, When};

/// The reason why route planning failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum PlanRouteError {
    /// The map has no such node.
    #[error("there is no node of number {0}")]
    UnknownNode(u32),
    /// There is no path.
    #[error(
        "there is no path from node number {from} to node number {to}; {closed} edges were closed when \
         they were reached"
    )]
    Unreachable { from: u32, to: u32, closed: usize },
    /// All paths take too long.
    #[error("no route from node number {from} to node number {to} takes at most {horizon_secs} s; raise the horizon")]
    BeyondHorizon { from: u32, to: u32, horizon_secs: f64 },
    /// No departure is early enough.
    #[error(
        "no departure from {earliest_secs} s on is expected to arrive by {by_secs} s; allow an earlier departure or a \
         later arrival"
    )]
    TooLate { earliest_secs: f64, by_secs: f64 },
    /// The search ended before it found a path.
    #[error("the search was stopped after {labels} partial routes without finding a route; raise its limit")]
    CutOff { labels: usize },
    /// A number of the request is out of range.
    #[error("{what} is {found}: expected {expected}")]
    Range { what: &'static str, found: f64, expected: String },
    /// Too many departures.
    #[error("{found} departures: at most {DEPARTURES_MAX} are tried; take wider steps")]
    TooManyDepartures { found: f64 },
    /// A forecast is out of range.
    #[error(transparent)]
    Forecast(#[from] ForecastError),
}

fn range(what: &'static str, found: f64, holds: bool, expected: impl FnOnce() -> String) -> Result<(), PlanRouteError> {
    if holds { Ok(()) } else { Err(PlanRouteError::Range { what, found, expected: expected() }) }
}

fn secs(what: &'static str, found: f64) -> Result<(), PlanRouteError> {
    range(what, found, (0.0..=TIME_MAX_SECS).contains(&found), || format!("0 to {TIME_MAX_SECS} s"))
}

fn positive(what: &'static str, found: f64) -> Result<(), PlanRouteError> {
    range(what, found, found > 0.0 && found <= TIME_MAX_SECS, || format!("above 0, at most {TIME_MAX_SECS} s"))
}

fn time(what: &'static str, found: f64) -> Result<(), PlanRouteError> {
    range(what, found, found.abs() <= TIME_MAX_SECS, || format!("-{TIME_MAX_SECS} to {TIME_MAX_SECS} s"))
}

/// Refuses invalid requests.
pub(super) fn check(when: When, options: &RouteOptions) -> Result<(), PlanRouteError> {
    match when {
        When::DepartAt(at_secs) => time("the departure", at_secs)?,
        When::DepartWithin { from_secs, to_secs, step_secs } => {
            time("the first departure", from_secs)?;
            time("the last departure", to_secs)?;
            range("the last departure", to_secs, from_secs <= to_secs, || {
                format!("{from_secs} s, the first, or later")
            })?;
            positive("the step between departures", step_secs)?;
            let found = ((to_secs - from_secs) / step_secs).floor() + 1.0;
            if found > DEPARTURES_MAX as f64 {
                return Err(PlanRouteError::TooManyDepartures { found });
            }
        }
        When::ArriveBy { by_secs, earliest_secs } => {
            time("the arrival", by_secs)?;
            time("the earliest departure", earliest_secs)?;
        }
    }
    if let Objective::Blend { weight } = options.objective {
        range("the weight", weight, (0.0..=1.0).contains(&weight), || "0 to 1".to_owned())?;
    }
    secs("the recovery", options.recovery_secs)?;
    secs("the cost of a failure", options.failure_cost_secs)?;
    secs("the cost of an encounter", options.encounter_cost_secs)?;
    let alternatives = options.alternatives as f64;
    range("the number of alternatives", alternatives, options.alternatives <= ALTERNATIVES_MAX, || {
        format!("0 to {ALTERNATIVES_MAX}")
    })?;
    let confidence = options.confidence;
    range("the confidence", confidence, (0.5..1.0).contains(&confidence), || "0.5 to 1, without 1".to_owned())?;
    positive("the horizon", options.horizon_secs)
}
