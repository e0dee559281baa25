//! `tidemap bench`: load and speed of a running daemon.
//!
//! Invariant: works through the same calls as everybody else, on a map of its own that is deleted afterwards, and puts
//! the disk's own speed beside each figure, without which figures of two machines cannot be compared.

mod latency;
mod load;
mod machine;
mod observe;
mod predict;

use std::process::{self, ExitCode};

use clap::{Args, Subcommand};
use tidemap::{Client, clock, maps::NewMap, updates::Job};

use super::{Session, job};
use crate::{
    output::{Cell, Sheet},
    progress::notice,
};

#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    /// How many observations become durable per second, and how long an update of them takes
    Observe(observe::ObserveArgs),
    /// How long an observation takes to become durable, at a given rate
    Latency(latency::LatencyArgs),
    /// How many predictions are answered per second
    Predict(predict::PredictArgs),
}

/// Which process to account for.
#[derive(Clone, Copy, Debug, Args)]
struct DaemonProcess {
    /// The daemon's process, for its CPU time [default: the one tidemapd that runs here, if it is one]
    #[arg(long, value_name = "PID")]
    daemon_pid: Option<u32>,
}

/// A row of figures with their names.
type Figures = Vec<(&'static str, Cell)>;

pub async fn run(session: &Session, command: &BenchCommand) -> anyhow::Result<ExitCode> {
    let client = &session.client;
    let map = format!("bench-{}-{}", clock::now_nanos() / 1_000_000_000, process::id());
    client.create_map(NewMap { name: map.clone(), ..NewMap::default() }).await?;
    let measured = tokio::select! {
        measured = measure(client, &map, command) => measured,
        _ = tokio::signal::ctrl_c() => Err(anyhow::anyhow!("interrupted")),
    };
    let deleted = client.delete_map(&map).await;
    let figures = measured?;
    deleted?;
    let columns: Vec<&'static str> = figures.iter().map(|(name, _)| *name).collect();
    let mut sheet = Sheet::stdout(session.format, &columns);
    sheet.row(figures.into_iter().map(|(_, cell)| cell).collect())?;
    sheet.finish()?;
    Ok(ExitCode::SUCCESS)
}

async fn measure(client: &Client, map: &str, command: &BenchCommand) -> anyhow::Result<Figures> {
    let mut figures = match command {
        BenchCommand::Observe(args) => observe::run(client, map, args).await?,
        BenchCommand::Latency(args) => latency::run(client, map, args).await?,
        BenchCommand::Predict(args) => predict::run(client, map, args).await?,
    };
    figures.extend(machine::disk(client).await?);
    Ok(figures)
}

/// Runs an update to its end.
async fn updated(client: &Client, map: &str) -> anyhow::Result<Job> {
    notice("updating");
    let started = client.run_update(map, None).await?;
    let ended = job::watched(client, started.id).await?;
    anyhow::ensure!(ended.error.is_empty(), job::failure(&ended));
    Ok(ended)
}
