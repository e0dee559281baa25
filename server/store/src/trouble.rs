//! The present trouble of the storage: a full disk, lists that are lost, saves that fail, an index that cannot be
//! written, files that are damaged.
//!
//! Invariant: reading the trouble never waits for the disk. Trouble that has ended is no longer reported.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use crate::MapId;

/// A disk counts as full for this long after a write failed because of it, unless a later one succeeds.
const FULL_FOR: Duration = Duration::from_secs(60);

/// Something that is wrong with the storage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Trouble {
    /// Observations are refused, because the disk is full.
    DiskFull,
    /// The newest generation of a map is not saved. Its log has everything.
    NotSaved {
        /// The map.
        map: MapId,
        /// Why.
        reason: String,
    },
    /// There is no index for this reason. The daemon tries again; a start takes longer meanwhile.
    NoIndex(String),
    /// A list of what must exist was lost before the start, and it is not proven that all is there. Requests for the
    /// objects that it covers are refused.
    ListLost {
        /// The file, within the data directory.
        file: PathBuf,
        /// Description of the damage.
        problem: String,
    },
    /// A file is damaged or missing, as the last read of it has found.
    Damaged {
        /// The file, within the data directory.
        file: PathBuf,
        /// Description of the damage.
        problem: String,
    },
}

impl fmt::Display for Trouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Trouble::DiskFull => write!(f, "the disk is full: observations are refused. Free some space"),
            Trouble::NotSaved { map, reason } => {
                write!(f, "the checkpoint of map number {} is not saved: {reason}. The log has everything", map.0)
            }
            Trouble::Damaged { file, problem } => {
                let file = file.display();
                write!(f, "{file} is damaged: {problem}. Make a backup, stop the daemon, and run tidemapd check")
            }
            Trouble::ListLost { file, problem } => {
                let file = file.display();
                write!(
                    f,
                    "{file} is lost: {problem}. It lists what must exist, so acknowledged observations may be lost \
                     with it, and what it covers is refused. Restore it from a backup of this folder; or stop the \
                     daemon and run tidemapd check, which shows what is lost and how to continue without it"
                )
            }
            Trouble::NoIndex(reason) => write!(
                f,
                "the index cannot be used: {reason}. Maps are served from checkpoints and logs, and it is tried again \
                 every minute: free some space, or check the disk and the permissions of the folder index"
            ),
        }
    }
}

/// The state of the storage, as the store's parts report it.
#[derive(Debug, Default)]
pub(crate) struct Watch {
    full_since: Mutex<Option<Instant>>,
    not_saved: Mutex<BTreeMap<MapId, String>>,
    no_index: Mutex<Option<String>>,
    damaged: Mutex<BTreeMap<PathBuf, String>>,
    lost: Mutex<BTreeMap<PathBuf, String>>,
}

impl Watch {
    /// An append failed because the disk is full, or succeeded.
    pub(crate) fn appended(&self, is_full: bool) {
        *self.full_since.lock().unwrap_or_else(PoisonError::into_inner) = is_full.then(Instant::now);
    }

    /// A save of a map has ended.
    pub(crate) fn saved(&self, map: MapId, failure: Option<String>) {
        let mut not_saved = self.not_saved.lock().unwrap_or_else(PoisonError::into_inner);
        match failure {
            Some(reason) => not_saved.insert(map, reason),
            None => not_saved.remove(&map),
        };
    }

    /// The index is available, or not for this reason.
    pub(crate) fn indexed(&self, failure: Option<String>) {
        *self.no_index.lock().unwrap_or_else(PoisonError::into_inner) = failure;
    }

    /// Lists that are lost, with what is wrong with them.
    pub(crate) fn lost(&self, lists: BTreeMap<PathBuf, String>) {
        *self.lost.lock().unwrap_or_else(PoisonError::into_inner) = lists;
    }

    /// A file was read again: its problem, if it has one.
    pub(crate) fn damaged(&self, file: PathBuf, problem: Option<String>) {
        let mut damaged = self.damaged.lock().unwrap_or_else(PoisonError::into_inner);
        match problem {
            Some(problem) => damaged.insert(file, problem),
            None => damaged.remove(&file),
        };
    }

    /// All files have been read again, and only these are damaged.
    pub(crate) fn keep_damaged(&self, files: &BTreeSet<PathBuf>) {
        let mut damaged = self.damaged.lock().unwrap_or_else(PoisonError::into_inner);
        damaged.retain(|file, _| files.contains(file));
    }

    /// Files below a folder are gone for good, and none of those that must exist: they are no longer reported.
    pub(crate) fn forget(&self, is_forgotten: impl Fn(&Path) -> bool) {
        self.damaged.lock().unwrap_or_else(PoisonError::into_inner).retain(|file, _| !is_forgotten(file));
    }

    /// The present trouble.
    pub(crate) fn trouble(&self) -> Vec<Trouble> {
        let full_since = *self.full_since.lock().unwrap_or_else(PoisonError::into_inner);
        let is_full = full_since.is_some_and(|since| since.elapsed() < FULL_FOR);
        let not_saved = self.not_saved.lock().unwrap_or_else(PoisonError::into_inner);
        let not_saved = not_saved.iter().map(|(&map, reason)| Trouble::NotSaved { map, reason: reason.clone() });
        let full = is_full.then_some(Trouble::DiskFull);
        let damaged = self.damaged.lock().unwrap_or_else(PoisonError::into_inner);
        let damaged = damaged.iter();
        let damaged = damaged.map(|(file, problem)| Trouble::Damaged { file: file.clone(), problem: problem.clone() });
        let index = self.no_index.lock().unwrap_or_else(PoisonError::into_inner).clone().map(Trouble::NoIndex);
        let lost = self.lost.lock().unwrap_or_else(PoisonError::into_inner);
        let lost = lost.iter();
        let lost = lost.map(|(file, problem)| Trouble::ListLost { file: file.clone(), problem: problem.clone() });
        full.into_iter().chain(lost).chain(not_saved).chain(index).chain(damaged).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trouble_is_reported_until_it_ends() {
        let watch = Watch::default();
        assert_eq!(watch.trouble(), []);
        watch.appended(true);
        watch.saved(MapId(3), Some("the disk is full".to_owned()));
        watch.indexed(Some("no space left".to_owned()));
        let not_saved = Trouble::NotSaved { map: MapId(3), reason: "the disk is full".to_owned() };
        assert_eq!(watch.trouble(), [Trouble::DiskFull, not_saved, Trouble::NoIndex("no space left".to_owned())]);
        watch.appended(false);
        watch.saved(MapId(3), None);
        watch.indexed(None);
        assert_eq!(watch.trouble(), []);
    }
}
