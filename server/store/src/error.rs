//! Errors of the store, and what it repaired while opening.
//!
//! Invariant: a message states what is wrong, in which file and where, and what the user can do about it.

use std::{
    fmt, io,
    path::{Path, PathBuf},
};

use tidemap_map::{erasure::NotErasable, name::ProducerKey};
use tidemap_migrations::{manifest::ManifestError, plan::MigrateError};

use crate::MapId;

const NANOS_PER_SEC: i64 = 1_000_000_000;

/// The path of a file within its data directory, because errors reach clients, which must not learn where that is.
pub(crate) fn shown(file: &Path) -> String {
    let parts: Vec<_> = file.iter().map(|part| part.to_string_lossy()).collect();
    // The last such folder: the data directory itself may lie in one.
    let start = parts.iter().rposition(|part| part == "maps" || part == "index");
    parts.get(start.unwrap_or(parts.len().saturating_sub(1))..).unwrap_or_default().join("/")
}

/// Why a store or a map cannot be opened.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the fields are named in the message")]
pub enum OpenError {
    /// Another process has it open.
    #[error(
        "{} is in use by another process{}: stop that one first",
        .directory.display(),
        .pid.map_or(String::new(), |pid| format!(" (pid {pid})"))
    )]
    Locked { directory: PathBuf, pid: Option<u32> },
    /// The manifest is damaged, of a newer version, or not readable.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// There are maps but no manifest, so the format is unknown.
    #[error(
        "{} holds maps but no MANIFEST: restore MANIFEST from a backup of this directory, or name an empty directory",
        .directory.display()
    )]
    ManifestMissing { directory: PathBuf },
    /// The directory has an older format, and was not brought to the format of this version.
    #[error("{}: {source}", .directory.display())]
    NotMigrated { directory: PathBuf, source: MigrateError },
    /// The log of a map is damaged where it may hold acknowledged data.
    #[error(
        "{} is damaged at byte {offset}, record {position}: {reason}. Acknowledged observations may be lost, so it is \
         not opened and nothing has been changed. Restore the folder of this map from a backup, or move it out of \
         the data directory to continue without the map",
        shown(.file)
    )]
    CorruptLog { file: PathBuf, offset: u64, position: u64, reason: String },
    /// A file other than the log is damaged and cannot be rebuilt.
    #[error("{} is damaged: {reason}. Restore it from a backup of this data directory", shown(.file))]
    Damaged { file: PathBuf, reason: String },
    /// A list of what must exist is missing or damaged, and it is not proven that all is there.
    #[error(
        "{} is lost: {problem}. It lists what must exist, so acknowledged observations may be lost with it. Stop the \
         daemon and run tidemapd check, which shows what to do",
        shown(.file)
    )]
    ListLost { file: PathBuf, problem: String },
    /// The data directory is not the one that is expected.
    #[error(
        "{} {}, and the setting expect_store_id is {expected}: is the disk with the data mounted? Nothing has been \
         changed. If this folder is the right one, change the setting",
        .directory.display(),
        .found.as_ref().map_or_else(|| "holds no data yet".to_owned(), |found| format!("has the store id {found}"))
    )]
    OtherStore { directory: PathBuf, expected: String, found: Option<String> },
    /// There is no such map.
    #[error("there is no map number {}", .0.0)]
    UnknownMap(MapId),
    /// The map has been opened already.
    #[error("map number {} is open already", .0.0)]
    AlreadyOpen(MapId),
    /// The disk returned an error.
    #[error("cannot read or write {}: {source}", shown(.file))]
    Io { file: PathBuf, source: io::Error },
}

