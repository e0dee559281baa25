//! `tidemap route` and `tidemap policy`: the way from one node to another at a time, and what to do after a failure.
//!
//! Invariant: rows come by route from the best, then by step; how sure it is that none is better goes to stderr.

use std::{path::PathBuf, process::ExitCode};

use clap::{ArgGroup, Args, ValueEnum};
use tidemap_client::{
    queries::ModelSelector,
    routes::{Certainty, EdgeEnds, Objective, PolicyAction, PolicyQuery, Route, RouteQuery, RouteTime},
};

use super::{
    Session, files, times,
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
    /// Name of the node where it wants to be
    to: String,
    /// When it leaves
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: Option<i64>,
    /// When it has to be there; it leaves as late as it can
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    arrive: Option<i64>,
    /// First of the departures among which the best is chosen
    #[arg(long = "from", value_name = "TIME", value_parser = times::time, requires = "until")]
    from_time: Option<i64>,
    /// Last of them
    #[arg(long = "to", value_name = "TIME", value_parser = times::time, requires = "from_time")]
    until: Option<i64>,
    /// Their distance [default: 60s, or as much more as makes a thousand]
    #[arg(long, value_name = "DURATION", value_parser = times::duration, requires = "from_time")]
    step: Option<i64>,
    /// What the route is best at
    #[arg(long, value_name = "WHAT", default_value = "success")]
    objective: ObjectiveArg,
    /// Between time (0) and success (1), with --objective blend
    #[arg(long, value_name = "W", default_value_t = 0.5, allow_hyphen_values = true)]
    doubt: f64,
    /// What a failed attempt costs beside its own time, seconds [default: 60]
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true)]
    recovery: Option<f64>,
    /// What a failure costs, seconds, with --objective blend [default: 600]
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true)]
    failure_cost: Option<f64>,
    /// How many next best routes to tell, at most 10
    #[arg(long, value_name = "N", default_value_t = 0)]
    alternatives: u32,
    /// How likely lower to upper holds the probability [default: 0.9]
    #[arg(long, value_name = "P", allow_hyphen_values = true)]
    interval: Option<f64>,
    /// No route takes longer [default: 1d]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    horizon: Option<i64>,
    /// Model, as in `predict`; with +persistence an edge that has just failed counts as unlikely for a while
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// How fast the robot drives where nothing is known, metres a second [default: 0.5]
    #[arg(long, value_name = "M/S", allow_hyphen_values = true)]
    speed: Option<f64>,
    /// Draws the map with the route, as SVG
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ObjectiveArg {
    /// The greatest chance that nothing fails
    Success,
    /// The least expected time, failures and recovery included
    Time,
    /// Between them, by --doubt
    Blend,
}

#[derive(Debug, Args)]
pub(crate) struct PolicyArgs {
    /// Name of the map
    map: String,
    /// Name of the node to reach
    to: String,
    /// When it begins
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: i64,
    /// How far it looks ahead [default: 1d]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    horizon: Option<i64>,
    /// How long a slot is [default: 15m]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    slot: Option<i64>,
    /// What the policy is best at
    #[arg(long, value_name = "WHAT", default_value = "success")]
    objective: PolicyObjectiveArg,
    /// What a failed attempt costs beside its own time, seconds [default: 60]
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true)]
    recovery: Option<f64>,
    /// Model, as in `predict`
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// How fast the robot drives where nothing is known, metres a second [default: 0.5]
    #[arg(long, value_name = "M/S", allow_hyphen_values = true)]
    speed: Option<f64>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum PolicyObjectiveArg {
    /// To be there before the last slot ends
    Success,
    /// The least expected time
    Time,
}

const COLUMNS: [&str; 12] = [
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
];
const POLICY_COLUMNS: [&str; 6] = ["slot", "node", "next", "action", "expected_secs", "probability"];

pub(crate) async fn run(session: &Session, args: RouteArgs) -> anyhow::Result<ExitCode> {
    let when = match (args.at, args.arrive, args.from_time, args.until) {
        (Some(at), ..) => RouteTime::Depart(at),
        (None, Some(by), ..) => RouteTime::ArriveBy(by),
        (None, None, Some(from_nanos), Some(to_nanos)) => {
            RouteTime::DepartWithin { from_nanos, to_nanos, step_nanos: args.step }
        }
        _ => return Err(usage("say when: --at, --arrive, or --from with --to")),
    };
    files::check_picture(args.picture.as_deref())?;
    let query = RouteQuery {
        objective: match args.objective {
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
        ..RouteQuery::new(&args.map, &args.from, &args.to, when)
    };
    let (routes, certainty) = session.client.plan_route(query).await?;
    let mut table = session.table(&COLUMNS);
    for (number, route) in (1_u64..).zip(&routes) {
        for (index, step) in (1_u64..).zip(&route.steps) {
            table.row(vec![
                Cell::Count(index),
                step.edge.from.as_str().into(),
                step.edge.to.as_str().into(),
                step.success.into(),
                step.duration_secs.into(),
                step.edge.action.as_str().into(),
                Cell::Secs(step.start_nanos),
                step.success_interval[0].into(),
                step.success_interval[1].into(),
                step.reports.into(),
                Cell::Count(number),
                route.expected_secs.into(),
            ])?;
        }
    }
    table.finish()?;
    for (number, route) in (1..).zip(&routes) {
        status_line(&summary(number, route, routes.len()));
    }
    status_line(match certainty {
        Certainty::Proven => "no route is better",
        Certainty::WithinResolution => "no route is better, but for ways that arrive within a second of each other",
        Certainty::Sampled => "no route is better by edges predicted at a few times; that is no proof",
        Certainty::CutOff => "the time was up: there may be better routes",
    });
    if let (Some(path), Some(best)) = (&args.picture, routes.first()) {
        let way = best.steps.iter().map(|step| step.edge.clone());
        let way = way.map(|EdgeEnds { from, to, action, .. }| (from, to, Some(action))).collect();
        let overlay = Overlay { way, numbered: Vec::new() };
        let picture =
            topology_picture::draw(session, &args.map, best.departure_nanos, args.model, args.speed, "", overlay)
                .await?;
        files::write(path, picture)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn summary(number: usize, route: &Route, routes: usize) -> String {
    let [lower, upper] = route.success_interval;
    let secs = (route.arrival_nanos - route.departure_nanos) as f64 / 1e9;
    let which = if routes > 1 { format!("route {number}: ") } else { String::new() };
    format!(
        "{which}passes with probability {:.3} ({lower:.3} to {upper:.3}); {secs:.1} s if all goes well, {:.1} s to expect; \
         departure {}",
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
            let by = |EdgeEnds { action: by, .. }: &EdgeEnds| {
                if by.is_empty() { action.to_owned() } else { format!("{action}:{by}") }
            };
            table.row(vec![
                Cell::Secs(policy.time_nanos.saturating_add(slot.saturating_mul(policy.slot_nanos))),
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
