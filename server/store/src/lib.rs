//! The data on the disk: the observation log, checkpoints, history files, and the sled index of models.
//!
//! Entry points: [`Store::open`], [`Store::open_map`], [`MapLog::append`], [`Store::save`], [`Store::history`],
//! [`digest`].
//!
//! Invariant: the log holds everything that the kept checkpoints do not cover. Any one checkpoint, or the index,
//! can be lost or damaged and the map is still the same. A damaged log is refused, never shortened. Layouts are frozen
//! in `tidemap-migrations`; this crate knows nothing of the wire and reads no wall clock.

mod backup;
mod check;
mod checkpoint;
mod committer;
mod digest;
pub mod disk;
mod erasure;
mod error;
mod event_log;
mod failure;
mod folders;
mod fork;
#[cfg(feature = "fuzz")]
pub mod fuzz;
mod group_log;
mod history;
mod index;
mod list_file;
mod lock;
mod log;
mod losses;
mod map_log;
mod options;
mod record;
mod record_file;
mod scrub;
mod store;
mod trouble;

#[cfg(any(test, feature = "simulation"))]
pub mod simulation;
#[cfg(test)]
mod tests;

pub use backup::{BackupError, BackupReport, is_backup_of, link_backup, restore};
pub use check::{Checked, Finding, Mode, Outcome, TryRestore, check, check_with};
pub use committer::{CommitFollower, CommitStep, GroupFollower, SyncStats};
pub use digest::{NoDigest, digest};
pub use erasure::Erased;
pub use error::{AppendError, EraseError, HistoryError, OpenError, Repair, StoreError};
pub use event_log::EventLog;
pub use fork::{Fork, ForkError};
pub use group_log::{ForeignGroupError, GroupLog, QueuedEvent, WrittenGroup};
pub use history::{GridDays, History, HistorySizes, StateFiles};
pub use log::{
    Done,
    groups::Groups,
    record_group::{LogPoint, RecordGroup},
    replay::Replay,
};
pub use map_log::MapLog;
pub use options::StoreOptions;
pub use record::scans::{SCANS_MAX, SEEN_TILES_MAX};
pub use record::spec::{decode_spec, encode_spec};
pub use scrub::Pace;
pub use store::map_copy::{COPY_PART_BYTES, CopyError, CopyPart, CopySource, CopyTotal, MapCopy};
pub use store::{IndexContents, IndexedRows, OpenedMap, SetAside, Sizes, Source, Store};
pub use tidemap_layout::lists::Loss;
pub use tidemap_migrations::{FORMAT as DISK_FORMAT, manifest::is_store_id};
pub use trouble::Trouble;

/// Number of a map within its store, from 1, never reused; also the name of its folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MapId(pub u32);
