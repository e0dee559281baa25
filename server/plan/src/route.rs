//! Routes over a topological map whose edges' success and duration depend on time: the best one, and the next best.
//!
//! Each edge is forecast for the time at which the robot reaches it if all before goes well. A route of independent attempts
//! succeeds without a failure with the product of its edges' successes p. What it costs is a sum over its edges:
//!
//! - [`Objective::Time`]: expected seconds when a failed attempt is repeated until one works, d + (1 - p)/p · (d + r). There are
//!   (1 - p)/p failures on average; each costs the time d of an attempt, as the successful one does, and the recovery r. The
//!   forecast at the first attempt counts for the repeated ones, too.
//! - [`Objective::Success`]: -ln p, so that the least sum is the greatest product. Counted in whole steps of 1e-12, so that equal
//!   sums are equal; of these the least expected seconds win.
//! - [`Objective::Blend`]: (1 - w) · expected seconds + w · F · -ln p. For p near 1, -ln p is nearly 1 - p, so F is what a failure
//!   costs beyond its time, in seconds.
//!
//! A robot does not wait between edges, and comes to no node twice. Later may be better: a door opens. So two ways to a node
//! are compared only if they arrive at the same time, within [`RouteOptions::resolution_secs`], and the search keeps both
//! otherwise. [`Certainty`] says what was proven. After the topological navigation of N. Hawes et al., "The STRANDS Project",
//! IEEE RAM 2017, whose actions have predicted successes and durations, too; [`crate::policy`] tells what to do after a
//! failure.
//!
//! Invariant: an answer never claims more [`Certainty`] than it has; every number in it is finite.

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

pub use chance::success_interval;
pub use departure::plan_routes;
pub use error::PlanRouteError;
pub use forecast::{EdgeBest, EdgeForecast, ForecastError, Forecasts, SUCCESS_MIN};
pub(crate) use forecast::{check_forecast, expected_secs};
pub(crate) use network::Network;
use tidemap_map::topology::{EdgeId, NOMINAL_MAX_SECS, NodeId};
use tidemap_model::models::Interval;

/// Most alternatives beside the best route.
pub(crate) const ALTERNATIVES_MAX: usize = 10;
/// Most departures that are tried for one answer.
pub const DEPARTURES_MAX: usize = 1_000;
/// Most times at which an edge is sampled for [`Bounds::Sampled`].
pub const SAMPLES_MAX: u32 = 100;
/// Largest time of a question, in seconds to either side of its reference time: as long as edges may be.
pub(crate) const TIME_MAX_SECS: f64 = NOMINAL_MAX_SECS;

/// What the best route is best at.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Objective {
    /// The greatest probability that nothing fails; of equal ones the least expected time.
    #[default]
    Success,
    /// The least expected time.
    Time,
    /// Something between them.
    Blend {
        /// 0 is the expected time alone, 1 the doubt alone.
        weight: f64,
    },
}

/// When to go, in seconds after the reference time of the question.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum When {
    /// At this time.
    DepartAt(f64),
    /// At the best of the times `from_secs`, `from_secs` + `step_secs`, … up to `to_secs`; of equal ones the earliest.
    DepartWithin {
        /// The first.
        from_secs: f64,
        /// None is later.
        to_secs: f64,
        /// Above 0; at most [`DEPARTURES_MAX`] departures.
        step_secs: f64,
    },
    /// As late as possible, so that the expected arrival of the best route of that departure is no later than `by_secs`. Departures
    /// are tried backwards in steps of [`RouteOptions::arrival_step_secs`], and from the first that will do onwards to 0.1 s; that a
    /// later one between two steps would do as well is possible. None before `earliest_secs`, or longer than the horizon before
    /// `by_secs`.
    ArriveBy {
        /// To be there by then.
        by_secs: f64,
        /// No departure before.
        earliest_secs: f64,
    },
}

/// What a search may leave out, by how good an edge can be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Bounds {
    /// [`Bounds::Known`] with few labels; where they do not suffice, [`Bounds::Sampled`] with four times.
    #[default]
    Auto,
    /// What [`Forecasts::best`] says, and otherwise nothing: a success of 1 in no time. Nothing better is left out, but a map of
    /// more than about 15 nodes without bounds uses up any number of labels.
    Known,
    /// The best of about so many forecasts, 1 to [`SAMPLES_MAX`], spread evenly over twice the time that a good route takes. A
    /// route is overlooked only if an edge of it is better, or open, between them and at none; that none is cannot be proven.
    Sampled(u32),
}

