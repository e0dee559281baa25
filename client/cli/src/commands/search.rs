//! `tidemap search`.
//!
//! Invariant: rows are in the order of the search; nodes that are left out, and the reason, go to stderr.

use std::{path::PathBuf, process::ExitCode};

use clap::{Args, ValueEnum};
use tidemap_client::{
    queries::ModelSelector,
    routes::{EdgeName, Effort, Search, SearchQuery, SearchStep, StopReason},
};

use super::{
    Session, files, times,
    topology_picture::{self, Overlay},
};
use crate::progress::status_line;
use tidemap_formats::table::Cell;

#[derive(Debug, Args)]
pub(crate) struct SearchArgs {
    /// Name of the map
    map: String,
    /// Name of the node where the robot is
    #[arg(long, value_name = "NODE")]
    start: String,
    /// Start of the search
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: i64,
    /// Kind of target, by the states node/NODE/KIND [default: the states named like the nodes]
    #[arg(long, value_name = "KIND", default_value = "", hide_default_value = true)]
    object: String,
    /// Maximum duration of the search; nodes that do not fit are left out
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    budget: Option<i64>,
    /// Method that chooses the order
    #[arg(long, value_name = "EFFORT", default_value = "auto")]
    effort: EffortArg,
    /// Time limit of the planning, at most 60s [default: 2s]
    #[arg(long, value_name = "DURATION", value_parser = times::duration_or_none)]
    plan_within: Option<i64>,
    /// Stops when less than this share of the probability remains, 0 to 1
    #[arg(long, value_name = "P", allow_hyphen_values = true)]
    remains_below: Option<f64>,
    /// Stops when the search is not worth its time: the cost of a second, relative to the value of finding the target
    #[arg(long, value_name = "COST", allow_hyphen_values = true)]
    cost_per_second: Option<f64>,
    /// Predicts each node for the robot's arrival there
    #[arg(long)]
    for_arrival: bool,
    /// Model, as in `predict`
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// Minimum probability of a node [default: 1e-6]
    #[arg(long, value_name = "P", allow_hyphen_values = true)]
    floor: Option<f64>,
    /// Speed on edges that have a length only, metres per second [default: 0.5]
    #[arg(long, value_name = "M/S", allow_hyphen_values = true)]
    speed: Option<f64>,
    /// Seed of the random numbers
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Uses the durations learned from reports, as in `topology predict`, instead of those of the loaded map
    #[arg(long)]
    as_travelled: bool,
    /// Draws the map with the search route as SVG
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum EffortArg {
    /// The best order for up to 40 nodes, a good one for more
    Auto,
    /// The best order; more than 40 nodes are refused
    Exact,
    /// A good order
    Heuristic,
}

const COLUMNS: [&str; 5] = ["step", "node", "arrival_secs", "probability", "expected_secs"];

pub(crate) async fn run(session: &Session, args: SearchArgs) -> anyhow::Result<ExitCode> {
    files::check_picture(args.picture.as_deref())?;
    let query = SearchQuery {
        map: args.map.clone(),
        start: args.start,
        time_nanos: args.at,
        object: args.object.clone(),
        budget_nanos: args.budget,
        effort: match args.effort {
            EffortArg::Auto => Effort::Auto,
            EffortArg::Exact => Effort::Exact,
            EffortArg::Heuristic => Effort::Heuristic,
        },
        plan_within_nanos: args.plan_within,
        remains_below: args.remains_below,
        cost_per_sec: args.cost_per_second,
        for_arrival: args.for_arrival,
        model: args.model,
        floor: args.floor,
        speed_m_per_s: args.speed,
        seed: args.seed,
        as_travelled: args.as_travelled,
    };
    let search = session.client.plan_search(query).await?;
    let row = |(step, SearchStep { node, arrival_secs, probability }): (u64, &SearchStep<String>)| {
        let [arrival, probability, expected] = [*arrival_secs, *probability, search.expected_secs].map(Cell::from);
        vec![Cell::Count(step), node.as_str().into(), arrival, probability, expected]
    };
    session.print(&COLUMNS, (1_u64..).zip(&search.steps).map(row))?;
    summary(&search).iter().for_each(|line| status_line(line));
    if let Some(path) = &args.picture {
        let way = search.walk.windows(2).map(|pair| EdgeName::new(&pair[0].0, &pair[1].0, ""));
        let numbered = search.steps.iter().map(|step| step.node.clone()).collect();
        let overlay = Overlay { way: way.collect::<Result<_, _>>()?, any_action: true, numbered };
        let drawn =
            topology_picture::draw(session, &args.map, args.at, args.model, args.speed, &args.object, overlay).await?;
        files::write(path, drawn)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The summary of a search.
fn summary(search: &Search) -> Vec<String> {
    let Search { expected_secs, lower_bound_secs, remains, .. } = search;
    let proof = if search.optimal {
        "no order is better".to_owned()
    } else {
        format!("no order is faster than {lower_bound_secs:.1} s")
    };
    let mut lines = vec![format!("{expected_secs:.1} s expected; {proof}")];
    lines.extend(search.stop.map(|stop| {
        let why = match stop {
            StopReason::Unlikely => "little remains",
            StopReason::NotWorthIt => "the rest is not worth the time",
            StopReason::OutOfTime => "the rest does not fit into the budget",
        };
        format!("the search ends early: {why}")
    }));
    if *remains > 0.0 {
        lines.push(format!("{:.2} % of the probability is at places that are not visited", 100.0 * remains));
    }
    let named = |names: &[String], all: usize| {
        let shown = names.iter().take(10).map(String::as_str).collect::<Vec<_>>().join(", ");
        if all > 10 { format!("{shown}, … ({all} in all)") } else { shown }
    };
    if !search.unreachable.is_empty() {
        lines.push(format!("no way leads to: {}", named(&search.unreachable, search.unreachable.len())));
    }
    if !search.unobserved.is_empty() {
        lines.push(format!("never observed: {}", named(&search.unobserved, search.unobserved_nodes as usize)));
    }
    lines
}
