//! `tidemap topology reachable`: the best route from one node to each other, in a list.
//!
//! Invariant: each node comes once, the most certain first; nodes without a route come last.

use std::process::ExitCode;

use clap::Args;
use tidemap_client::{
    queries::ModelSelector,
    routes::{ReachableNode, ReachableQuery, StateName},
};
use tidemap_formats::table::Cell;

use super::{Session, times, usage};
use crate::progress::status_line;

/// Maximum number of nodes: each is a search of its own.
const NODES_MAX: usize = 200;
const COLUMNS: [&str; 6] = ["node", "probability", "lower", "upper", "expected_secs", "edges"];

#[derive(Debug, Args)]
pub(crate) struct ReachableArgs {
    /// Name of the map
    map: String,
    /// Name of the node where the robot is
    #[arg(value_parser = StateName::new)]
    from: StateName,
    /// Names of the nodes to list, at most 200 [default: all]
    #[arg(value_name = "TO", value_parser = StateName::new)]
    nodes: Vec<StateName>,
    /// Time of departure
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: i64,
    /// Maximum duration of a route [default: 1d]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    horizon: Option<i64>,
    /// Model, as in `predict`
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// Speed on edges without data, metres per second [default: 0.5]
    #[arg(long, value_name = "M/S", allow_hyphen_values = true)]
    speed: Option<f64>,
}

pub(crate) async fn run(session: &Session, args: ReachableArgs) -> anyhow::Result<ExitCode> {
    let ReachableArgs { map, from, nodes, at, horizon, model, speed } = args;
    let mut nodes: Vec<String> = nodes.iter().map(|node| node.as_str().to_owned()).collect();
    if nodes.is_empty() {
        let topology = session.client.topology(&map).await?;
        nodes = topology.nodes().map(|node| node.name.as_str().to_owned()).collect();
    }
    nodes.sort_unstable();
    nodes.dedup();
    if nodes.len() > NODES_MAX {
        return Err(usage(format!("{} nodes: name those to list, at most {NODES_MAX}", nodes.len())));
    }
    let query = ReachableQuery {
        map,
        from: from.as_str().to_owned(),
        nodes,
        at_nanos: at,
        horizon_nanos: horizon,
        model,
        speed_m_per_s: speed,
    };
    let found = session.client.reachable_nodes(query).await?;
    let cut_off = found.iter().filter(|node| node.is_cut_off).count();
    let row = |node: ReachableNode| {
        let [lower, upper] = node.success_interval.map_or([None; 2], |ends| ends.map(Some)).map(Cell::maybe);
        let edges = (node.edges as u64).into();
        vec![node.node.as_str().into(), node.success.into(), lower, upper, Cell::maybe(node.expected_secs), edges]
    };
    let code = session.print(&COLUMNS, found.into_iter().map(row))?;
    if cut_off > 0 {
        status_line(&format!("the time limit was reached for {cut_off} nodes: there may be better routes"));
    }
    Ok(code)
}
