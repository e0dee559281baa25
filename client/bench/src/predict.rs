//! `tidemap-bench predict`.
//!
//! Invariant: the states are trained on weeks of periodic data, so that their models have components.

use std::time::{Duration, Instant};

use clap::Args;
use tidemap_client::{
    Client,
    observe::columns::Entry,
    queries::{ModelKind, ModelSelector, ORDER_MAX},
};
use tidemap_model::time::NANOS_PER_SEC;

use super::{
    DaemonProcess, Figures,
    load::{Load, scrambled},
    machine::CpuTimes,
    updated,
};
use tidemap_terminal::progress::status_line;

#[derive(Debug, Args)]
pub(crate) struct PredictBenchArgs {
    /// States to predict
    #[arg(long, value_name = "N", default_value_t = 1_000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    states: u64,
    /// Times to predict each at
    #[arg(long, value_name = "N", default_value_t = 1_000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    times: u32,
    /// Order of the spectral model
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(0..=ORDER_MAX as i64))]
    order: u32,
    #[command(flatten)]
    process: DaemonProcess,
}

/// Monday 2020-01-06T00:00:00Z.
pub(super) const START_NANOS: i64 = 1_578_268_800 * NANOS_PER_SEC;
pub(super) const HOUR_NANOS: i64 = 3_600 * NANOS_PER_SEC;
pub(super) const HOURS: u64 = 4 * 7 * 24;
/// The duration that makes the measured figure stable.
const MEASURED: Duration = Duration::from_secs(5);

pub(super) async fn run(client: &Client, map: &str, args: &PredictBenchArgs) -> anyhow::Result<Figures> {
    let load = Load {
        map: map.to_owned(),
        streams: 4,
        states: args.states,
        name_chars: 16,
        observations: args.states * HOURS,
        batch: 4096,
        observation,
    };
    status_line(&format!("sending four weeks of {} states to map {map}", args.states));
    load.send(client).await?;
    updated(client, map).await?;
    let states: Vec<String> = (0..args.states).map(|state| load.name(state)).collect();
    let future = START_NANOS + 5 * 7 * 24 * HOUR_NANOS;
    let times: Vec<i64> = (0..i64::from(args.times)).map(|i| future + i * 61 * NANOS_PER_SEC).collect();
    let model =
        ModelSelector { kind: ModelKind::Spectral, order: Some(args.order as usize), ..ModelSelector::default() };

    status_line("predicting");
    request(client, map, &states, &times, model).await?;
    let before = CpuTimes::now(args.process);
    let (began, mut rounds) = (Instant::now(), 0_u64);
    while rounds == 0 || began.elapsed() < MEASURED {
        request(client, map, &states, &times, model).await?;
        rounds += 1;
    }
    let secs = began.elapsed().as_secs_f64();
    let after = CpuTimes::now(args.process);
    let predictions = rounds * args.states * u64::from(args.times);
    Ok(vec![
        ("states", args.states.into()),
        ("times", args.times.into()),
        ("order", args.order.into()),
        ("rounds", rounds.into()),
        ("predictions", predictions.into()),
        ("secs", secs.into()),
        ("predictions_per_sec", (predictions as f64 / secs).round().into()),
        ("client_cpu_secs", after.feeder_since(before)),
        ("daemon_cpu_secs", after.daemon_since(before)),
    ])
}

/// Requests all predictions once, and counts them.
async fn request(
    client: &Client,
    map: &str,
    states: &[String],
    times: &[i64],
    model: ModelSelector,
) -> anyhow::Result<()> {
    let mut predictions = client.predict(map, states.to_vec(), times.to_vec(), model);
    let mut count = 0;
    while let Some(run) = predictions.next().await? {
        count += run.probabilities.len();
    }
    anyhow::ensure!(count == states.len() * times.len(), "the daemon sent {count} predictions");
    Ok(())
}

/// Each state once per hour: 1 during the day with exceptions, and less often at weekends.
pub(super) fn observation(load: &Load, number: u64) -> Entry {
    let (state, hour) = (number % load.states, number / load.states);
    let (of_day, day) = (hour % 24, hour / 24 % 7);
    let open = (8 + state % 4..18).contains(&of_day) && (day < 5 || state % 3 == 0);
    let exception = scrambled(number).is_multiple_of(10);
    let offset = i64::try_from(state).unwrap_or(0) * 1_000_000;
    Entry {
        state: u32::try_from(state).unwrap_or(0),
        time_nanos: START_NANOS + i64::try_from(hour).unwrap_or(0) * HOUR_NANOS + offset,
        value: if open == exception { 0.0 } else { 1.0 },
        position: None,
    }
}
