//! `tidemap erase`.
//!
//! Invariant: the command succeeds only when the erasure is complete.

use std::process::ExitCode;

use clap::Args;
use tidemap_client::updates::JobState;
use tidemap_formats::table::Cell;

use super::{Session, job};

#[derive(Debug, Args)]
pub(crate) struct EraseArgs {
    /// Name of the map
    map: String,
    /// Name of the state; a position or an angle is erased with all its axes
    #[arg(long, value_name = "STATE")]
    state: String,
}

const COLUMNS: [&str; 4] = ["map", "state", "states", "elapsed_secs"];

pub(crate) async fn run(session: &Session, args: &EraseArgs) -> anyhow::Result<ExitCode> {
    let started = session.client.erase(&args.map, &args.state).await?;
    let ended = job::watch(&session.client, started.id).await?;
    if ended.state == JobState::Failed {
        anyhow::bail!(job::failure(&ended));
    }
    let elapsed = Cell::Secs(ended.elapsed_nanos);
    let row = vec![Cell::Text(ended.map), Cell::Text(args.state.clone()), ended.states_total.into(), elapsed];
    session.print(&COLUMNS, [row])
}
