//! The observation log of a map: segments of chained records, written by the store's committer.
//!
//! Invariant: a record is acknowledged only when it and all records before it are durable. Its position is its number,
//! from 1, without gaps.

use std::{
    path::{Path, PathBuf},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};

use crate::{error::AppendError, log::writer::LogWriter};

pub(crate) mod frame;
pub(crate) mod groups;
pub(crate) mod record_group;
pub(crate) mod recovery;
pub(crate) mod replay;
pub(crate) mod writer;

/// Called once: with the record's position when it is durable, or with the reason why it is not in the log.
pub type Done = Box<dyn FnOnce(Result<u64, AppendError>) + Send>;

/// The log of a map as the committer and the map's handles share it.
pub(crate) struct Log {
    pub(crate) map: u32,
    /// `None` once the map is deleted. The committer holds the lock while it writes or syncs; nothing else writes.
    pub(crate) writer: Mutex<Option<LogWriter>>,
    /// Counts the attempts of the map's writer, from 1: appends of one epoch depend on each other.
    pub(crate) epoch: AtomicU64,
    /// The last epoch in which an append has failed.
    failed_epoch: AtomicU64,
    /// Position of the last durable record.
    pub(crate) end: AtomicU64,
    pub(crate) progress: Mutex<Progress>,
    /// Position of the newest snapshot that is saved; 0 without one.
    pub(crate) saved: AtomicU64,
}

/// Bytes of the log; they decide when a checkpoint is due.
#[derive(Clone, Debug, Default)]
pub(crate) struct Progress {
    /// Bytes since the position from which the log was read at opening.
    pub(crate) bytes: u64,
    /// The part of these bytes that the newest snapshot covers.
    pub(crate) covered: u64,
    /// Starts of updates that no snapshot covers yet: position, and bytes up to and including it.
    pub(crate) updates: Vec<(u64, u64)>,
}

impl Log {
    pub(crate) fn new(map: u32, writer: LogWriter, progress: Progress) -> Log {
        let end = AtomicU64::new(writer.end());
        Log {
            map,
            writer: Mutex::new(Some(writer)),
            epoch: AtomicU64::new(1),
            failed_epoch: AtomicU64::new(0),
            end,
            progress: Mutex::new(progress),
            saved: AtomicU64::new(0),
        }
    }

    /// Whether appends of that epoch must fail because one has failed.
    pub(crate) fn has_failed(&self, epoch: u64) -> bool {
        epoch <= self.failed_epoch.load(Ordering::Acquire)
    }

    /// Makes all appends fail until [`MapLog::resume`].
    pub(crate) fn fail(&self) {
        self.failed_epoch.store(self.epoch.load(Ordering::Acquire), Ordering::Release);
    }

    /// Records that everything up to `end` is durable.
    pub(crate) fn advance(&self, end: u64, bytes: u64, updates: &[(u64, u64)]) {
        self.end.store(end, Ordering::Release);
        // Held for a few instructions; only a save and a query for the length also take it.
        let mut progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        let before = progress.bytes;
        progress.bytes += bytes;
        progress.updates.extend(updates.iter().map(|&(position, bytes)| (position, before + bytes)));
    }

    /// Records that a snapshot covers everything up to a position.
    pub(crate) fn cover(&self, position: u64) {
        self.saved.fetch_max(position, Ordering::AcqRel);
        let mut progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(&(_, bytes)) = progress.updates.iter().rev().find(|&&(start, _)| start <= position) {
            progress.covered = bytes;
        }
        progress.updates.retain(|&(start, _)| start > position);
    }
}

/// File name of a segment.
pub(crate) fn segment_path(folder: &Path, first_position: u64) -> PathBuf {
    folder.join(format!("{first_position:020}.log"))
}

/// First position of a segment of that name; `None` for other files.
pub(crate) fn segment_position(name: &str) -> Option<u64> {
    let digits = name.strip_suffix(".log")?;
    let is_position = digits.len() == 20 && digits.bytes().all(|byte| byte.is_ascii_digit());
    if is_position { digits.parse().ok() } else { None }
}
