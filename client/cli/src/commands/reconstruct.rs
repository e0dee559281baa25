//! `tidemap reconstruct`.
//!
//! Invariant: the exact observations, one per row, in the order of their times; each is written as soon as it arrives.

use std::process::ExitCode;

use clap::Args;

use super::{
    Session,
    times::{self, When},
    usage,
};
use tidemap_formats::table::Cell;
use tidemap_model::Zone;

#[derive(Debug, Args)]
pub(crate) struct ReconstructArgs {
    /// Name of the map
    map: String,
    /// Name of the state, or cell/X/Y/Z
    state: String,
    /// First time
    #[arg(long, value_name = "TIME", value_parser = times::when)]
    from: When,
    /// End of the times, not included
    #[arg(long, value_name = "TIME", value_parser = times::when)]
    to: When,
    /// Reads times without a time zone in the map's zone
    #[arg(long)]
    local: bool,
}

pub(crate) async fn run(session: &Session, args: &ReconstructArgs) -> anyhow::Result<ExitCode> {
    let ReconstructArgs { map, state, from, to, local } = args;
    let zone = match local {
        true => Some(Zone::named(&session.client.map(map).await?.time_zone)?),
        false => None,
    };
    let (from, to) = (from.resolve(zone.as_ref())?, to.resolve(zone.as_ref())?);
    if from >= to {
        return Err(usage("--from must be before --to, which is not included"));
    }
    let mut observations = session.client.reconstruct(map, state, from, to).await?;
    let mut table = session.table(&["time", "value"]);
    while let Some(seen) = observations.next().await? {
        for (time, value) in seen {
            // A sensor that reports changes or events may have no known value from then on.
            table.row(vec![Cell::Time(time), Cell::maybe((!value.is_nan()).then_some(value))])?;
        }
    }
    table.finish()?;
    Ok(ExitCode::SUCCESS)
}
