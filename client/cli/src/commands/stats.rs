//! `tidemap stats`.
//!
//! Invariant: counters have the names that the daemon gives them.

use std::process::ExitCode;

use clap::Args;

use super::Session;
use tidemap_formats::table::Cell;

#[derive(Debug, Args)]
pub(crate) struct StatsArgs {
    /// Name of the map [default: the whole daemon]
    map: Option<String>,
}

pub(crate) async fn run(session: &Session, args: &StatsArgs) -> anyhow::Result<ExitCode> {
    let statistics = session.client.statistics(args.map.as_deref().unwrap_or("")).await?;
    let mut table = session.table(&["name", "value", "unit"]);
    for statistic in statistics {
        table.row(vec![Cell::Text(statistic.name), statistic.value.into(), Cell::Text(statistic.unit)])?;
    }
    table.finish()?;
    Ok(ExitCode::SUCCESS)
}
