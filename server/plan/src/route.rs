//! Routes over a topological map whose edges' success and duration depend on time: the best route and its alternatives.
//!
//! Each edge is forecast for the time at which the robot reaches it without failures. Attempts are independent: a route
//! succeeds without a failure with the product of its edges' successes p. Its cost is a sum over its edges:
//!
//! - [`Objective::Time`]: expected seconds if a failed attempt is repeated until one succeeds, d + (1 - p)/p · (d + r).
//!   There are (1 - p)/p failures on average; each costs the time d of an attempt and the recovery r. The forecast of
//!   the first attempt also applies to the repeated ones.
//! - [`Objective::Success`]: -ln p, so that the least sum is the greatest product. Counted in whole steps of 1e-12, so
//!   that equal products are equal; then the least expected seconds win.
//! - An encounter with people counts as [`RouteOptions::encounter_cost_secs`] of time in all three.
//! - [`Objective::Blend`]: (1 - w) · expected seconds + w · F · -ln p. For p near 1, -ln p is nearly 1 - p, so F is the
//!   cost of a failure beyond its time, in seconds.
//!
//! A robot does not wait between edges and visits no node twice. Arriving later may be better, because a door may open.
//! So one of two paths to a node is dropped only if both arrive at the same time, within
//! [`SearchWork::resolution_secs`], and if everything that may follow the dearer path may also follow the cheaper one.
//! [`Certainty`] states what was proven. Bounds of the caller prove optimality; sampled bounds do not. By default a few
//! thousand labels are spent on a proof, which is enough for a flat; then bounds are sampled. After the topological
//! navigation of N. Hawes et al., "The STRANDS Project", IEEE RAM 2017, whose actions also have predicted successes and
//! durations. [`crate::policy`] covers failures. Forecasts come from the caller ([`Forecasts`]); the crate knows no
//! model.
//!
//! Invariant: a result never claims more [`Certainty`] than it has; all its numbers are finite.

mod alternatives;
mod bounds;
mod chance;
mod cost;
mod departure;
mod error;
mod forecast;
mod forecast_cache;
mod labels;
mod network;
mod work;

pub use chance::success_interval;
pub use departure::plan_routes;
pub use error::PlanRouteError;
pub(crate) use forecast::check_forecast;
pub use forecast::{EdgeBest, EdgeForecast, ForecastError, Forecasts, SUCCESS_MIN, expected_secs};
pub(crate) use network::Network;
use tidemap_map::topology::{EdgeId, NOMINAL_MAX_SECS, NodeId};
use tidemap_model::models::Interval;
pub(crate) use work::SearchWork;

/// Maximum number of alternatives beside the best route.
pub(crate) const ALTERNATIVES_MAX: usize = 10;
/// Maximum number of departures of one request.
pub const DEPARTURES_MAX: usize = 1_000;
/// Largest time of a request, in seconds to either side of its reference time.
pub(crate) const TIME_MAX_SECS: f64 = NOMINAL_MAX_SECS;

/// The objective of a route.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Objective {
    /// The greatest probability that nothing fails; ties: the least expected time.
    #[default]
    Success,
    /// The least expected time.
    Time,
    /// A blend of both.
    Blend {
        /// 0: expected time only, 1: success only.
        weight: f64,
    },
}

/// The departure of a route, in seconds after the reference time of the request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum When {
    /// Depart at this time.
    DepartAt(f64),
    /// Depart at the best of the times `from_secs`, `from_secs` + `step_secs`, … up to `to_secs`; ties: the earliest.
    DepartWithin {
        /// The first departure.
        from_secs: f64,
        /// The last departure.
        to_secs: f64,
        /// The step between departures, above 0; at most [`DEPARTURES_MAX`] departures.
        step_secs: f64,
    },
    /// Depart as late as possible, so that the expected arrival of the best route of that departure is no later than
    /// `by_secs`. Departures are tried backwards in steps of a minute, or wider so that there are at most
    /// [`DEPARTURES_MAX`], then refined to 0.1 s from the first that arrives in time; a later departure between two
    /// steps may be missed. No departure is before `earliest_secs`, or longer than the horizon before `by_secs`.
    ArriveBy {
        /// The latest arrival.
        by_secs: f64,
        /// The earliest departure.
        earliest_secs: f64,
    },
}

