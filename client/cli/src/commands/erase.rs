//! `tidemap erase`.
//!
//! Invariant: the command succeeds only when the erasure is complete.

use std::process::ExitCode;

use clap::Args;
use tidemap_client::updates::{Erasure, Job, JobState};
use tidemap_formats::table::Cell;

use super::{Session, job, times, usage};

#[derive(Debug, Args)]
pub(crate) struct EraseArgs {
    /// Name of the map
    map: String,
    /// Name of the state; a position or an angle is erased with all its axes [default: all states]
    #[arg(long, value_name = "STATE", required_unless_present_any = ["producer", "from", "to"])]
    state: Option<String>,
    /// Only the observations of this producer
    #[arg(long, value_name = "ID")]
    producer: Option<String>,
    /// Only the observations that it sent with this label, which is the base name of a file [default: all its labels]
    #[arg(long, value_name = "LABEL", requires = "producer")]
    label: Option<String>,
    /// Only from this time on
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    from: Option<i64>,
    /// Only before this time
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    to: Option<i64>,
}

const COLUMNS: [&str; 5] = ["map", "state", "states", "elapsed_secs", "observations"];

pub(crate) async fn run(session: &Session, args: &EraseArgs) -> anyhow::Result<ExitCode> {
    if let Some((from, to)) = args.from.zip(args.to)
        && from >= to
    {
        return Err(usage("--from must be before --to, which is not included"));
    }
    let what = Erasure {
        state: args.state.clone(),
        producer: args.producer.clone(),
        label: args.label.clone(),
        from_nanos: args.from,
        to_nanos: args.to,
        forget_sequence: false,
    };
    let is_part = args.producer.is_some() || args.from.is_some() || args.to.is_some();
    let ended = run_to_end(session, &args.map, what).await?;
    let row = vec![
        Cell::Text(ended.map),
        Cell::Text(args.state.clone().unwrap_or_default()),
        ended.states_total.into(),
        Cell::Secs(ended.elapsed_nanos),
        // The observations of a whole state are not counted.
        if is_part { ended.observations.into() } else { Cell::Empty },
    ];
    session.print(&COLUMNS, [row])
}

/// Erases, and waits for the end.
pub(super) async fn run_to_end(session: &Session, map: &str, what: Erasure) -> anyhow::Result<Job> {
    let started = session.client.erase_part(map, what).await?;
    let ended = job::watch(&session.client, started.id).await?;
    if ended.state == JobState::Failed {
        anyhow::bail!(job::failure(&ended));
    }
    Ok(ended)
}
