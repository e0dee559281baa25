//! Backups: the folders that requests may use, and the scheduled backups of the daemon.
//!
//! Invariant: where the operator has set a folder, nothing is written outside of it. A scheduled backup gets its name
//! when it is complete; the name contains the time at which it began. Only backups of this data folder with such a name
//! are ever removed.

use std::{
    fs,
    path::{Component, Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use tidemap_base::config::Settings;
use tidemap_model::time::{format_rfc3339, parse_time};
use tidemap_store::{BackupError, BackupReport, Store, Trouble, is_backup_of, link_backup};
use tokio::sync::watch;
use tracing::{error, info, warn};

use crate::{catalog::Catalog, jobs::JobCause};

/// The beginning of the names of scheduled backups; the time at which the backup began follows.
const SCHEDULED: &str = "auto-";
/// The name of a scheduled backup that is being made, or was cut off.
const UNFINISHED: &str = "auto.part";
/// The longest wait before the clock is read again, because it may have been set meanwhile.
const CHECK_INTERVAL: Duration = Duration::from_secs(60);
/// The longest pause after a backup that failed.
const AGAIN_AFTER: Duration = Duration::from_secs(3600);
const NANOS_PER_SEC: i64 = 1_000_000_000;

/// The reason why a folder cannot be used for a backup.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the variants and fields")]
pub enum TargetError {
    #[error(
        "{path:?} is not below {}, where backups of this daemon are written: name a folder such as \"by-hand\"",
        .folder.display()
    )]
    Outside { path: String, folder: PathBuf },
    #[error(
        "it must be the absolute path of a folder on the daemon's machine, or setting backup_dir must name the folder that \
         it is below"
    )]
    Relative,
    #[error("the folder of backups {} cannot be used: {source}; see setting backup_dir of the daemon", .folder.display())]
    Folder { folder: PathBuf, source: std::io::Error },
}

/// The folder of a backup that a request names: below the folder of backups, relative to it or absolute.
///
/// # Errors
/// The path leads out of that folder, by its text or by links on the disk.
pub fn target(folder: &Path, path: &str) -> Result<PathBuf, TargetError> {
    let outside = || TargetError::Outside { path: path.chars().take(200).collect(), folder: folder.to_owned() };
    let unusable = |source| TargetError::Folder { folder: folder.to_owned(), source };
    let target = folder.join(path);
    let below = target.strip_prefix(folder).map_err(|_| outside())?;
    if below.as_os_str().is_empty() || !below.components().all(|part| matches!(part, Component::Normal(_))) {
        return Err(outside());
    }
    fs::create_dir_all(folder).map_err(unusable)?;
    let real = folder.canonicalize().map_err(unusable)?;
    // The deepest part that exists already; a link without a target exists.
    let present = target.ancestors().find(|part| fs::symlink_metadata(part).is_ok());
    let present = present.and_then(|part| part.canonicalize().ok());
    present.filter(|present| present.starts_with(&real)).ok_or_else(outside)?;
    Ok(target)
}

/// Counts and logs a backup that was made to a folder, and counts one that failed.
fn counted(folder: &Path, made: Result<BackupReport, BackupError>) -> Result<BackupReport, BackupError> {
    match &made {
        Ok(BackupReport { maps, copied_files, copied_bytes, kept_files }) => {
            metrics::counter!("tidemap_backups_total").increment(1);
            info!(folder = %folder.display(), maps, copied_files, copied_bytes, kept_files, "backup made");
        }
        Err(BackupError::Stopped) => {}
        Err(_) => metrics::counter!("tidemap_backup_failures_total").increment(1),
    }
    made
}

/// Makes a backup that a request has ordered.
///
/// # Errors
/// The errors are those of [`Store::backup`].
pub fn make(store: &Store, target: &Path) -> Result<BackupReport, BackupError> {
    counted(target, store.backup(target))
}

/// The name of a scheduled backup that began at a time.
fn name_of(began_nanos: i64) -> String {
    let whole = began_nanos.div_euclid(NANOS_PER_SEC) * NANOS_PER_SEC;
    // The name has no colons, because some file systems and copy programs do not accept them.
    format!("{SCHEDULED}{}", format_rfc3339(whole).replace(':', "-"))
}

