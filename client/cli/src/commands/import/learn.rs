//! The update that ends an import: the map learns what was imported.
//!
//! Invariant: an update that fails is no failure of the import: everything that was sent is durable, and the message
//! has the command that learns it later.

use anyhow::Context as _;
use tidemap_client::{
    maps::NotLearned,
    updates::{Job, JobState},
};
use tonic::Code;

use crate::{
    commands::{Session, job, shell_word::quoted},
    counted::some_of,
    progress::status_line,
};

/// How an update ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LearnEnd {
    /// It is done, or was reported.
    Reported,
    /// Ctrl-C ended the wait for it.
    Interrupted,
}

/// Updates a map, and prints what it learned, or why it did not.
pub(super) async fn learn(session: &Session, map: &str) -> anyhow::Result<LearnEnd> {
    let mut started = None;
    tokio::select! {
        learned = update(session, map, &mut started) => status_line(&match learned {
            Ok(learned) => learned,
            Err(error) => failure(map, &error),
        }),
        signal = tokio::signal::ctrl_c() => {
            signal.context("signals")?;
            let how = started.map_or_else(
                || format!("the map has not learned it: tidemap update {}", quoted(map)),
                |id| format!("the daemon continues the update: tidemap job watch {id}"),
            );
            status_line(&format!("interrupted; the import is complete, and {how}"));
            return Ok(LearnEnd::Interrupted);
        }
    }
    Ok(LearnEnd::Reported)
}

/// Updates a map, and returns what it learned. `started` receives the number of the job.
async fn update(session: &Session, map: &str, started: &mut Option<u64>) -> anyhow::Result<String> {
    let client = &session.client;
    let Some(waiting) = client.map(map).await?.not_learned else {
        return Ok(format!("map {map:?} has nothing new to learn"));
    };
    let job = client.run_update(map, None).await?;
    *started = Some(job.id);
    // Without the list, the wait has no reason, but the same end.
    let jobs = client.jobs().await.unwrap_or_default();
    if let Some(before) = jobs.iter().find(|other| other.map == map && other.id < job.id && !other.has_ended()) {
        status_line(&format!(
            "job {} of map {map:?} is running: the update follows it. Ctrl-C does not stop the update",
            before.id
        ));
    }
    let ended = job::watch(client, job.id).await?;
    if ended.state == JobState::Failed {
        anyhow::bail!(job::failure(&ended));
    }
    Ok(learned(map, &waiting, &ended))
}

/// A line about the data that an update has learned.
fn learned(map: &str, waiting: &NotLearned, ended: &Job) -> String {
    let what = some_of(&[(waiting.scans, "scan"), (waiting.observations, "observation")]);
    format!("map {map:?} has learned {what}, in {:.1} s", ended.elapsed_nanos as f64 / 1e9)
}

/// Why the map has not learned the import, and what to do.
fn failure(map: &str, error: &anyhow::Error) -> String {
    let code = error.downcast_ref::<tidemap_client::Error>().and_then(tidemap_client::Error::code);
    let command = format!("tidemap update {}", quoted(map));
    if code == Some(Code::PermissionDenied) {
        return format!(
            "everything is imported, but your token may not run updates: the next nightly update learns it, or a user \
             of role operator with: {command}"
        );
    }
    format!("everything is imported, but the update did not succeed: {error:#}. To learn it: {command}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_names_the_command_that_learns_later() {
        let text = failure("lab", &anyhow::anyhow!("job 7 of map \"lab\" failed: no room"));
        assert!(text.starts_with("everything is imported, but"), "{text}");
        assert!(text.ends_with("job 7 of map \"lab\" failed: no room. To learn it: tidemap update lab"), "{text}");
    }
}
