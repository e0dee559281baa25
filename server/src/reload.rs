//! Files that are read again when they change: certificates and tokens.
//!
//! Invariant: a change is noticed within [`CHECK_INTERVAL`], or at once after SIGHUP. Files that cannot be used are not
//! put into use. If this remains, it is logged and counted once. The earlier content stays in use, and the new files
//! are tried again every [`AGAIN_AFTER`], because they may become valid without a change.

use std::{
    fs,
    os::unix::fs::MetadataExt as _,
    path::PathBuf,
    time::{Duration, Instant},
};

use tokio::signal::unix::{SignalKind, signal};
use tracing::{error, info, warn};

/// Interval at which files are checked.
const CHECK_INTERVAL: Duration = Duration::from_secs(1);
/// Time within which files that belong together are replaced one after the other; meanwhile they may not fit together.
const REPLACED_WITHIN: Duration = Duration::from_secs(3);
/// Time after which files that could not be used are tried again.
const AGAIN_AFTER: Duration = Duration::from_secs(60);

/// The identity of a version of a file: inode, size, and times of change in nanoseconds.
type Stamp = Option<(u64, u64, i64, i64, i64)>;

fn stamps(paths: &[PathBuf]) -> Vec<Stamp> {
    let stamp = |path: &PathBuf| {
        let found = fs::metadata(path).ok()?;
        // A change of permissions counts, because it may make the file usable.
        let changed = found.ctime() * 1_000_000_000 + found.ctime_nsec();
        Some((found.ino(), found.size(), found.mtime(), found.mtime_nsec(), changed))
    };
    paths.iter().map(stamp).collect()
}

/// Files that could not be used.
struct Failure {
    reason: String,
    tried: Instant,
    is_reported: bool,
}

impl Failure {
    /// Whether it is time to try the files again.
    fn is_due(&self) -> bool {
        self.tried.elapsed() >= if self.is_reported { AGAIN_AFTER } else { REPLACED_WITHIN }
    }
}

/// Watched files, in their current version.
#[derive(Debug)]
pub(crate) struct FileWatch {
    what: &'static str,
    paths: Vec<PathBuf>,
    stamps: Vec<Stamp>,
}

impl FileWatch {
    /// Create this before the files are read for the first time, so that no change is missed.
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
        let mut pause = tokio::time::interval(CHECK_INTERVAL);
        let mut failed: Option<Failure> = None;
        pause.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            let is_requested = tokio::select! {
                _ = pause.tick() => false,
                received = async { match &mut hangup { Some(hangup) => hangup.recv().await, None => None } },
                    if hangup.is_some() => received.is_some(),
            };
            let now = stamps(&self.paths);
            let is_changed = now != self.stamps;
            if !is_changed && !is_requested && failed.as_ref().is_none_or(|failure| !failure.is_due()) {
                continue;
            }
            self.stamps = now;
            match reload() {
                Ok(()) => {
                    failed = None;
                    metrics::counter!("tidemap_reloads_total", "what" => what).increment(1);
                    info!("the {what} were read again and are in use");
                }
                Err(error) => {
                    let reason = error.to_string();
                    let before = failed.take().filter(|before| before.is_reported && before.reason == reason);
                    let is_settled = is_requested || !is_changed;
                    if is_requested || (is_settled && before.is_none()) {
                        metrics::counter!("tidemap_reload_failures_total", "what" => what).increment(1);
                        error!(
                            "the {what} changed, and the new ones cannot be used; those before stay in use: {reason}"
                        );
                    }
                    failed = Some(Failure { reason, tried: Instant::now(), is_reported: is_settled });
                }
            }
        }
    }
}
