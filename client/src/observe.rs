//! Sending observations, scans and traversals, each exactly once.
//!
//! [`Producer`] is what callers use. Behind it: [`window`] decides what is sent, kept and given up, without any I/O;
//! [`columns`] packs observations; [`scan_stream`] packs scans; [`retry`] decides when to try again; `link`
//! does the talking.
//!
//! Invariant: an observation handed to a producer is given its sequence number at once and is kept until the daemon
//! says that it is durable, whatever happens to connections in between.

pub mod columns;
pub mod content;
mod link;
mod outgoing;
mod producer;
mod replay;
pub mod retry;
pub mod scan;
pub mod scan_stream;
mod shared;
mod traversal;
pub mod window;

pub use producer::Producer;
pub use replay::Replay;
pub use shared::{Phase, ProducerOptions, Progress};
pub use traversal::Traversal;

/// Tiles of a grid, and the table by which scans of them are sent as differences.
pub mod tiles {
    pub use tidemap_map::grid::{
        index::TileIndex,
        mask::{Mask, TileMasks},
    };
    pub use tidemap_proto::convert::scans::{MASK_BYTES, TileError, TilePicture, TileTable, pack_seen};
}

pub use tidemap_map::{grid::sensors::ProducerSensor, ids::RefusalReason};

use crate::error::Error;

/// Most bytes of a state's name that is sent: the longest of an edge, with 4 bytes a character. Others have at most 128
/// characters; the daemon refuses longer ones.
pub const STATE_NAME_BYTES_MAX: usize = 4 * tidemap_map::name::EDGE_STATE_CHARS_MAX;

/// An observation that the daemon refused. It used up its sequence number.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Which.
    pub sequence: u64,
    /// The reason to act on.
    /// `None`: a reason that this version does not know.
    pub reason: Option<RefusalReason>,
    /// The reason to read.
    pub detail: String,
}

/// Why a producer ended, or what it was asked cannot be done. Everything acknowledged before stays durable.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ProducerError {
    /// It was closed.
    #[error("the producer was closed")]
    Closed,
    /// No way to the daemon for longer than the patience allows.
    #[error("gave up after {waited_secs} s: {last}")]
    GaveUp {
        /// How long.
        waited_secs: u64,
        /// The failure of the last attempt.
        last: Error,
    },
    /// A newer stream of the same producer and label took over.
    #[error("{0}")]
    Superseded(String),
    /// The key is in use.
    #[error("{0}")]
    KeyInUse(String),
    /// The daemon found a gap in the sequence numbers.
    #[error("the daemon found a gap in the sequence numbers: {0}")]
    OutOfSequence(String),
    /// The disk of the daemon is full, or a limit is reached.
    #[error("{0}")]
    Exhausted(String),
    /// The map does not exist.
    #[error("{0}")]
    MapNotFound(String),
    /// The map was deleted meanwhile.
    #[error("{0}")]
    MapDeleted(String),
    /// The daemon could not make sense of a message.
    #[error("{0}")]
    Invalid(String),
    /// The daemon's storage failed.
    #[error("the daemon's storage failed: {0}")]
    Storage(String),
    /// The daemon lacks observations that it had acknowledged and that are no longer kept here.
    #[error(
        "the daemon has observations up to number {durable} only, but acknowledged those up to {acknowledged} earlier; \
         those between are no longer kept here (was a backup restored?)"
    )]
    Lost {
        /// What the daemon has now.
        durable: u64,
        /// What it had acknowledged.
        acknowledged: u64,
    },
    /// The daemon has observations that this producer never sent.
    #[error("the daemon has observations up to number {durable}, but only {sent} were sent from here")]
    Foreign {
        /// What the daemon has.
        durable: u64,
        /// What was sent.
        sent: u64,
    },
    /// The daemon has other observations than were sent.
    #[error("what the daemon has as observations 1 to {durable} differs from what was sent from here")]
    Differs {
        /// What the daemon has.
        durable: u64,
    },
    /// A scan that makes no sense.
    #[error("the scan makes no sense: {0}")]
    Tiles(#[from] tidemap_proto::convert::scans::TileError),
    /// A time before 1970 cannot be sent.
    #[error("time {0} ns is before 1970")]
    TimeBefore1970(i64),
    /// A position has 2 or 3 coordinates.
    #[error("{0} coordinates are no position: 2 or 3 are")]
    Coordinates(usize),
    /// A name that long cannot be sent.
    #[error("a state's name of {0} bytes is too long: at most 128 characters are allowed")]
    NameTooLong(usize),
    /// Anything else that the daemon, or the way there, says.
    #[error("{0}")]
    Other(Error),
}
