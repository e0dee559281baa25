//! Predicts the whole grid repeatedly while it receives scans.
//!
//! Invariant: a latency is from the request to the last tile; predictions of an empty grid do not count.

use std::time::{Duration, Instant};

use tidemap_client::{
    Client, clock,
    queries::{GridQuery, ModelSelector},
};
use tokio::{sync::oneshot, task::JoinHandle};

use super::Figures;
use crate::latencies::Latencies;

#[derive(Debug)]
pub(super) struct Probe {
    stop: oneshot::Sender<()>,
    task: JoinHandle<anyhow::Result<Latencies>>,
}

impl Probe {
    pub(super) fn start(client: &Client, map: &str, pause: Duration) -> Self {
        let (stop, mut stopped) = oneshot::channel();
        let (client, map) = (client.clone(), map.to_owned());
        let task = tokio::spawn(async move {
            let mut latencies = Latencies::new()?;
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
                    latencies.record(began.elapsed())?;
                }
            }
        });
        Self { stop, task }
    }

    /// Ends after the current prediction.
    pub(super) async fn ended(self) -> anyhow::Result<Figures> {
        let _ = self.stop.send(());
        let latencies = self.task.await??;
        let mut figures = vec![("grid_predictions", latencies.count().into())];
        figures.extend(latencies.figures(["grid_p50_ms", "grid_p99_ms", "grid_max_ms"]));
        Ok(figures)
    }
}
