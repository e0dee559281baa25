//! Waiting for the nightly updates.
//!
//! Invariant: later predictions come from all observations before the midnight.

use std::time::{Duration, Instant};

use anyhow::bail;
use tidemap_client::{Client, updates::JobState};

use super::MAP;

const TIMEOUT: Duration = Duration::from_secs(60);
const POLL: Duration = Duration::from_millis(20);

/// Waits until the automatic updates have learned everything before `cut_nanos` UTC.
pub(super) async fn await_updates(client: &Client, cut_nanos: i64) -> anyhow::Result<()> {
    let deadline = Instant::now() + TIMEOUT;
    loop {
        let update = client.map(MAP).await?.last_update;
        if update.cut_nanos.is_some_and(|cut| cut >= cut_nanos) {
            return Ok(());
        }
        if Instant::now() > deadline {
            bail!("the nightly updates did not come within {} s", TIMEOUT.as_secs());
        }
        tokio::time::sleep(POLL).await;
    }
}

/// Runs an update up to `until_nanos` UTC: no later data triggers the last update.
pub(super) async fn run_last(client: &Client, until_nanos: i64) -> anyhow::Result<()> {
    let mut job = client.run_update(MAP, Some(until_nanos)).await?;
    let mut watch = client.watch_job(job.id).await?;
    while let Some(changed) = watch.next().await? {
        job = changed;
    }
    match job.state {
        JobState::Done => Ok(()),
        JobState::Failed => bail!("the update failed: {}", job.error),
        other => bail!("the update ended as {}", other.name()),
    }
}
