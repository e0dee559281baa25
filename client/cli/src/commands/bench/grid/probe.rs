//! Predictions of the whole grid while it is fed.
//!
//! Invariant: a prediction counts from the question to its last tile; those of an empty grid do not count.

use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use tidemap_client::{
    Client, clock,
    queries::{GridQuery, ModelSelector},
};
use tokio::{sync::oneshot, task::JoinHandle};

use super::Figures;
use tidemap_formats::table::Cell;

/// Longest latency that is told apart, in microseconds.
const LATENCY_MAX_MICROS: u64 = 600_000_000;
const DIGITS: u8 = 3;

#[derive(Debug)]
pub(super) struct Probe {
    stop: oneshot::Sender<()>,
    task: JoinHandle<anyhow::Result<Histogram<u64>>>,
}

impl Probe {
    pub(super) fn start(client: &Client, map: &str, pause: Duration) -> Self {
        let (stop, mut stopped) = oneshot::channel();
        let (client, map) = (client.clone(), map.to_owned());
        let task = tokio::spawn(async move {
            let mut latencies = Histogram::<u64>::new_with_max(LATENCY_MAX_MICROS, DIGITS)?;
            loop {
                tokio::select! {
                    _ = &mut stopped => return Ok(latencies),
                    () = tokio::time::sleep(pause) => {}
                }
                let query = GridQuery {
                    map: map.clone(),
                    time_nanos: clock::now_nanos(),
                    model: ModelSelector::default(),
                    ..GridQuery::default()
                };
                let began = Instant::now();
                let whole = client.predict_grid(&query).await?.whole().await?;
                if !whole.tiles.is_empty() {
                    let micros = u64::try_from(began.elapsed().as_micros()).unwrap_or(u64::MAX);
                    latencies.record(micros.clamp(1, LATENCY_MAX_MICROS))?;
                }
            }
        });
        Self { stop, task }
    }

    /// Ends after the prediction under way.
    pub(super) async fn ended(self) -> anyhow::Result<Figures> {
        let _ = self.stop.send(());
        let latencies = self.task.await??;
        let millis = |micros: u64| Cell::from(micros as f64 / 1e3);
        Ok(vec![
            ("grid_predictions", latencies.len().into()),
            ("grid_p50_ms", millis(latencies.value_at_quantile(0.5))),
            ("grid_p99_ms", millis(latencies.value_at_quantile(0.99))),
            ("grid_max_ms", millis(latencies.max())),
        ])
    }
}
