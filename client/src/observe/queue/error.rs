//! Errors of the queue.
//!
//! Invariant: an observation whose call returned an error is not in the queue.

use std::{io, path::Path, path::PathBuf};

use super::super::ProducerError;
use crate::{error::Error, observe::occupancy::OccupancyError};

/// Why the queue did not take an observation, cannot be used, or sends nothing now.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the error texts name the variants and fields")]
pub enum QueueError {
    #[error("the queue in {} cannot be used: {detail}", folder.display())]
    Folder { folder: PathBuf, detail: String },
    #[error("another program uses the queue in {}: give each producer a folder of its own", folder.display())]
    InUse { folder: PathBuf },
    #[error(
        "the queue in {} is of {found}, and not of {wanted}: use a folder of its own for each map, producer and label",
        folder.display()
    )]
    OtherStream { folder: PathBuf, found: String, wanted: String },
    /// A file of the queue is damaged or missing.
    #[error(
        "{} of the queue is damaged: {detail}. Move the folder {} away to begin with an empty queue; the observations \
         in it are then not sent",
        file.display(),
        file.parent().unwrap_or(Path::new(".")).display()
    )]
    Damaged { file: PathBuf, detail: String },
    /// There is no room for the observation; it was not taken.
    #[error("the queue is full: {bytes} of {bytes_max} bytes are used; the observation was not taken")]
    Full { bytes: u64, bytes_max: u64 },
    #[error("the disk did not take the observation: {0}")]
    NotWritten(String),
    #[error("the queue cannot be written: {0}")]
    NotSynced(String),
    #[error("the queue was closed")]
    Closed,
    /// The observation is not valid, or the stream to the daemon ended.
    #[error("{0}")]
    Producer(#[from] ProducerError),
    /// The daemon did not describe the map, whose grid is needed now.
    #[error("the grid of the map is not known: {0}")]
    Map(Error),
    /// The daemon cannot be reached now; the observations wait.
    #[error("{0}")]
    Unreachable(Error),
    #[error("the grid is not valid: {0}")]
    Occupancy(#[from] OccupancyError),
    #[error("the daemon counts number {found} where the queue counts {expected}")]
    OutOfStep { found: u64, expected: i128 },
    #[error("after {waited_secs} s the daemon does not have {waiting} observations; they wait in the queue")]
    StillWaiting { waiting: u64, waited_secs: u64 },
}

impl QueueError {
    pub(super) fn folder(folder: &Path, error: &io::Error) -> Self {
        Self::Folder { folder: folder.to_owned(), detail: error.to_string() }
    }

    pub(super) fn damaged(file: &Path, detail: impl Into<String>) -> Self {
        Self::Damaged { file: file.to_owned(), detail: detail.into() }
    }
}