/// Why a change other than an append has failed. The store stays usable.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the fields are named in the message")]
pub enum StoreError {
    /// There is no such map.
    #[error("there is no map number {}", .0.0)]
    UnknownMap(MapId),
    /// The snapshot is invalid: it could not be read back.
    #[error("the snapshot of map number {} cannot be stored: {reason}", .map.0)]
    InvalidSnapshot { map: MapId, reason: String },
    /// The bytes read back differ from the bytes written.
    #[error("{} is not read back as it was written: {reason}. Check the disk", shown(.file))]
    NotReadBack { file: PathBuf, reason: String },
    /// A list of what must exist is missing or damaged; a new one would hide what is lost.
    #[error(
        "{} is lost: {problem}. Nothing is written that would hide what is lost. Stop the daemon and run tidemapd \
         check, which shows what to do",
        shown(.file)
    )]
    ListLost { file: PathBuf, problem: String },
    /// The disk is full.
    #[error("the disk is full: {} has not been written. Free some space", shown(.file))]
    DiskFull { file: PathBuf },
    /// The disk returned an error.
    #[error("cannot read or write {}: {source}", shown(.file))]
    Io { file: PathBuf, source: io::Error },
}

/// Why history cannot be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the fields are named in the message")]
pub enum HistoryError {
    /// There is no such map.
    #[error("there is no map number {}", .0.0)]
    UnknownMap(MapId),
    /// A history file is damaged. The models of the map do not depend on it.
    #[error(
        "{} is damaged: {reason}. Restore it from a backup of this data directory; the models are not affected",
        shown(.file)
    )]
    Damaged { file: PathBuf, reason: String },
    /// A history file that must exist is missing. The models of the map do not depend on it.
    #[error(
        "{} is missing: observations from {} to {} s after 1970-01-01T00:00:00Z are lost. Restore it from a backup of \
         this data directory; the models are not affected",
        shown(.file), .from_nanos.div_euclid(NANOS_PER_SEC), .to_nanos.div_euclid(NANOS_PER_SEC)
    )]
    Missing { file: PathBuf, from_nanos: i64, to_nanos: i64 },
    /// The disk returned an error.
    #[error("cannot read or write {}: {source}", shown(.file))]
    Io { file: PathBuf, source: io::Error },
}

impl StoreError {
    /// Distinguishes a full disk from other errors.
    pub(crate) fn from_io(file: PathBuf, source: io::Error) -> StoreError {
        if is_disk_full(&source) { StoreError::DiskFull { file } } else { StoreError::Io { file, source } }
    }

    /// This error, where it keeps a store from being opened. `folder` is named where the error names no file.
    pub(crate) fn opening(self, folder: &Path) -> OpenError {
        match self {
            StoreError::Io { file, source } => OpenError::Io { file, source },
            other => OpenError::Io { file: folder.to_owned(), source: io::Error::other(other.to_string()) },
        }
    }
}

/// Why an append has failed: the event is not in the log.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the fields are named in the message")]
pub enum AppendError {
    /// The disk is full. Roll back, call [`MapLog::resume`](crate::MapLog::resume) and try again later.
    #[error("the disk is full: the observation log cannot grow. Free some space")]
    DiskFull,
    /// An earlier append of this map has failed, on which this one depends. Roll back and call
    /// [`MapLog::resume`](crate::MapLog::resume).
    #[error("an earlier append to this map has failed")]
    AfterFailure,
    /// The disk failed, so its content is unknown. Nothing is appended until the process restarts.
    #[error("writing {} has failed: {reason}. Nothing more is accepted; check the disk and restart", shown(.file))]
    Poisoned { file: PathBuf, reason: String },
    /// The event is invalid: it could not be read back, so it was not written.
    #[error("the event cannot be stored: {0}")]
    InvalidEvent(&'static str),
    /// The store is closed or the map is deleted.
    #[error("the log is closed")]
    Closed,
    /// Another daemon writes the log, which daemons share.
    #[error(
        "this daemon does not write the map{}: send it to the writer",
        writer.as_ref().map_or_else(String::new, |writer| format!(", {writer} does"))
    )]
    NotWriter {
        /// The daemon that does, where it is known.
        writer: Option<String>,
    },
    /// The stream of the shared log has reached its limit. Roll back, call
    /// [`EventLog::resume`](crate::EventLog::resume) and try again later.
    #[error("the shared log cannot grow: {0}. Raise the limit of its stream, or free space on the engine's servers")]
    StreamFull(String),
}

