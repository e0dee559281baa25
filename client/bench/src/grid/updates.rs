//! The durations of a map's updates.
//!
//! Invariant: each update counts once, with the duration that the daemon reports.

use std::{collections::BTreeMap, time::Duration};

use tidemap_client::{Client, updates::JobState};
use tokio::task::JoinHandle;

/// Pause between two requests for the jobs; the daemon keeps ended jobs much longer.
const PAUSE: Duration = Duration::from_millis(500);

/// Watches the updates of a map.
#[derive(Debug)]
pub(super) struct UpdateTimes {
    map: String,
    /// Seconds of each update, by the job's number.
    durations: tokio::sync::watch::Receiver<BTreeMap<u64, f64>>,
    task: JoinHandle<()>,
}

/// Durations of updates, in seconds.
#[derive(Clone, Debug)]
pub(super) struct UpdateSecs(Vec<f64>);

impl UpdateTimes {
    pub(super) fn watch(client: &Client, map: &str) -> Self {
        let (sender, durations) = tokio::sync::watch::channel(BTreeMap::new());
        let (client, watched) = (client.clone(), map.to_owned());
        let task = tokio::spawn(async move {
            loop {
                tokio::time::sleep(PAUSE).await;
                if let Ok(ended) = ended(&client, &watched).await {
                    sender.send_modify(|durations| durations.extend(ended));
                }
            }
        });
        Self { map: map.to_owned(), durations, task }
    }

    /// Ends the watch after one last request.
    pub(super) async fn ended(self, client: &Client) -> anyhow::Result<UpdateSecs> {
        self.task.abort();
        let mut all = self.durations.borrow().clone();
        all.extend(ended(client, &self.map).await?);
        Ok(UpdateSecs(all.into_values().collect()))
    }
}

impl Drop for UpdateTimes {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn ended(client: &Client, map: &str) -> Result<Vec<(u64, f64)>, tidemap_client::Error> {
    let jobs = client.jobs().await?;
    let of_map = jobs.into_iter().filter(|job| job.map == map && job.state == JobState::Done);
    Ok(of_map.map(|job| (job.id, job.elapsed_nanos as f64 / 1e9)).collect())
}

impl UpdateSecs {
    pub(super) fn count(&self) -> u64 {
        self.0.len() as u64
    }

    pub(super) fn mean_secs(&self) -> Option<f64> {
        (!self.0.is_empty()).then(|| self.0.iter().sum::<f64>() / self.0.len() as f64)
    }

    pub(super) fn max_secs(&self) -> Option<f64> {
        self.0.iter().copied().reduce(f64::max)
    }
}