/// The time at which the scheduled backup of this name began, in nanoseconds since 1970.
fn began_nanos(name: &str) -> Option<i64> {
    let (date, time) = name.strip_prefix(SCHEDULED)?.split_once('T')?;
    let nanos = parse_time(&format!("{date}T{}", time.replace('-', ":"))).ok()?;
    (name_of(nanos) == name).then_some(nanos)
}

/// The schedule of backups, and the number of backups to keep.
#[derive(Clone, Debug)]
pub struct Schedule {
    folder: PathBuf,
    every: Duration,
    kept: usize,
}

impl Schedule {
    /// The schedule of the settings, if there is one.
    pub fn of(settings: &Settings) -> Option<Self> {
        let every = Duration::from_secs(settings.backup_every_secs);
        let (folder, kept) = (settings.backup_dir.clone(), settings.backups_kept);
        (!every.is_zero()).then_some(Self { folder, every, kept })
    }

    /// The complete scheduled backups of a store, with the times at which they began, newest first.
    fn complete(&self, store_id: &str) -> Vec<(i64, PathBuf)> {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let named = entries.filter_map(|entry| Some((began_nanos(entry.file_name().to_str()?)?, entry.path())));
        let mut found: Vec<_> = named.filter(|(_, path)| is_backup_of(path, store_id)).collect();
        found.sort_unstable_by(|a, b| b.cmp(a));
        found
    }

    /// The time at which the newest complete backup began. A time later than now comes from a clock that was wrong, and
    /// is ignored.
    fn newest_nanos(&self, store_id: &str, now_nanos: i64) -> Option<i64> {
        self.complete(store_id).into_iter().map(|(began, _)| began).find(|began| *began <= now_nanos)
    }

