//! `tidemap presence` and `tidemap joint`: the presence of a target at each node, and the next time when all of several
//! states are likely 1.
//!
//! Invariant: rows are in the order of the times, the most probable node first; nodes without observations go to
//! stderr.

use std::process::ExitCode;

use clap::Args;
use tidemap_client::{
    queries::ModelSelector,
    routes::{JointQuery, PresenceAt, PresenceQuery},
};

use super::{Session, times};
use crate::progress::status_line;
use tidemap_formats::table::Cell;

#[derive(Debug, Args)]
pub(crate) struct PresenceArgs {
    /// Name of the map
    map: String,
    /// Times, separated by commas
    #[arg(long, required = true, value_name = "TIME,…", value_parser = times::time, value_delimiter = ',')]
    at: Vec<i64>,
    /// Kind of target, by the states node/NODE/KIND [default: the states named like the nodes]
    #[arg(long, value_name = "KIND", default_value = "", hide_default_value = true)]
    object: String,
    /// Model, as in `predict`
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
}

#[derive(Debug, Args)]
pub(crate) struct JointArgs {
    /// Name of the map
    map: String,
    /// Names of the states, such as node/Kitchen/cup
    #[arg(required = true, value_name = "STATE")]
    states: Vec<String>,
    /// Start of the search
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    from: i64,
    /// Length of the search [default: 7d]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    within: Option<i64>,
    /// Step between the times that are checked [default: 10m]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    step: Option<i64>,
    /// Minimum product of the probabilities, 0 to 1 [default: 0.5]
    #[arg(long, value_name = "P", allow_hyphen_values = true)]
    threshold: Option<f64>,
    /// Model, as in `predict`
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
}

const COLUMNS: [&str; 5] = ["time", "node", "probability", "share", "anybody"];
const JOINT_COLUMNS: [&str; 2] = ["time", "probability"];

pub(crate) async fn run(session: &Session, args: PresenceArgs) -> anyhow::Result<ExitCode> {
    let PresenceArgs { map, at, object, model } = args;
    let presence = session.client.predict_presence(PresenceQuery { map, object, times_nanos: at, model }).await?;
    let rows = |PresenceAt { time_nanos, probabilities, shares, anybody }: &PresenceAt| {
        let mut order: Vec<usize> = (0..presence.nodes.len().min(probabilities.len())).collect();
        order.sort_by(|&one, &other| probabilities[other].total_cmp(&probabilities[one]));
        let row = |node: usize| {
            let (name, share) = (presence.nodes[node].as_str().into(), Cell::maybe(shares.get(node).copied()));
            vec![Cell::Time(*time_nanos), name, probabilities[node].into(), share, (*anybody).into()]
        };
        order.into_iter().map(row).collect::<Vec<_>>()
    };
    session.print(&COLUMNS, presence.times.iter().flat_map(rows))?;
    if !presence.unobserved.is_empty() {
        let shown = presence.unobserved.iter().take(10).map(String::as_str).collect::<Vec<_>>().join(", ");
        let more = if presence.unobserved_nodes > 10 { ", …" } else { "" };
        status_line(&format!("never observed ({}): {shown}{more}", presence.unobserved_nodes));
    }
    Ok(ExitCode::SUCCESS)
}

pub(crate) async fn joint(session: &Session, args: JointArgs) -> anyhow::Result<ExitCode> {
    let JointArgs { map, states, from, within, step, threshold, model } = args;
    let query = JointQuery { map, states, from_nanos: from, within_nanos: within, step_nanos: step, threshold, model };
    let joint = session.client.next_joint(query).await?;
    let row = joint.time_nanos.map(|time_nanos| vec![Cell::Time(time_nanos), joint.probability.into()]);
    session.print(&JOINT_COLUMNS, row)?;
    if joint.time_nanos.is_none() {
        let at = joint.best_nanos.div_euclid(1_000_000_000);
        status_line(&format!("at no time: the greatest probability is {:.3}, at {at}", joint.probability));
    }
    Ok(ExitCode::SUCCESS)
}
