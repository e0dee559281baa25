//! Why streams and maps end, and which errors of the log end the daemon.
//!
//! Invariant: after an error that is fatal the daemon serves nothing more, because the content of the disk is unknown.

use tidemap_store::AppendError;

/// Whether the daemon must stop, because the content of the disk is unknown.
pub(crate) fn is_fatal(error: &AppendError) -> bool {
    !matches!(
        error,
        AppendError::DiskFull | AppendError::AfterFailure | AppendError::NotWriter { .. } | AppendError::StreamFull(_)
    )
}

/// Why the server ends a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// The daemon stops.
    Shutdown,
    /// Another stream of the key took over.
    Superseded,
    /// Another stream of the key took over, because the client of this one did not answer.
    Unanswered,
    /// The map was deleted.
    MapDeleted,
    /// Something is erased from the map.
    Erasure,
    /// Another daemon writes the map.
    Moved {
        /// The daemon that does, where it is known.
        writer: Option<String>,
    },
    /// The log of the map and the one that daemons share differ.
    Forked {
        /// The last position that both have.
        common: u64,
    },
    /// A copy of another daemon's map takes its place.
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
