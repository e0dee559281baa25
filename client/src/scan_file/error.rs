//! Why a file of scans cannot be read.
//!
//! Invariant: an error says at which byte of the file, how many scans before it are whole, and what would be right.

use std::{io, sync::Arc};

use super::MESSAGE_BYTES_MAX;
use tidemap_proto::convert::scans::TileError;

/// Why a file of scans cannot be read.
#[derive(Clone, Debug, thiserror::Error)]
pub enum ScanFileError {
    /// Reading failed.
    #[error("byte {offset}: {error}")]
    Io {
        /// Where.
        offset: u64,
        /// Why.
        error: Arc<io::Error>,
    },
    /// The file is not what it has to be.
    #[error("byte {offset}, after {scans} whole scans: {wrong}")]
    Wrong {
        /// Where the message begins that is wrong.
        offset: u64,
        /// Scans before it.
        scans: u64,
        /// What is wrong.
        wrong: Wrong,
    },
}

/// What is wrong with a file of scans.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Wrong {
    /// Another kind of file.
    #[error("the file begins with {:?}; a file of scans begins with the line \"tidemap scans 1\"", String::from_utf8_lossy(.0))]
    Magic(Vec<u8>),
    /// The end instead of the header.
    #[error("the file ends where its header has to be")]
    NoHeader,
    /// The end in the middle.
    #[error("the file is cut off: {what} takes {needs} bytes and {has} are there; what comes before it counts")]
    CutOff {
        /// What was being read.
        what: &'static str,
        /// Its bytes, or at least so many.
        needs: u64,
        /// Those there.
        has: u64,
    },
    /// The end in the middle of a scan.
    #[error("the file is cut off: its last scan goes on in a batch that is not there; what comes before it counts")]
    Unfinished,
    /// A length that no message has.
    #[error("a message of {0} bytes: at most {MESSAGE_BYTES_MAX} are allowed, so the file is damaged")]
    Length(u64),
    /// No message of that kind.
    #[error("not a message of the kind that has to be here: {0}")]
    Malformed(prost::DecodeError),
    /// Not a length.
    #[error("resolution_m is {0}: it has to be 0 or a positive number")]
    Resolution(f64),
    /// Not a place.
    #[error("origin_m is {0:?}: it has to be three finite numbers, or none")]
    Origin(Vec<f64>),
    /// A batch is missing, or twice there.
    #[error("first_sequence is {found}: it has to be {expected}, one more than the scans before it")]
    Sequence {
        /// What would be right.
        expected: u64,
        /// What is there.
        found: u64,
    },
    /// Scans and times do not match.
    #[error("{scans} scans with {times} times: there has to be a time a scan, and a scan at least")]
    Lengths {
        /// Scans.
        scans: usize,
        /// Times.
        times: usize,
    },
    /// A time that is none.
    #[error("the time of scan {scan} is before 1970 or beyond 2262")]
    Time {
        /// Which.
        scan: u64,
    },
    /// A scan over too many messages.
    #[error("a scan of more than {0} messages")]
    Parts(usize),
    /// A scan that makes no sense.
    #[error("{0}")]
    Tiles(TileError),
}
