//! `tidemap route` and `tidemap policy`: routes from one node to another for a time, and the actions after failures.
//!
//! Invariant: rows are in the order of the routes, the best first, then of their steps; the proof of optimality goes to
//! stderr.

use std::{path::PathBuf, process::ExitCode};

use clap::{ArgGroup, Args, ValueEnum};
use tidemap_client::{
    queries::{AvoidedPeople, ModelSelector},
    routes::{Certainty, EdgeName, NamedRoute, Objective, PolicyAction, PolicyQuery, RouteQuery, RouteTime, StateName},
};

use super::{
    Session, files,
    position::source,
    times,
    topology_picture::{self, Overlay},
    usage,
};
use crate::progress::status_line;
use tidemap_formats::table::Cell;

#[derive(Debug, Args)]
#[command(group = ArgGroup::new("when").required(true).args(["at", "arrive", "from_time"]))]
pub(crate) struct RouteArgs {
    /// Name of the map
    map: String,
    /// Name of the node where the robot is
    from: String,
    /// Name of the goal node
    to: String,
    /// Time of departure
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: Option<i64>,
    /// Latest time of arrival; the robot departs as late as possible
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    arrive: Option<i64>,
    /// First departure to consider
    #[arg(long = "from", value_name = "TIME", value_parser = times::time, requires = "until")]
    from_time: Option<i64>,
    /// Last departure to consider
    #[arg(long = "to", value_name = "TIME", value_parser = times::time, requires = "from_time")]
    until: Option<i64>,
    /// Step between the departures [default: 60s, or longer for more than 1,000 departures]
    #[arg(long, value_name = "DURATION", value_parser = times::duration, requires = "from_time")]
    step: Option<i64>,
    /// Objective of the route [default: success, or time with --avoid]
    #[arg(long, value_name = "WHAT")]
    objective: Option<ObjectiveArg>,
    /// Weight between time (0) and success (1), with --objective blend
    #[arg(long, value_name = "W", default_value_t = 0.5, allow_hyphen_values = true)]
    doubt: f64,
    /// Time to recover from a failed attempt, seconds [default: 60]
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true)]
    recovery: Option<f64>,
    /// Cost of a failure, seconds, with --objective blend [default: 600]
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true)]
    failure_cost: Option<f64>,
    /// Number of alternative routes, at most 10
    #[arg(long, value_name = "N", default_value_t = 0)]
    alternatives: u32,
    /// Confidence of the interval from lower to upper [default: 0.9]
    #[arg(long, value_name = "P", allow_hyphen_values = true)]
    interval: Option<f64>,
    /// Maximum duration of a route [default: 1d]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    horizon: Option<i64>,
    /// Model, as in `predict`; with auto, an edge that just failed is unlikely for a while
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// Speed on edges without data, metres per second [default: 0.5]
    #[arg(long, value_name = "M/S", allow_hyphen_values = true)]
    speed: Option<f64>,
    #[command(flatten)]
    avoid: AvoidArgs,
    /// Draws the map with the route as SVG
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
}

#[derive(Debug, Args)]
struct AvoidArgs {
    /// Vector with the positions of people to avoid, as of `position --flow`
    #[arg(long, value_name = "STATE", requires = "flow")]
    avoid: Option<String>,
    /// State with the direction of these people: an angle, or a vector with their velocity
    #[arg(long, value_name = "STATE", requires = "avoid")]
    flow: Option<String>,
    /// Value of avoiding an encounter, seconds: a second near a person, if people are detected once a second [default:
    /// 10]
    #[arg(long, value_name = "SECONDS", requires = "avoid", allow_hyphen_values = true)]
    encounter_cost: Option<f64>,
    /// People within this distance are near, metres [default: 1]
    #[arg(long, value_name = "M", requires = "avoid", allow_hyphen_values = true)]
    near: Option<f64>,
    /// Edge of a cell in which people are counted, metres [default: 1, or more for a large region]
    #[arg(long, value_name = "M", requires = "avoid", allow_hyphen_values = true)]
    resolution: Option<f64>,
}

