//! `tidemap-bench latency`.
//!
//! Invariant: observations are due at fixed times, whether or not earlier ones are acknowledged, and latencies count
//! from the due times; a stalled daemon cannot hide by delaying its load.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use clap::Args;
use tidemap_client::{
    Client, clock,
    observe::{Phase, Producer, ProducerOptions},
};
use tokio::task::JoinSet;

use super::{DaemonProcess, Figures, latencies::Latencies, machine::CpuTimes};
use tidemap_terminal::progress::status_line;

#[derive(Debug, Args)]
pub(crate) struct LatencyArgs {
    /// Number of concurrent streams
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    streams: u32,
    /// Observations per second over all streams
    #[arg(long, value_name = "N", default_value_t = 5_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    rate: u32,
    /// Duration in seconds
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    secs: u64,
    #[command(flatten)]
    process: DaemonProcess,
}

pub(super) async fn run(client: &Client, map: &str, args: &LatencyArgs) -> anyhow::Result<Figures> {
    status_line(&format!("{} observations a second on {} streams for {} s", args.rate, args.streams, args.secs));
    let mut producers = Vec::new();
    for stream in 0..args.streams {
        producers.push(Producer::open(client, ProducerOptions::new(&format!("bench-{stream}"), "", map)).await?);
    }
    let period = Duration::from_secs_f64(f64::from(args.streams) / f64::from(args.rate));
    let before = CpuTimes::now(args.process);
    let began = Instant::now();
    let end = began + Duration::from_secs(args.secs);
    let mut running: JoinSet<_> = (0..)
        .zip(producers)
        .map(|(stream, producer)| {
            // The streams are spread over a period.
            let first = began + period.mul_f64(f64::from(stream) / f64::from(args.streams));
            timed(producer, format!("door-{stream}"), first, end, period)
        })
        .collect();
    let mut latencies = Latencies::new()?;
    while let Some(stream) = running.join_next().await {
        latencies.add(stream??)?;
    }
    let elapsed = began.elapsed();
    let after = CpuTimes::now(args.process);
    let mut figures = vec![
        ("streams", args.streams.into()),
        ("rate", args.rate.into()),
        ("observations", latencies.count().into()),
        ("observations_per_sec", (latencies.count() as f64 / elapsed.as_secs_f64()).round().into()),
    ];
    figures.extend(latencies.figures(["p50_ms", "p99_ms", "max_ms"]));
    figures.push(("feeder_cpu_secs", after.feeder_since(before)));
    figures.push(("daemon_cpu_secs", after.daemon_since(before)));
    Ok(figures)
}

/// Sends an observation each period and measures the latency of its acknowledgement.
async fn timed(
    mut producer: Producer,
    state: String,
    first: Instant,
    end: Instant,
    period: Duration,
) -> anyhow::Result<Latencies> {
    let mut latencies = Latencies::new()?;
    let mut progress = producer.watch();
    let mut under_way: VecDeque<(u64, Instant)> = VecDeque::new();
    let mut due = first;
    while due < end || !under_way.is_empty() {
        tokio::select! {
            () = tokio::time::sleep_until(due.into()), if due < end => {
                let value = f64::from(u8::from(under_way.len().is_multiple_of(2)));
                let sequence = producer.send(&state, clock::now_nanos(), value).await?;
                under_way.push_back((sequence, due));
                due += period;
            }
            changed = progress.changed() => {
                changed?;
                let durable = {
                    let progress = progress.borrow_and_update();
                    if let Phase::Ended(error) = &progress.phase {
                        return Err(error.clone().into());
                    }
                    progress.durable_sequence
                };
                while let Some((_, due)) = under_way.pop_front_if(|(sequence, _)| *sequence <= durable) {
                    latencies.record(due.elapsed())?;
                }
            }
        }
    }
    Ok(latencies)
}
