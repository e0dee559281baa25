//! `tidemap-bench`: measures the speed of a running daemon.
//!
//! Invariant: a benchmark uses the public calls, on its own map that is deleted afterwards. Each result includes the
//! speed of the daemon's disk, because figures of two machines cannot be compared without it.

mod grid;
mod hall;
mod lag;
mod landmarks;
mod latencies;
mod latency;
mod load;
mod machine;
mod observe;
mod overload;
mod predict;
mod search;

use std::process::{self, ExitCode};

use clap::{Args, Parser, Subcommand};
use tidemap_cli::{ConnectionArgs, Session, failed, job_failure, watch_job, with_grid};
use tidemap_client::{Client, clock, connection::Credentials, maps::NewMap, updates::Job};
use tidemap_formats::table::Cell;
use tidemap_terminal::progress::status_line;

/// Measures a running daemon under load
///
/// Each measurement has a map of its own, which is deleted afterwards.
#[derive(Debug, Parser)]
#[command(name = "tidemap-bench", version, max_term_width = 110, arg_required_else_help = true)]
struct BenchLine {
    #[command(flatten)]
    connection: ConnectionArgs,
    #[command(subcommand)]
    command: BenchCommand,
}

#[tokio::main]
async fn main() -> ExitCode {
    let line = BenchLine::parse();
    run(&line).await.unwrap_or_else(|error| failed(&error, line.connection.prints_json()))
}

#[derive(Debug, Subcommand)]
enum BenchCommand {
    /// Measures how many observations become durable per second, and how long their update takes
    Observe(observe::ObserveBenchArgs),
    /// Measures the latency until an observation is durable, at a given rate
    Latency(latency::LatencyArgs),
    /// Measures how long another daemon of a cluster takes to show the observations that this one has acknowledged
    Lag(lag::LagArgs),
    /// Measures the predictions per second
    Predict(predict::PredictBenchArgs),
    /// Measures the latencies of answers and refusals when more requests arrive than the daemon can answer
    Overload(overload::OverloadArgs),
    /// Measures the latency of planning a search
    Search(search::SearchBenchArgs),
    /// Measures how long predictions of landmarks and finding a place by them take
    Landmarks(landmarks::LandmarkBenchArgs),
    /// Measures how fast months of scans of a whole office are learned, with an update every night
    Grid(grid::GridArgs),
    /// Compares the grid that is learned from a robot's scans with the known walls of a hall
    Hall(hall::HallArgs),
}

/// The daemon's process.
#[derive(Clone, Copy, Debug, Args)]
struct DaemonProcess {
    /// Process ID of the daemon, to measure its CPU time [default: the only tidemapd on this machine]
    #[arg(long, value_name = "PID")]
    daemon_pid: Option<u32>,
}

/// Figures and their names.
type Figures = Vec<(&'static str, Cell)>;

async fn run(BenchLine { connection, command }: &BenchLine) -> anyhow::Result<ExitCode> {
    let credentials = &connection.credentials()?;
    let session = Session::new(connection, credentials)?;
    let client = &session.client;
    let unique = format!("{}-{}", clock::now_nanos() / 1_000_000_000, process::id());
    let (new_map, keep) = match command {
        BenchCommand::Grid(args) => (args.new_map(format!("bench-grid-{unique}")), args.keeps()),
        BenchCommand::Hall(args) => (args.new_map(format!("bench-hall-{unique}")), args.keeps()),
        BenchCommand::Observe(args) => (args.new_map(format!("bench-{unique}")), args.keeps()),
        BenchCommand::Landmarks(args) => (args.new_map(format!("bench-{unique}")), false),
        _ => (NewMap { name: format!("bench-{unique}"), ..NewMap::default() }, false),
    };
    let map = new_map.name.clone();
    if let BenchCommand::Grid(args) = command {
        args.check()?;
    }
    let has_grid = new_map.grid.is_some();
    with_grid(client.create_map(new_map).await?, has_grid)?;
    let measured = tokio::select! {
        measured = measure(client, credentials, &map, command) => measured,
        _ = tokio::signal::ctrl_c() => Err(anyhow::anyhow!("interrupted")),
    };
    let deleted = if keep { Ok(()) } else { client.delete_map(&map).await };
    let figures = measured?;
    deleted?;
    let columns: Vec<&'static str> = figures.iter().map(|(name, _)| *name).collect();
    session.print(&columns, [figures.into_iter().map(|(_, cell)| cell).collect()])
}

async fn measure(
    client: &Client,
    credentials: &Credentials,
    map: &str,
    command: &BenchCommand,
) -> anyhow::Result<Figures> {
    let mut figures = match command {
        BenchCommand::Observe(args) => observe::run(client, map, args).await?,
        BenchCommand::Latency(args) => latency::run(client, map, args).await?,
        BenchCommand::Lag(args) => lag::run(client, &args.reader(client, credentials)?, map, args).await?,
        BenchCommand::Predict(args) => predict::run(client, map, args).await?,
        BenchCommand::Overload(args) => overload::run(client, map, args).await?,
        BenchCommand::Search(args) => search::run(client, map, args).await?,
        BenchCommand::Landmarks(args) => landmarks::run(client, map, args).await?,
        BenchCommand::Grid(args) => grid::run(client, map, args).await?,
        BenchCommand::Hall(args) => hall::run(client, map, args).await?,
    };
    figures.extend(machine::disk(client).await?);
    Ok(figures)
}

/// Runs an update and waits for its end.
async fn updated(client: &Client, map: &str) -> anyhow::Result<Job> {
    status_line("updating");
    let started = client.run_update(map, None).await?;
    let ended = watch_job(client, started.id).await?;
    anyhow::ensure!(ended.error.is_empty(), job_failure(&ended));
    Ok(ended)
}
