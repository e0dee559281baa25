//! Files that are read again when they change: certificates and tokens.
//!
//! Invariant: a change is noticed within [`LOOK_EVERY`], or at once after SIGHUP. What cannot be used is logged,
//! counted and not put into use; what was in use before stays.

use std::{fs, os::unix::fs::MetadataExt as _, path::PathBuf, time::Duration};

use tokio::signal::unix::{SignalKind, signal};
use tracing::{error, info, warn};

/// Files are looked at this often.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// What tells one version of a file from another: inode, size, and times of change in nanoseconds.
type Stamp = Option<(u64, u64, i64, i64, i64)>;

fn stamps(paths: &[PathBuf]) -> Vec<Stamp> {
    let stamp = |path: &PathBuf| {
        let found = fs::metadata(path).ok()?;
        // A change of permissions counts: it may be what makes the file usable.
        let changed = found.ctime() * 1_000_000_000 + found.ctime_nsec();
        Some((found.ino(), found.size(), found.mtime(), found.mtime_nsec(), changed))
    };
    paths.iter().map(stamp).collect()
}

/// Files to be followed, as they are now.
#[derive(Debug)]
pub(crate) struct FileWatch {
    what: &'static str,
    paths: Vec<PathBuf>,
    stamps: Vec<Stamp>,
}

impl FileWatch {
    /// Take this before the files are read for the first time, so that no change is missed.
    pub(crate) fn new(what: &'static str, paths: Vec<PathBuf>) -> Self {
        let stamps = stamps(&paths);
        Self { what, paths, stamps }
    }

    /// Calls `reload` after each change of the files, and after SIGHUP, for ever.
    pub(crate) async fn follow<E: std::fmt::Display>(mut self, reload: impl Fn() -> Result<(), E>) {
        let what = self.what;
        let mut hangup = match signal(SignalKind::hangup()) {
            Ok(hangup) => Some(hangup),
            Err(error) => {
                warn!(%error, "SIGHUP cannot be received; changed files are noticed nevertheless");
                None
            }
        };
        let mut pause = tokio::time::interval(LOOK_EVERY);
        pause.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            let is_asked = tokio::select! {
                _ = pause.tick() => false,
                received = async { match &mut hangup { Some(hangup) => hangup.recv().await, None => None } },
                    if hangup.is_some() => received.is_some(),
            };
            let now = stamps(&self.paths);
            if now == self.stamps && !is_asked {
                continue;
            }
            self.stamps = now;
            match reload() {
                Ok(()) => {
                    metrics::counter!("tidemap_reloads_total", "what" => what).increment(1);
                    info!("the {what} were read again and are in use");
                }
                Err(error) => {
                    metrics::counter!("tidemap_reload_failures_total", "what" => what).increment(1);
                    error!("the {what} changed, and the new ones cannot be used; those before stay in use: {error}");
                }
            }
        }
    }
}
