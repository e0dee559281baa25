//! `tidemap-bench overload`.
//!
//! Invariant: in overload, requests are due at fixed times, whether or not earlier ones have ended, and latencies count
//! from the due times; a stalled daemon cannot hide by delaying its load.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use clap::Args;
use tidemap_client::{
    Client,
    observe::columns::Entry,
    queries::{ModelSelector, PredictionRun},
};
use tokio::task::JoinSet;
use tonic::Code;

use super::{
    DaemonProcess, Figures,
    latencies::Latencies,
    load::Load,
    machine::CpuTimes,
    predict::{HOUR_NANOS, HOURS, START_NANOS, observation},
    updated,
};
use tidemap_terminal::progress::status_line;

#[derive(Debug, Args)]
pub(crate) struct OverloadArgs {
    /// Number of clients
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=1_000))]
    clients: u32,
    /// States that each request predicts, with intervals
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1_000))]
    states: u32,
    /// Times that each request predicts each state at
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=1_000))]
    times: u32,
    /// Requests sent, as a multiple of those that the daemon can answer
    #[arg(long, value_name = "N", default_value_t = 3.0)]
    factor: f64,
    /// Duration of the overload in seconds
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    secs: u64,
    #[command(flatten)]
    process: DaemonProcess,
}

/// Time for measuring the capacity of the daemon.
const CAPACITY_WITHIN: Duration = Duration::from_secs(3);
const LEVEL: f64 = 0.9;

/// The request of this benchmark.
#[derive(Clone, Debug)]
struct Question {
    map: Arc<str>,
    states: Arc<[String]>,
    times: Arc<[i64]>,
}

impl Question {
    /// Sends one request; returns whether the daemon answered. A daemon may refuse for its load alone.
    async fn ask(&self, client: &Client) -> anyhow::Result<bool> {
        let (states, times) = (self.states.to_vec(), self.times.to_vec());
        let mut predictions = client.predict(&self.map, states, times, ModelSelector::default()).with_intervals(LEVEL);
        let mut count = 0;
        loop {
            match predictions.next().await {
                Ok(Some(PredictionRun { probabilities, .. })) => count += probabilities.len(),
                Ok(None) => break,
                Err(error) if error.code() == Some(Code::ResourceExhausted) => return Ok(false),
                Err(error) => return Err(error.into()),
            }
        }
        anyhow::ensure!(count == self.states.len() * self.times.len(), "the daemon sent {count} predictions");
        Ok(true)
    }
}

pub(super) async fn run(client: &Client, map: &str, args: &OverloadArgs) -> anyhow::Result<Figures> {
    anyhow::ensure!(args.factor > 0.0 && args.factor <= 100.0, "--factor is {}; it must be in (0, 100]", args.factor);
    let load = Load {
        map: map.to_owned(),
        streams: 4,
        states: u64::from(args.states),
        name_chars: 16,
        observations: u64::from(args.states) * HOURS,
        batch: 4096,
        observation: |load, number| -> Entry { observation(load, number) },
    };
    status_line(&format!("sending four weeks of {} states to map {map}", args.states));
    load.send(client).await?;
    updated(client, map).await?;
    let future = START_NANOS + 5 * 7 * 24 * HOUR_NANOS;
    let question = Question {
        map: map.into(),
        states: (0..load.states).map(|state| load.name(state)).collect(),
        times: (0..i64::from(args.times)).map(|hour| future + hour * HOUR_NANOS).collect(),
    };
    let clients: Arc<[Client]> = (0..args.clients).map(|_| client.with_own_connections()).collect();

    status_line(&format!("{} clients, each with one request after the other", args.clients));
    let (began, mut running) = (Instant::now(), JoinSet::new());
    for client in clients.iter() {
        let client = client.clone();
        let question = question.clone();
        running.spawn(async move {
            let mut answered = 0_u32;
            while began.elapsed() < CAPACITY_WITHIN {
                answered += u32::from(question.ask(&client).await?);
            }
            anyhow::Ok(answered)
        });
    }
    let mut answered = 0;
    while let Some(of_client) = running.join_next().await {
        answered += of_client??;
    }
    let capacity = f64::from(answered) / began.elapsed().as_secs_f64();
    anyhow::ensure!(answered > 0, "the daemon refuses all requests: other clients use it");

    let rate = capacity * args.factor;
    status_line(&format!("{rate:.0} requests a second for {} s", args.secs));
    let count = (rate * args.secs as f64).ceil() as u64;
    let before = CpuTimes::now(args.process);
    let (began, mut running) = (Instant::now(), JoinSet::new());
    for (number, client) in (0..count).zip(clients.iter().cycle()) {
        let due = began + Duration::from_secs_f64(number as f64 / rate);
        tokio::time::sleep_until(due.into()).await;
        let (question, client) = (question.clone(), client.clone());
        running.spawn(async move { anyhow::Ok((question.ask(&client).await?, due.elapsed())) });
    }
    let (mut accepted, mut refused) = (Latencies::new()?, Latencies::new()?);
    while let Some(ended) = running.join_next().await {
        let (is_answered, latency) = ended??;
        if is_answered { &mut accepted } else { &mut refused }.record(latency)?;
    }
    let elapsed = began.elapsed();
    let after = CpuTimes::now(args.process);
    let mut figures = vec![
        ("predictions", (u64::from(args.states) * u64::from(args.times)).into()),
        ("capacity_per_sec", capacity.round().into()),
        ("sent_per_sec", (count as f64 / elapsed.as_secs_f64()).round().into()),
        ("accepted", accepted.count().into()),
    ];
    figures.extend(accepted.figures(["accepted_p50_ms", "accepted_p99_ms", "accepted_max_ms"]));
    figures.push(("refused", refused.count().into()));
    figures.extend(refused.figures(["refused_p50_ms", "refused_p99_ms", "refused_max_ms"]));
    figures.push(("client_cpu_secs", after.feeder_since(before)));
    figures.push(("daemon_cpu_secs", after.daemon_since(before)));
    Ok(figures)
}
