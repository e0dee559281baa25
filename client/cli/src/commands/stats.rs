//! `tidemap stats`.
//!
//! Invariant: counters have the names that the daemon gives them.

use std::process::ExitCode;

use clap::Args;

use tidemap_client::updates::Statistic;

use super::Session;
use tidemap_formats::table::Cell;

#[derive(Debug, Args)]
pub(crate) struct StatsArgs {
    /// Name of the map [default: the whole daemon]
    map: Option<String>,
}

pub(crate) async fn run(session: &Session, args: &StatsArgs) -> anyhow::Result<ExitCode> {
    let statistics = session.client.statistics(args.map.as_deref().unwrap_or("")).await?;
    let row =
        |statistic: Statistic| vec![Cell::Text(statistic.name), statistic.value.into(), Cell::Text(statistic.unit)];
    session.print(&["name", "value", "unit"], statistics.into_iter().map(row))
}