impl AvoidArgs {
    fn people(self) -> Option<AvoidedPeople> {
        let (state, motion_state) = self.avoid.zip(self.flow)?;
        Some(AvoidedPeople {
            source: source(state, motion_state, None, self.resolution, None),
            encounter_cost_secs: self.encounter_cost.unwrap_or(10.0),
            near_m: self.near.unwrap_or(1.0),
        })
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ObjectiveArg {
    /// Maximum probability that nothing fails
    Success,
    /// Minimum expected time, with failures and recovery
    Time,
    /// A blend of both, by --doubt
    Blend,
}

#[derive(Debug, Args)]
pub(crate) struct PolicyArgs {
    /// Name of the map
    map: String,
    /// Name of the node to reach
    to: String,
    /// Start of the policy
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: i64,
    /// Horizon of the policy [default: 1d]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    horizon: Option<i64>,
    /// Length of a slot [default: 15m]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    slot: Option<i64>,
    /// Objective of the policy
    #[arg(long, value_name = "WHAT", default_value = "success")]
    objective: PolicyObjectiveArg,
    /// Time to recover from a failed attempt, seconds [default: 60]
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true)]
    recovery: Option<f64>,
    /// Model, as in `predict`
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// Speed on edges without data, metres per second [default: 0.5]
    #[arg(long, value_name = "M/S", allow_hyphen_values = true)]
    speed: Option<f64>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum PolicyObjectiveArg {
    /// Maximum probability of arriving before the last slot ends
    Success,
    /// Minimum expected time
    Time,
}

const COLUMNS: [&str; 13] = [
    "step",
    "from",
    "to",
    "probability",
    "duration_secs",
    "action",
    "start",
    "lower",
    "upper",
    "reports",
    "route",
    "expected_secs",
    "pending_reports",
];
const POLICY_COLUMNS: [&str; 6] = ["slot", "node", "next", "action", "expected_secs", "probability"];

pub(crate) async fn run(session: &Session, args: RouteArgs) -> anyhow::Result<ExitCode> {
    let when = match (args.at, args.arrive, args.from_time, args.until) {
        (Some(at), ..) => RouteTime::Depart(at),
        (None, Some(by), ..) => RouteTime::ArriveBy(by),
        (None, None, Some(from_nanos), Some(to_nanos)) => {
            RouteTime::DepartWithin { from_nanos, to_nanos, step_nanos: args.step }
        }
        _ => return Err(usage("give the time with --at, --arrive, or --from with --to")),
    };
    files::check_picture(args.picture.as_deref())?;
    let avoids = args.avoid.avoid.is_some();
    let usual = if avoids { ObjectiveArg::Time } else { ObjectiveArg::Success };
    let query = RouteQuery {
        objective: match args.objective.unwrap_or(usual) {
            ObjectiveArg::Success => Objective::Success,
            ObjectiveArg::Time => Objective::Time,
            ObjectiveArg::Blend => Objective::Blend { weight: args.doubt },
        },
        recovery_secs: args.recovery,
        failure_cost_secs: args.failure_cost,
        alternatives: args.alternatives,
        confidence: args.interval,
        horizon_nanos: args.horizon,
        model: args.model,
        speed_m_per_s: args.speed,
        avoided: args.avoid.people(),
        ..RouteQuery::new(&args.map, &args.from, &args.to, when)
    };
    let (routes, certainty) = session.client.plan_route(query).await?;
    let columns: Vec<&str> = COLUMNS.into_iter().chain(avoids.then_some("encounters")).collect();
    let mut table = session.table(&columns);
    for (number, route) in (1_u64..).zip(&routes) {
        for (index, step) in (1_u64..).zip(&route.steps) {
            let mut row = vec![
                Cell::Count(index),
                step.edge.from.as_str().into(),
                step.edge.to.as_str().into(),
                step.success.into(),
                step.duration_secs.into(),
                step.edge.action.as_ref().map_or("", StateName::as_str).into(),
                Cell::Time(step.start_nanos),
                step.success_interval[0].into(),
                step.success_interval[1].into(),
                step.reports.into(),
                Cell::Count(number),
                route.expected_secs.into(),
                step.pending_reports.into(),
            ];
            row.extend(avoids.then(|| step.encounters.into()));
            table.row(row)?;
        }
    }
    table.finish()?;
    for (number, route) in (1..).zip(&routes) {
        let met = if avoids { format!("; {:.2} encounters expected", route.encounters) } else { String::new() };
        status_line(&format!("{}{met}", summary(number, route, routes.len())));
    }
    status_line(match certainty {
        Certainty::Proven => "no route is better",
        Certainty::WithinResolution => {
            "no route is better, except that routes that arrive within the same second were not compared"
        }
        Certainty::Sampled => "no better route was found; edges were predicted at few times, so this is no proof",
        Certainty::CutOff => "the time limit was reached: there may be better routes",
    });
    if let (Some(path), Some(best)) = (&args.picture, routes.first()) {
        let way = best.steps.iter().map(|step| step.edge.clone()).collect();
        let overlay = Overlay { way, ..Overlay::default() };
        let picture =
            topology_picture::draw(session, &args.map, best.departure_nanos, args.model, args.speed, "", overlay)
                .await?;
        files::write(path, picture)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn summary(number: usize, route: &NamedRoute, routes: usize) -> String {
    let [lower, upper] = route.success_interval;
    let secs = (route.arrival_nanos - route.departure_nanos) as f64 / 1e9;
    let which = if routes > 1 { format!("route {number}: ") } else { String::new() };
    format!(
        "{which}passes with probability {:.3} ({lower:.3} to {upper:.3}); {secs:.1} s without failures, {:.1} s \
         expected; departure {}",
        route.success,
        route.expected_secs,
        route.departure_nanos.div_euclid(1_000_000_000)
    )
}

pub(crate) async fn policy(session: &Session, args: PolicyArgs) -> anyhow::Result<ExitCode> {
    let query = PolicyQuery {
        map: args.map,
        to: args.to,
        time_nanos: args.at,
        horizon_nanos: args.horizon,
        slot_nanos: args.slot,
        objective: match args.objective {
            PolicyObjectiveArg::Success => Objective::Success,
            PolicyObjectiveArg::Time => Objective::Time,
        },
        recovery_secs: args.recovery,
        model: args.model,
        speed_m_per_s: args.speed,
    };
    let policy = session.client.plan_policy(query).await?;
    let mut table = session.table(&POLICY_COLUMNS);
    for (node, entries) in &policy.nodes {
        for (slot, entry) in (0_i64..).zip(entries) {
            let (action, edge) = match &entry.action {
                PolicyAction::Take(edge) => ("take", Some(edge)),
                PolicyAction::Wait => ("wait", None),
                PolicyAction::Nothing => ("nothing", None),
                PolicyAction::Arrived => ("arrived", None),
            };
            let by = |EdgeName { action: by, .. }: &EdgeName| {
                by.as_ref().map_or_else(|| action.to_owned(), |by| format!("{action}:{by}"))
            };
            table.row(vec![
                Cell::Time(policy.time_nanos.saturating_add(slot.saturating_mul(policy.slot_nanos))),
                node.as_str().into(),
                Cell::maybe(edge.map(|edge| edge.to.as_str())),
                Cell::Text(edge.map_or_else(|| action.to_owned(), by)),
                Cell::maybe(Some(entry.expected_secs).filter(|secs| secs.is_finite())),
                entry.reach.into(),
            ])?;
        }
    }
    table.finish()?;
    Ok(ExitCode::SUCCESS)
}
