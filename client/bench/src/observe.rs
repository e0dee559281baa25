//! `tidemap-bench observe`.
//!
//! Invariant: all times differ, and half of the values are 1, so that the data does not compress.

use clap::Args;
use tidemap_client::{
    Client,
    maps::{EnabledModels, NewMap},
    observe::columns::Entry,
};
use tidemap_formats::table::Cell;
use tidemap_model::time::NANOS_PER_SEC;

use super::{
    DaemonProcess, Figures,
    load::{Load, scrambled},
    machine::CpuTimes,
    updated,
};

use tidemap_cli::enabled_models;
use tidemap_terminal::progress::status_line;

#[derive(Debug, Args)]
pub(crate) struct ObserveBenchArgs {
    /// Number of concurrent streams
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    streams: u64,
    /// Number of states
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    states: u64,
    /// Length of a state's name, in characters
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u8).range(9..=128))]
    name_chars: u8,
    /// Number of observations
    #[arg(long, value_name = "N", default_value_t = 20_000_000, value_parser = clap::value_parser!(u64).range(1..=10_000_000_000))]
    observations: u64,
    /// Observations per message
    #[arg(long, value_name = "N", default_value_t = 4096, value_parser = clap::value_parser!(u64).range(1..))]
    batch: u64,
    /// Models that the update selects from, as of `map create` [default: those of a new map]
    #[arg(long, value_name = "MODEL,…", value_parser = enabled_models)]
    models: Option<EnabledModels>,
    /// Does not delete the map
    #[arg(long)]
    keep: bool,
    #[command(flatten)]
    process: DaemonProcess,
}

impl ObserveBenchArgs {
    pub(super) fn keeps(&self) -> bool {
        self.keep
    }

    pub(super) fn new_map(&self, name: String) -> NewMap {
        NewMap { name, models: self.models, ..NewMap::default() }
    }
}

/// 2020-01-01T00:00:00Z.
const START_NANOS: i64 = 1_577_836_800 * NANOS_PER_SEC;
/// Time between two observations: 20 million take a month.
const STEP_NANOS: i64 = NANOS_PER_SEC / 8;
const MICRO_NANOS: i64 = 1_000;

pub(super) async fn run(client: &Client, map: &str, args: &ObserveBenchArgs) -> anyhow::Result<Figures> {
    let load = Load {
        map: map.to_owned(),
        streams: args.streams,
        states: args.states,
        name_chars: usize::from(args.name_chars),
        observations: args.observations,
        batch: args.batch,
        observation,
    };
    status_line(&format!("sending {} observations on {} streams to map {map}", args.observations, args.streams));
    let before = CpuTimes::now(args.process);
    let rate = load.send(client).await?;
    let sent = CpuTimes::now(args.process);
    let job = updated(client, map).await?;
    let after = CpuTimes::now(args.process);
    let secs = rate.elapsed.as_secs_f64();
    Ok(vec![
        ("streams", args.streams.into()),
        ("states", args.states.into()),
        ("observations", args.observations.into()),
        ("batch", args.batch.into()),
        ("refused", rate.refused.into()),
        ("secs", secs.into()),
        ("observations_per_sec", (args.observations as f64 / secs).round().into()),
        ("feeder_cpu_secs", sent.feeder_since(before)),
        ("daemon_cpu_secs", sent.daemon_since(before)),
        ("update_observations", job.observations.into()),
        ("update_secs", Cell::Secs(job.elapsed_nanos)),
        ("update_daemon_cpu_secs", after.daemon_since(sent)),
    ])
}

/// Times in order with some jitter; pseudo-random states and values.
fn observation(load: &Load, number: u64) -> Entry {
    let bits = scrambled(number);
    let jitter = i64::try_from(bits % 120_000).unwrap_or(0) * MICRO_NANOS;
    let time_nanos = START_NANOS + i64::try_from(number).unwrap_or(0) * STEP_NANOS + jitter;
    let state = u32::try_from((bits >> 20) % load.states).unwrap_or(0);
    Entry { state, time_nanos, value: if bits >> 63 == 1 { 1.0 } else { 0.0 }, position: None }
}