/// How to search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RouteOptions {
    /// What is sought; success by default.
    pub objective: Objective,
    /// What a failed attempt costs beside its time, in seconds, 0 to [`TIME_MAX_SECS`]; 60 by default.
    pub recovery_secs: f64,
    /// What a failure costs in [`Objective::Blend`], in seconds, 0 to [`TIME_MAX_SECS`]; 600 by default.
    pub failure_cost_secs: f64,
    /// How many next best routes, which differ from the others in an edge at least, at most [`ALTERNATIVES_MAX`]; 0 by default.
    pub alternatives: usize,
    /// Probability of the intervals, 0.5 to 1, without 1; 0.9 by default.
    pub confidence: f64,
    /// No route takes longer where all goes well, in seconds, above 0, at most [`TIME_MAX_SECS`]; a day by default.
    pub horizon_secs: f64,
    /// Forecasts are asked for at whole multiples of this, in seconds, and ways to a node that arrive within one count as arriving
    /// together. 0 to 3,600; 1 by default. With 0 both are exact.
    pub resolution_secs: f64,
    /// What may be left out.
    pub bounds: Bounds,
    /// Most partial routes of one search, 1 or more; 200,000 by default, 64 bytes each. With sampled bounds a quarter of them is tried
    /// first; then edges are sampled again, nearer to the time at which a good route comes to them; and if that does not do, ways
    /// count as arriving together within 16 times the resolution, and the answer is [`Certainty::CutOff`]. All alternatives together
    /// are one search.
    pub labels_max: usize,
    /// In which steps departures are tried for [`When::ArriveBy`], in seconds, above 0; 60 by default. Where that would be more
    /// than [`DEPARTURES_MAX`], the steps are wider.
    pub arrival_step_secs: f64,
}

impl Default for RouteOptions {
    fn default() -> RouteOptions {
        RouteOptions {
            objective: Objective::Success,
            recovery_secs: 60.0,
            failure_cost_secs: 600.0,
            alternatives: 0,
            confidence: 0.9,
            horizon_secs: 86_400.0,
            resolution_secs: 1.0,
            bounds: Bounds::Auto,
            labels_max: 200_000,
            arrival_step_secs: 60.0,
        }
    }
}

/// How sure it is that no route is better, from the surest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Certainty {
    /// Proven.
    Proven,
    /// Proven but for ways that arrived within one [`RouteOptions::resolution_secs`] and counted as arriving together.
    WithinResolution,
    /// Sampled bounds left something out.
    Sampled,
    /// The search was stopped, or had no labels left.
    CutOff,
}

/// An edge on a route.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RouteStep {
    /// Which.
    pub edge: EdgeId,
    /// Where it begins.
    pub from: NodeId,
    /// Where it ends.
    pub to: NodeId,
    /// When it is entered if all goes well, in seconds after the reference time.
    pub start_secs: f64,
    /// How long it takes then, in seconds.
    pub duration_secs: f64,
    /// How likely an attempt succeeds, above 0, at most 1.
    pub success: f64,
    /// Where that lies with [`RouteOptions::confidence`], as [`success_interval`] says.
    pub success_interval: Interval,
}

/// A way from one node to another, at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// Its edges, in order; none where it ends where it begins.
    pub steps: Vec<RouteStep>,
    /// When it begins, in seconds after the reference time.
    pub departure_secs: f64,
    /// When it ends if all goes well.
    pub arrival_secs: f64,
    /// How long it takes on average, failures and recovery included, in seconds.
    pub expected_secs: f64,
    /// How likely nothing fails: the product over the steps.
    pub success: f64,
    /// Where that lies with [`RouteOptions::confidence`]: quantiles of the Beta distribution with the mean and variance of the
    /// product, edges being independent.
    pub success_interval: Interval,
    /// What it costs by the objective: seconds, or -ln of the success.
    pub cost: f64,
}

/// An answer.
#[derive(Clone, Debug, PartialEq)]
pub struct RoutePlan {
    /// The best route and its alternatives, the best first. Alternatives leave at the same time.
    pub routes: Vec<Route>,
    /// How sure it is that these are the best.
    pub certainty: Certainty,
    /// Partial routes that were looked at.
    pub labels: usize,
    /// How often a forecast was asked for.
    pub forecasts: usize,
}

#[cfg(test)]
mod tests;