/// The options of a route.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RouteOptions {
    /// The objective; success by default.
    pub objective: Objective,
    /// The additional time of a failed attempt, in seconds, 0 to [`TIME_MAX_SECS`]; 60 by default.
    pub recovery_secs: f64,
    /// The cost of a failure in [`Objective::Blend`], in seconds, 0 to [`TIME_MAX_SECS`]; 600 by default.
    pub failure_cost_secs: f64,
    /// The cost of one encounter with people, in seconds, 0 to [`TIME_MAX_SECS`]; 0 by default: encounters do not
    /// matter. With [`Objective::Success`] they only decide between routes of equal success.
    pub encounter_cost_secs: f64,
    /// Number of alternatives, which differ from the others in at least one edge; at most [`ALTERNATIVES_MAX`]; 0 by
    /// default.
    pub alternatives: usize,
    /// Probability of the intervals, 0.5 to 1, without 1; 0.9 by default.
    pub confidence: f64,
    /// Maximum duration of a route without failures, in seconds, above 0, at most [`TIME_MAX_SECS`]; a day by default.
    pub horizon_secs: f64,
}

impl Default for RouteOptions {
    fn default() -> RouteOptions {
        RouteOptions {
            objective: Objective::Success,
            recovery_secs: 60.0,
            failure_cost_secs: 600.0,
            encounter_cost_secs: 0.0,
            alternatives: 0,
            confidence: 0.9,
            horizon_secs: 86_400.0,
        }
    }
}

/// The certainty that no route is better, the most certain first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Certainty {
    /// The result is proven to be the best.
    Proven,
    /// The result is proven, except for paths that arrive within one second and count as arriving together.
    WithinResolution,
    /// Paths were pruned by sampled bounds.
    Sampled,
    /// The search was stopped or ran out of labels.
    CutOff,
}

/// One edge of a route.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RouteStep {
    /// The edge.
    pub edge: EdgeId,
    /// The node at which the edge begins.
    pub from: NodeId,
    /// The node at which the edge ends.
    pub to: NodeId,
    /// Time at which the robot enters the edge without failures, in seconds after the reference time.
    pub start_secs: f64,
    /// Duration of the edge at that time, in seconds.
    pub duration_secs: f64,
    /// Expected encounters with people on the edge.
    pub encounters: f64,
    /// Success probability of an attempt, above 0, at most 1.
    pub success: f64,
    /// The interval of the success at [`RouteOptions::confidence`], by [`success_interval`].
    pub success_interval: Interval,
}

/// A route from one node to another, at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// The steps of the route, in order; empty if it ends where it begins.
    pub steps: Vec<RouteStep>,
    /// The departure, in seconds after the reference time.
    pub departure_secs: f64,
    /// The arrival without failures, in seconds after the reference time.
    pub arrival_secs: f64,
    /// The expected duration, failures and recovery included, in seconds.
    pub expected_secs: f64,
    /// Expected encounters with people without failures.
    pub encounters: f64,
    /// The probability that nothing fails: the product over the steps.
    pub success: f64,
    /// The interval of the success at [`RouteOptions::confidence`]: quantiles of the Beta distribution with the mean
    /// and variance of the product of independent edges.
    pub success_interval: Interval,
    /// The cost by the objective: seconds, or -ln of the success.
    pub cost: f64,
}

/// The result of planning.
#[derive(Clone, Debug, PartialEq)]
pub struct RoutePlan {
    /// The best route and its alternatives, the best first. Alternatives depart at the same time.
    pub routes: Vec<Route>,
    /// The certainty that these are the best routes.
    pub certainty: Certainty,
    /// Number of labels (partial routes).
    pub labels: usize,
    /// Number of requested forecasts.
    pub forecasts: usize,
}

#[cfg(test)]
mod tests;
