//! Why the store refuses, and what it has repaired.
//!
//! Invariant: a message says what is wrong, in which file and where, and what to do about it.

use std::{fmt, io, path::PathBuf};

use tidemap_migrations::manifest::ManifestError;

use crate::MapId;

/// Why a store or a map cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Another process has it open.
    #[error(
        "{} is in use by another process{}: stop that one first",
        .directory.display(),
        .pid.map_or(String::new(), |pid| format!(" (pid {pid})"))
    )]
    Locked {
        /// The data directory.
        directory: PathBuf,
        /// The other process, where it has said.
        pid: Option<u32>,
    },
    /// The manifest is damaged, of a newer version, or not readable.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// There is data, but nothing that says in which format.
    #[error(
        "{} holds maps but no MANIFEST: restore MANIFEST from a backup of this directory, or name an empty directory",
        .directory.display()
    )]
    ManifestMissing {
        /// The data directory.
        directory: PathBuf,
    },
    /// An older format from which no step leads on.
    #[error("{} has disk format {from}, from which this version cannot migrate", .directory.display())]
    NoMigration {
        /// The data directory.
        directory: PathBuf,
        /// Its format.
        from: u32,
    },
    /// The log of a map is damaged where it may hold acknowledged data.
    #[error(
        "{} is damaged at byte {offset}, record {position}: {reason}. Acknowledged observations may be lost, so it is \
         not opened and nothing has been changed. Restore the folder of this map from a backup, or move it out of \
         the data directory to go on without the map",
        .file.display()
    )]
    CorruptLog {
        /// The segment.
        file: PathBuf,
        /// Where in it.
        offset: u64,
        /// Position of the record that should be there.
        position: u64,
        /// What is wrong.
        reason: String,
    },
    /// A file other than the log is damaged and cannot be rebuilt.
    #[error("{} is damaged: {reason}. Restore it from a backup of this data directory", .file.display())]
    Damaged {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// There is no such map.
    #[error("there is no map number {}", .0.0)]
    UnknownMap(MapId),
    /// The map has been opened already.
    #[error("map number {} is open already", .0.0)]
    AlreadyOpen(MapId),
    /// The disk says no.
    #[error("cannot read or write {}: {source}", .file.display())]
    Io {
        /// The file or folder.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// Why a change other than an append has failed. The store goes on.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// There is no such map.
    #[error("there is no map number {}", .0.0)]
    UnknownMap(MapId),
    /// The snapshot cannot be stored, because it could not be read back.
    #[error("the snapshot of map number {} cannot be stored: {reason}", .map.0)]
    InvalidSnapshot {
        /// The map.
        map: MapId,
        /// What is wrong with it.
        reason: String,
    },
    /// What was written is not what is read back.
    #[error("{} is not read back as it was written: {reason}. Check the disk", .file.display())]
    NotReadBack {
        /// The file.
        file: PathBuf,
        /// What differs.
        reason: String,
    },
    /// There is no space.
    #[error("the disk is full: {} has not been written. Free some space", .file.display())]
    DiskFull {
        /// The file.
        file: PathBuf,
    },
    /// The disk says no.
    #[error("cannot read or write {}: {source}", .file.display())]
    Io {
        /// The file or folder.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// Why history cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum HistoryError {
    /// There is no such map.
    #[error("there is no map number {}", .0.0)]
    UnknownMap(MapId),
    /// A file is damaged. Models do not depend on it.
    #[error(
        "{} is damaged: {reason}. Restore it from a backup of this data directory, or move it away to go on without the \
         exact observations in it",
        .file.display()
    )]
    Damaged {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The disk says no.
    #[error("cannot read or write {}: {source}", .file.display())]
    Io {
        /// The file or folder.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
}

impl StoreError {
    /// Tells a full disk from other errors.
    pub(crate) fn from_io(file: PathBuf, source: io::Error) -> StoreError {
        if is_disk_full(&source) { StoreError::DiskFull { file } } else { StoreError::Io { file, source } }
    }
}

/// Why an append has failed: the event is not in the log.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AppendError {
    /// There is no space. Roll back, call [`MapLog::resume`](crate::MapLog::resume) and try again later.
    #[error("the disk is full: the observation log cannot grow. Free some space")]
    DiskFull,
    /// An earlier append of this map has failed, on which this one depends. Roll back and call
    /// [`MapLog::resume`](crate::MapLog::resume).
    #[error("an earlier append to this map has failed")]
    AfterFailure,
    /// The disk has failed: what it holds is not known any more. Nothing is appended until the process starts again.
    #[error("writing {} has failed: {reason}. Nothing more is accepted; check the disk and restart", .file.display())]
    Poisoned {
        /// The file.
        file: PathBuf,
        /// What the disk said.
        reason: String,
    },
    /// The event could not be read back, so it is not written.
    #[error("the event cannot be stored: {0}")]
    InvalidEvent(&'static str),
    /// The store is closed or the map is deleted.
    #[error("the log is closed")]
    Closed,
}

/// Something that was found and repaired while opening. Nothing that was acknowledged is lost by it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Report {
    /// The end of a log had not been written whole when the process or the machine stopped.
    TornTail {
        /// The segment.
        file: PathBuf,
        /// Bytes that were cut off.
        bytes: u64,
    },
    /// A checkpoint cannot be read; it was renamed and an older state is used.
    CheckpointSetAside {
        /// Its new name.
        file: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The index cannot be read; its folder was renamed and an empty one created.
    IndexSetAside {
        /// Its new name.
        folder: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The index of a map was written again from its checkpoint.
    IndexRebuilt {
        /// The map.
        map: MapId,
        /// Why.
        reason: String,
    },
    /// There is no index; checkpoints and logs do without.
    IndexUnavailable {
        /// Why.
        reason: String,
    },
    /// Something left over from an interrupted operation was removed.
    LeftoverRemoved {
        /// The file or folder.
        file: PathBuf,
    },
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Report::TornTail { file, bytes } => {
                write!(f, "cut {bytes} bytes off the end of {} that had not been written whole", file.display())
            }
            Report::CheckpointSetAside { file, reason } => {
                write!(f, "set a damaged checkpoint aside as {}: {reason}", file.display())
            }
            Report::IndexSetAside { folder, reason } => {
                write!(f, "set the damaged index aside as {}: {reason}", folder.display())
            }
            Report::IndexRebuilt { map, reason } => {
                write!(f, "rebuilt the index of map number {}: {reason}", map.0)
            }
            Report::IndexUnavailable { reason } => write!(f, "going on without the index: {reason}"),
            Report::LeftoverRemoved { file } => write!(f, "removed {}, left by an interruption", file.display()),
        }
    }
}

/// No space on the disk, or none left for this user.
pub(crate) fn is_disk_full(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)
}

/// Names the file of an error while opening.
pub(crate) fn open_io(file: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> OpenError {
    let file = file.into();
    move |source| OpenError::Io { file, source }
}

/// Names the file of an error later on.
pub(crate) fn store_io(file: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> StoreError {
    let file = file.into();
    move |source| StoreError::from_io(file, source)
}