fn has_sent(key: &ProducerKey) -> String {
    format!("producer {:?} with label {:?} has sent", key.producer(), key.label())
}

/// Why something is not erased.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the fields are named in the message")]
pub enum EraseError {
    /// Nothing is changed, because the erasure cannot be done exactly.
    #[error(transparent)]
    NotErasable(#[from] NotErasable),
    /// Nothing is changed, because scans cannot be taken out of a grid.
    #[error(
        "{} scans of the grid, which cannot be removed from it. Name a state: its observations can be erased. To erase \
         the grid, delete the map",
        producer.as_ref().map_or_else(|| "the map has".to_owned(), has_sent)
    )]
    HasScans {
        /// The producer that has sent them; `None`: some producer of the map.
        producer: Option<ProducerKey>,
    },
    /// The map cannot be read.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The history cannot be read.
    #[error(transparent)]
    History(#[from] HistoryError),
    /// The new files cannot be written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The new log cannot be written.
    #[error(transparent)]
    Log(#[from] AppendError),
    /// The index still holds what was erased from the map.
    #[error("the map is without it, but the index is not: {reason}. Restart the daemon, which tries it again")]
    Index { reason: String },
}

/// A repair that was made while opening. No acknowledged observation is lost by a repair.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the fields are named in the message")]
pub enum Repair {
    /// The end of a log had not been written whole when the process or the machine stopped. The last `zero_bytes` bytes
    /// of it are zero: their earlier contents are not known.
    TornTail { file: PathBuf, bytes: u64, zero_bytes: u64 },
    /// A checkpoint cannot be read; it was renamed and an older one is used.
    CheckpointSetAside { file: PathBuf, reason: String },
    /// The disk or the machine refuses to read a checkpoint. It stays where it is, and an older one is used.
    CheckpointNotRead { file: PathBuf, reason: String },
    /// The index cannot be read; its folder was renamed and an empty one created.
    IndexSetAside { folder: PathBuf, reason: String },
    /// A list of the files that must exist was damaged or missing. Other files prove that all are there, and it was
    /// made again.
    ListMade { file: PathBuf, reason: String },
    /// A file that must exist is missing, and nothing is lost by it: others hold the same.
    SpareMissing { file: PathBuf },
    /// A map is listed, but was not; its creation was interrupted, or its folder was put there.
    MapListed { map: MapId },
    /// The index of a map was written again from its checkpoint.
    IndexRebuilt { map: MapId, reason: String },
    /// There is no index; checkpoints and logs do not need it, and it is tried again.
    IndexUnavailable { reason: String },
    /// The index can be used again.
    IndexRecovered,
    /// A leftover of an interrupted operation was removed.
    LeftoverRemoved { file: PathBuf },
    /// An erasure that was interrupted has been completed.
    ErasureCompleted { map: MapId },
    /// A copy of a map has taken the map's place, which was interrupted.
    CopyCompleted { map: MapId },
}

impl fmt::Display for Repair {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Repair::TornTail { file, bytes, zero_bytes: 0 } => {
                write!(f, "cut {bytes} bytes off the end of {} that had not been written whole", shown(file))
            }
            Repair::TornTail { file, bytes, zero_bytes } => {
                write!(f, "cut {bytes} bytes off the end of {}: {}", shown(file), zeroed_tail(*zero_bytes))
            }
            Repair::CheckpointSetAside { file, reason } => {
                write!(f, "set a damaged checkpoint aside as {}: {reason}", shown(file))
            }
            Repair::CheckpointNotRead { file, reason } => write!(
                f,
                "did not use the checkpoint {}, which cannot be read from the disk: {reason}. It may be sound and \
                 stays where it is; an older one or the log is used",
                shown(file)
            ),
            Repair::IndexSetAside { folder, reason } => {
                write!(f, "set the damaged index aside as {}: {reason}", shown(folder))
            }
            Repair::ListMade { file, reason } => {
                write!(f, "made {} again of the files that exist, which prove to be all: {reason}", shown(file))
            }
            Repair::SpareMissing { file } => {
                write!(f, "{} is missing. Nothing is lost by it, but find out who removed it", shown(file))
            }
            Repair::MapListed { map } => write!(f, "listed map number {}, which was not listed", map.0),
            Repair::IndexRebuilt { map, reason } => {
                write!(f, "rebuilt the index of map number {}: {reason}", map.0)
            }
            Repair::IndexUnavailable { reason } => {
                write!(f, "continuing without the index, which stays as it is and is tried again: {reason}")
            }
            Repair::IndexRecovered => write!(f, "the index can be used again"),
            Repair::LeftoverRemoved { file } => write!(f, "removed {}, left by an interruption", shown(file)),
            Repair::ErasureCompleted { map } => {
                write!(f, "completed an erasure from map number {}, which was interrupted", map.0)
            }
            Repair::CopyCompleted { map } => {
                write!(f, "put the copy of map number {} in its place, which was interrupted", map.0)
            }
        }
    }
}

