//! `tidemap-bench lag`: how far a daemon of a cluster is behind the acknowledgements of another one.
//!
//! Invariant: a reply counts only if it shows the data that was acknowledged before, as its read token states.

use std::time::{Duration, Instant};

use clap::Args;
use tidemap_client::{
    Client, clock,
    connection::Credentials,
    observe::{Phase, Producer, ProducerOptions},
    queries::ModelSelector,
};

use super::{Figures, latencies::Latencies};
use tidemap_terminal::{failure::UsageError, progress::status_line};

/// The time limit until the other daemon holds a new map.
const HELD_WITHIN: Duration = Duration::from_secs(60);
const CHECK_INTERVAL: Duration = Duration::from_millis(200);
const STATE: &str = "door";

#[derive(Debug, Args)]
pub(crate) struct LagArgs {
    /// Address of the other daemon; it reads the observations that `--server` has acknowledged
    #[arg(long, value_name = "HOST:PORT")]
    reader: String,
    /// Observations per second
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    rate: u32,
    /// Duration in seconds
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    secs: u64,
}

impl LagArgs {
    /// A client of the other daemon, whose replies show at least what `client` has seen.
    pub(super) fn reader(&self, client: &Client, credentials: &Credentials) -> anyhow::Result<Client> {
        let reader = Client::with_credentials(&self.reader, credentials);
        Ok(reader.map_err(|error| UsageError(error.to_string()))?.with_read_tokens_of(client))
    }
}

pub(super) async fn run(client: &Client, reader: &Client, map: &str, args: &LagArgs) -> anyhow::Result<Figures> {
    let (writer, other) = (client.cluster_status(false).await?.member, reader.cluster_status(false).await?.member);
    if writer == other {
        let text = format!("--reader {} and --server are one daemon, {writer}: name another one", args.reader);
        return Err(UsageError(text).into());
    }
    let mut producer = Producer::open(client, ProducerOptions::new("bench-lag", "", map)).await?;
    let first = producer.send(STATE, clock::now_nanos(), 1.0).await?;
    acknowledged(&producer, first).await?;
    held(reader, map).await?;
    status_line(&format!("{} observations a second for {} s, each read at {}", args.rate, args.secs, args.reader));
    let period = Duration::from_secs_f64(1.0 / f64::from(args.rate));
    let end = Instant::now() + Duration::from_secs(args.secs);
    let (mut behind, mut again) = (Latencies::new()?, Latencies::new()?);
    while Instant::now() < end {
        let due = Instant::now() + period;
        let sequence = producer.send(STATE, clock::now_nanos(), 1.0).await?;
        acknowledged(&producer, sequence).await?;
        let began = Instant::now();
        read(reader, map).await?;
        behind.record(began.elapsed())?;
        // The time that the reading takes by itself.
        let began = Instant::now();
        read(reader, map).await?;
        again.record(began.elapsed())?;
        tokio::time::sleep_until(due.into()).await;
    }
    let mut figures = vec![("rate", args.rate.into()), ("reads", behind.count().into())];
    figures.extend(behind.figures(["p50_ms", "p99_ms", "max_ms"]));
    figures.extend(again.figures(["again_p50_ms", "again_p99_ms", "again_max_ms"]));
    Ok(figures)
}

/// Waits until an observation is durable.
async fn acknowledged(producer: &Producer, sequence: u64) -> anyhow::Result<()> {
    let mut progress = producer.watch();
    loop {
        {
            let progress = progress.borrow_and_update();
            if let Phase::Ended(error) = &progress.phase {
                return Err(error.clone().into());
            }
            if progress.durable_sequence >= sequence {
                return Ok(());
            }
        }
        progress.changed().await?;
    }
}

/// Waits until a daemon holds a new map.
async fn held(reader: &Client, map: &str) -> anyhow::Result<()> {
    let end = Instant::now() + HELD_WITHIN;
    while let Err(error) = read(reader, map).await {
        if Instant::now() > end {
            return Err(error);
        }
        tokio::time::sleep(CHECK_INTERVAL).await;
    }
    Ok(())
}

/// A small prediction.
async fn read(reader: &Client, map: &str) -> anyhow::Result<()> {
    let time = clock::now_nanos();
    let mut predictions = reader.predict(map, vec![STATE.to_owned()], vec![time], ModelSelector::default());
    while predictions.next().await?.is_some() {}
    Ok(())
}
