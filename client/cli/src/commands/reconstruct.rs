//! `tidemap reconstruct`.
//!
//! Invariant: the exact observations, one per row, in the order of their times; each is written as soon as it arrives.

use std::process::ExitCode;

use clap::Args;

use super::{Session, times, usage};
use tidemap_formats::table::Cell;

#[derive(Debug, Args)]
pub(crate) struct ReconstructArgs {
    /// Name of the map
    map: String,
    /// Name of the state, or cell/X/Y/Z
    state: String,
    /// First time
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    from: i64,
    /// End of the times, not included
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    to: i64,
}

pub(crate) async fn run(session: &Session, args: &ReconstructArgs) -> anyhow::Result<ExitCode> {
    let ReconstructArgs { map, state, from, to } = args;
    if from >= to {
        return Err(usage("--from must be before --to, which is not included"));
    }
    let mut observations = session.client.reconstruct(map, state, *from, *to).await?;
    let mut table = session.table(&["time", "value"]);
    while let Some(seen) = observations.next().await? {
        for (time, value) in seen {
            // A sensor that reports changes or events may know no value from then on.
            table.row(vec![Cell::Time(time), Cell::maybe((!value.is_nan()).then_some(value))])?;
        }
    }
    table.finish()?;
    Ok(ExitCode::SUCCESS)
}
