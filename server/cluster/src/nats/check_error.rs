//! The reasons why the servers of NATS cannot be used.
//!
//! Invariant: each names the server, its value and the setting that helps.

use crate::engine::EngineError;

/// The oldest version of the server that is known to keep the order of appends.
pub const VERSION_LEAST: (u64, u64, u64) = (2, 15, 1);

/// The reason why the engine cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NatsCheckError {
    /// A server is too old.
    #[error(
        "nats-server {server} has version {version}; {}.{}.{} is the oldest that may be used: older ones can let two \
         writers append at one position", VERSION_LEAST.0, VERSION_LEAST.1, VERSION_LEAST.2
    )]
    Version {
        /// The server's name.
        server: String,
        /// The server's version.
        version: String,
    },
    /// A server acknowledges before it has made a message durable.
    #[error(
        "nats-server {server} acknowledges before it writes to the disk: set `sync_interval: always` in `jetstream`"
    )]
    NotSynced {
        /// The server's name.
        server: String,
    },
    /// A server does not accept messages as large as tidemap's.
    #[error("nats-server {server} accepts messages of at most {bytes} bytes: set `max_payload: 2MB`")]
    Payload {
        /// The server's name.
        server: String,
        /// The server's limit.
        bytes: usize,
    },
    /// The servers did not report their properties.
    #[error(transparent)]
    Engine(#[from] EngineError),
}