    /// Names and values of the metrics of the schedule.
    pub fn metrics(&self, store_id: &str, now_nanos: i64) -> [(&'static str, f64); 2] {
        let newest = self.newest_nanos(store_id, now_nanos);
        let age = newest.map_or(f64::INFINITY, |began| now_nanos.saturating_sub(began) as f64 / 1e9);
        [("tidemap_backup_age_seconds", age), ("tidemap_backup_interval_seconds", self.every.as_secs_f64())]
    }

    /// Makes backups until the daemon stops.
    pub async fn run(self, catalog: Arc<Catalog>, mut stopping: watch::Receiver<bool>) {
        let clock = Arc::clone(&catalog.context().clock);
        let store = Arc::clone(&catalog.context().store);
        let every_nanos = i64::try_from(self.every.as_nanos()).unwrap_or(i64::MAX);
        let again_nanos = i64::try_from(self.every.min(AGAIN_AFTER).as_nanos()).unwrap_or(i64::MAX);
        let mut not_before = i64::MIN;
        loop {
            let now = clock.now_nanos();
            let (schedule, id) = (self.clone(), store.store_id().to_owned());
            let newest = tidemap_base::task::blocking(move || schedule.newest_nanos(&id, now)).await;
            let Ok(newest) = newest else { return };
            let due = newest.map_or(i64::MIN, |began| began.saturating_add(every_nanos)).max(not_before);
            let wait = Duration::from_nanos(u64::try_from(due.saturating_sub(now)).unwrap_or(0)).min(CHECK_INTERVAL);
            tokio::select! {
                () = tokio::time::sleep(wait) => {}
                // An error means that the sender is gone, which is also a stop.
                _ = stopping.wait_for(|stop| *stop) => return,
            }
            let now = clock.now_nanos();
            if now < due {
                continue;
            }
            let job = catalog.context().jobs.create(None, JobCause::Backup, now);
            // The log of a map that is being opened may still lose its torn end.
            for map in catalog.all().values() {
                map.opened().await;
            }
            job.step("copy");
            job.start(0, 0);
            let is_damaged = |trouble: &Trouble| matches!(trouble, Trouble::Damaged { .. });
            let keeps_all = !catalog.unavailable().is_empty() || store.trouble().iter().any(is_damaged);
            let (schedule, store, stop) = (self.clone(), Arc::clone(&store), stopping.clone());
            let work = move || {
                let made = schedule.make(&store, now, keeps_all, &|| !*stop.borrow());
                counted(&schedule.folder.join(name_of(now)), made).map_err(|error| error.to_string())
            };
            let made = tidemap_base::task::blocking(work).await.unwrap_or_else(|error| Err(error.to_string()));
            if let Err(reason) = &made {
                error!(folder = %self.folder.display(), reason, "the scheduled backup was not made; it is tried again");
                not_before = clock.now_nanos().saturating_add(again_nanos);
            }
            job.end_with(made.map(|_| None));
        }
    }

    /// Makes the backup of a time, and removes those that are too old.
    fn make(
        &self,
        store: &Store,
        now_nanos: i64,
        keeps_all: bool,
        goes_on: &dyn Fn() -> bool,
    ) -> Result<BackupReport, BackupError> {
        let io = |file: &Path| {
            let file = file.to_owned();
            move |source| BackupError::Io { file, source }
        };
        let unfinished = self.prepare(store)?;
        let report = store.backup_while(&unfinished, goes_on)?;
        let complete = self.folder.join(name_of(now_nanos));
        let named = fs::rename(&unfinished, &complete).and_then(|()| fs::File::open(&self.folder)?.sync_all());
        named.map_err(io(&complete))?;
        let old = self.complete(store.store_id()).into_iter().skip(self.kept);
        if keeps_all {
            warn!("files of the data folder are damaged: older backups, which may have sound ones, are not removed");
            return Ok(report);
        }
        for (_, old) in old {
            fs::remove_dir_all(&old).map_err(io(&old))?;
            info!(folder = %old.display(), "an old backup was removed");
        }
        Ok(report)
    }

    /// Prepares the folder of an unfinished backup. If an earlier backup was cut off, its files are used; otherwise the
    /// files of the newest complete backup are linked.
    fn prepare(&self, store: &Store) -> Result<PathBuf, BackupError> {
        let unfinished = self.folder.join(UNFINISHED);
        let io = |source| BackupError::Io { file: unfinished.clone(), source };
        let is_of_another = unfinished.join("MANIFEST").exists() && !is_backup_of(&unfinished, store.store_id());
        if is_of_another {
            fs::remove_dir_all(&unfinished).map_err(io)?;
        }
        let io_folder = |source| BackupError::Io { file: self.folder.clone(), source };
        fs::create_dir_all(&self.folder).map_err(io_folder)?;
        if !unfinished.exists()
            && let Some((_, newest)) = self.complete(store.store_id()).first()
        {
            link_backup(newest, &unfinished)?;
        }
        Ok(unfinished)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_stay_below_the_folder_of_backups() {
        let work = tempfile::tempdir().expect("a folder");
        let (folder, elsewhere) = (work.path().join("backups"), work.path().join("elsewhere"));
        for made in [&folder, &elsewhere] {
            fs::create_dir(made).expect("made");
        }
        for (link, to) in [("away", elsewhere.as_path()), ("dangling", &work.path().join("nowhere")), ("in", &folder)] {
            std::os::unix::fs::symlink(to, folder.join(link)).expect("a link");
        }
        let absolute = folder.join("daily/robot").display().to_string();
        for (path, expected) in
            [("daily", "daily"), ("a/b/", "a/b"), (absolute.as_str(), "daily/robot"), ("in/c", "in/c")]
        {
            assert_eq!(target(&folder, path).expect(path), folder.join(expected), "{path}");
        }
        let sibling = format!("{}-2/a", folder.display());
        for path in [
            "",
            ".",
            "..",
            "a/../..",
            "../elsewhere",
            "/",
            "/etc",
            &elsewhere.display().to_string(),
            &sibling,
            "away",
            "away/deep/er",
            "dangling",
            "dangling/deep",
            &format!("{}/../elsewhere", folder.display()),
        ] {
            let refused = target(&folder, path).expect_err(path).to_string();
            assert!(refused.contains("is not below") && refused.contains("backups"), "{path}: {refused}");
        }
    }

    #[test]
    fn a_name_contains_the_time_at_which_the_backup_began() {
        let began = 1_794_000_000_123_456_789;
        let name = name_of(began);
        assert_eq!(name, "auto-2026-11-06T21-20-00Z");
        assert_eq!(began_nanos(&name), Some(1_794_000_000_000_000_000));
        for other in
            ["auto.part", "auto-", "auto-2026-11-06", "auto-2026-11-06T21:20:00Z", "mine", "auto-2026-13-06T21-20-00Z"]
        {
            assert_eq!(began_nanos(other), None, "{other}");
        }
    }
}
