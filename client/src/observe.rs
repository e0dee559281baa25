//! Sending observations, scans and reports, each exactly once.
//!
//! [`Producer`] is the handle for callers; it keeps observations in memory. [`QueuedProducer`] is the handle for
//! robots; it keeps them in files. Behind both: [`window`] decides what is sent, kept and dropped, without any I/O;
//! [`columns`] packs observations; [`scan_stream`] packs scans; [`retry`] decides when to try again; `link` exchanges
//! messages with the daemon.
//!
//! Invariant: an observation gets its sequence number at once and is kept until the daemon reports that it is durable,
//! even if connections break.

pub mod columns;
pub mod content;
mod link;
pub mod occupancy;
mod outgoing;
mod producer;
mod queue;
mod replay;
pub mod retry;
pub mod scan;
pub mod scan_stream;
mod shared;
pub mod window;

pub use producer::Producer;
pub use queue::{QueueError, QueueOptions, QueueState, QueuedProducer};
pub use replay::Replay;
pub use shared::{Phase, ProducerOptions, Progress};
pub use tidemap_proto::convert::{sightings::SightingReport, traversals::TraversalReport};

/// Tiles of a grid, and the table by which scans of them are sent as differences.
pub mod tiles {
    pub use tidemap_grid::{
        index::TileIndex,
        mask::{Mask, TileMasks},
    };
    pub use tidemap_proto::convert::scans::{MASK_BYTES, TileError, TilePicture, TileTable, pack_seen};
}

pub use tidemap_grid::sensors::ProducerSensor;
pub use tidemap_map::ids::RefusalReason;

use crate::error::Error;

/// Maximum number of bytes of the name of a state: the longest name of an edge, with 4 bytes per character. Other names
/// have at most 128 characters; the daemon refuses longer ones.
pub const STATE_NAME_BYTES_MAX: usize = 4 * tidemap_map::name::EDGE_STATE_CHARS_MAX;

/// An observation that the daemon refused. It used its sequence number.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Sequence number.
    pub sequence: u64,
    /// Reason for programs; `None`: a reason that this version does not know.
    pub reason: Option<RefusalReason>,
    /// Reason in words.
    pub detail: String,
}

/// Why a producer ended, or cannot do what the caller requested. Everything acknowledged before stays durable.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the error texts name the variants and fields")]
pub enum ProducerError {
    #[error("the producer was closed")]
    Closed,
    #[error("gave up after {waited_secs} s: {last}")]
    GaveUp { waited_secs: u64, last: Error },
    /// A newer stream of the same producer and label took over.
    #[error("{0}")]
    Superseded(String),
    /// Another stream holds the key.
    #[error("{0}")]
    KeyInUse(String),
    /// Observations that the daemon has came again with other content; it has counted nothing twice.
    #[error("{0}")]
    DataMismatch(String),
    #[error("the daemon found a gap in the sequence numbers: {0}")]
    OutOfSequence(String),
    /// The disk of the daemon is full, or a limit is reached.
    #[error("{0}")]
    Exhausted(String),
    /// The map does not exist.
    #[error("{0}")]
    MapNotFound(String),
    /// The map was deleted.
    #[error("{0}")]
    MapDeleted(String),
    /// The daemon received an invalid message.
    #[error("{0}")]
    Invalid(String),
    #[error("the daemon's storage failed: {0}")]
    Storage(String),
    #[error(
        "the daemon has observations up to number {durable} only, but acknowledged those up to {acknowledged} earlier; \
         those between are no longer kept here (was a backup restored?)"
    )]
    Lost { durable: u64, acknowledged: u64 },
    #[error("the daemon has observations up to number {durable}, but only {sent} were sent from here")]
    Foreign { durable: u64, sent: u64 },
    #[error("observations 1 to {durable} of the daemon differ from those sent from here")]
    Differs { durable: u64 },
    #[error("the scan is invalid: {0}")]
    Tiles(#[from] tidemap_proto::convert::scans::TileError),
    #[error("time {0} ns is before 1970")]
    TimeBefore1970(i64),
    #[error("{0} coordinates: a position has 2 or 3")]
    Coordinates(usize),
    #[error("a state's name of {0} bytes is too long: at most 128 characters are allowed")]
    NameTooLong(usize),
    /// Another error of the daemon, or of the connection.
    #[error("{0}")]
    Other(Error),
}
