//! Errors of reading a file of scans.
//!
//! Invariant: an error gives the position in the file, the number of complete scans before it, and the valid form.

use std::{io, sync::Arc};

use super::MESSAGE_BYTES_MAX;
use tidemap_proto::convert::scans::TileError;

/// Errors of reading a file of scans.
#[derive(Clone, Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the error texts name the variants and fields")]
pub enum ScanFileError {
    #[error("byte {offset}: {error}")]
    Io { offset: u64, error: Arc<io::Error> },
    #[error("byte {offset}, after {scans} whole scans: {wrong}")]
    Wrong { offset: u64, scans: u64, wrong: ScanFileFault },
}

/// The fault of a file of scans.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the error texts name the variants and fields")]
pub enum ScanFileFault {
    #[error(
        "the file begins with {:?}; a file of scans begins with the line \"tidemap scans 1\"",
        String::from_utf8_lossy(.0)
    )]
    Magic(Vec<u8>),
    #[error("the file ends before its header")]
    NoHeader,
    #[error("the file is truncated: {what} takes {needs} bytes, but there are {has}; everything before it is valid")]
    CutOff { what: &'static str, needs: u64, has: u64 },
    #[error("the file is truncated: its last scan continues in a missing batch; everything before it is valid")]
    Unfinished,
    #[error("a message of {0} bytes: at most {MESSAGE_BYTES_MAX} are allowed, so the file is damaged")]
    Length(u64),
    #[error("not a valid message here: {0}")]
    Malformed(prost::DecodeError),
    #[error("resolution_m is {0}: it must be 0 or a positive number")]
    Resolution(f64),
    #[error("origin_m is {0:?}: it must be three finite numbers, or none")]
    Origin(Vec<f64>),
    #[error("first_sequence is {found}: it must be {expected}, one more than the scans before it")]
    Sequence { expected: u64, found: u64 },
    #[error("{scans} scans with {times} times: there must be one time per scan, and at least one scan")]
    Lengths { scans: usize, times: usize },
    #[error("the time of scan {scan} is before 1970 or beyond 2262")]
    Time { scan: u64 },
    #[error("a scan of more than {0} messages")]
    Parts(usize),
    #[error("{0}")]
    Tiles(TileError),
}