/// Describes zeros at the end of a log.
pub(crate) fn zeroed_tail(zero_bytes: u64) -> String {
    format!("the last {zero_bytes} bytes are zero; records that were there may have been acknowledged")
}

/// No space on the disk, or none left for this user.
pub(crate) fn is_disk_full(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)
}

impl OpenError {
    /// Whether the machine lacks something for now: memory or descriptors. The data may be sound.
    #[must_use]
    pub fn is_shortage(&self) -> bool {
        match self {
            OpenError::Io { source, .. } => is_shortage(source),
            OpenError::NotMigrated { source: MigrateError::Step { source, .. }, .. } => is_shortage(source),
            _ => false,
        }
    }
}

impl HistoryError {
    /// Whether the machine lacks something for now: memory or descriptors. The data may be sound.
    #[must_use]
    pub fn is_shortage(&self) -> bool {
        matches!(self, HistoryError::Io { source, .. } if is_shortage(source))
    }
}

/// Whether the machine lacks something for now: memory, or descriptors of the process or the system.
pub(crate) fn is_shortage(error: &io::Error) -> bool {
    use rustix::io::Errno;
    let shortages = [Errno::MFILE, Errno::NFILE, Errno::NOMEM].map(Errno::raw_os_error);
    error.raw_os_error().is_some_and(|code| shortages.contains(&code))
}

/// Errors of the system that describe what a path leads to, or how it was used; all others come from the disk or the
/// machine.
const OF_CONTENT: [rustix::io::Errno; 7] = {
    use rustix::io::Errno;
    [Errno::NOENT, Errno::NOTDIR, Errno::ISDIR, Errno::EXIST, Errno::NOTEMPTY, Errno::LOOP, Errno::INVAL]
};

/// Whether the disk or the machine refuses, by the number of the system's error: a full or read-only disk, a file that
/// may not be read, a lack of descriptors or memory, a disk that fails. Such an error gives no information about the
/// contents of a file.
pub(crate) fn is_of_machine_code(code: i32) -> bool {
    code != 0 && OF_CONTENT.iter().all(|of_content| of_content.raw_os_error() != code)
}

/// Whether the disk or the machine refuses, which gives no information about the contents of a file.
pub(crate) fn is_of_machine(error: &io::Error) -> bool {
    use io::ErrorKind;
    match error.raw_os_error() {
        Some(code) => is_of_machine_code(code),
        // A copied error has only its kind left.
        None => matches!(
            error.kind(),
            ErrorKind::StorageFull
                | ErrorKind::QuotaExceeded
                | ErrorKind::ReadOnlyFilesystem
                | ErrorKind::PermissionDenied
                | ErrorKind::OutOfMemory
                | ErrorKind::TimedOut
                | ErrorKind::StaleNetworkFileHandle
        ),
    }
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
