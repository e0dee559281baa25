//! The reasons why streams and maps end, and the errors of the log that end the daemon.
//!
//! Invariant: after a fatal error the daemon serves nothing more, because the content of the disk is unknown.

use tidemap_store::AppendError;

/// Whether the daemon must stop, because the content of the disk is unknown.
pub fn is_fatal(error: &AppendError) -> bool {
    !matches!(
        error,
        AppendError::DiskFull | AppendError::AfterFailure | AppendError::NotWriter { .. } | AppendError::StreamFull(_)
    )
}

/// The reason why the server ends a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The daemon stops.
    Shutdown,
    /// Another stream of the key took over.
    Superseded,
    /// Another stream of the key took over, because the client of this one did not reply.
    Unanswered,
    /// The map was deleted.
    MapDeleted,
    /// An erasure from the map has begun.
    Erasure,
    /// Another daemon writes the map.
    Moved {
        /// The daemon that writes the map, where it is known.
        writer: Option<String>,
    },
    /// The log of the map and the shared log differ.
    Forked {
        /// The last position that both logs have.
        common: u64,
    },
    /// A copy of another daemon's map replaces the map.
    Replaced,
    /// The log could not be written.
    Storage(AppendError),
}

impl From<AppendError> for Ending {
    fn from(error: AppendError) -> Self {
        match error {
            AppendError::NotWriter { writer } => Self::Moved { writer },
            error => Self::Storage(error),
        }
    }
}
