//! Scans of an occupancy grid: messages, the table of tiles of a stream, and digests by which both sides compare data.
//!
//! Entry points: [`ScanDecoder`] for what a server receives, [`TileTable`] for what a client sends.
//!
//! Invariant: both sides have the same picture of what the stream last showed of each tile. Ambiguity of the table or
//! of the order of the stream is an error of the message; an error within one scan refuses that scan and leaves the
//! picture unchanged. The slots that it names are then in doubt until their masks are sent.

use tidemap_grid::{log_head::StreamScan, raycast::Readings};
use tidemap_map::ids::RefusalReason;

use super::{InvalidField, OverLimit};

mod decode;
mod decoder_table;
mod digest;
mod flips;
mod message;
mod parts;
mod points;
mod split;
mod table;
#[cfg(test)]
mod tests;
mod tile_error;
mod tile_scan;

pub use decode::ScanDecoder;
pub use digest::{content_crc, content_digest, points_digest, ranges_digest, tile_digest};
pub use flips::{pack_flips, pack_seen, unpack_flips};
pub use message::{ScanMessage, SentRays, SentReadings, scans_from_wire};
pub use split::{batch, set_times, split};
pub use table::{EncodedScan, TilePicture, TileTable, join_part, set_masks};
pub use tile_error::TileError;

/// Bytes of a mask on the wire.
pub const MASK_BYTES: usize = 64;

/// Limits of one stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScanLimits {
    /// Maximum number of scans of one message.
    pub batch_scans: usize,
    /// Maximum number of points or rays of one scan.
    pub points: usize,
    /// Maximum number of tiles of one scan, and of the table of the stream.
    pub tiles: usize,
}

/// Why a message of scans ends its stream.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the error texts name the variants and fields")]
pub enum ScanError {
    #[error(transparent)]
    Invalid(#[from] InvalidField),
    #[error(transparent)]
    Limit(#[from] OverLimit),
}

/// Why one scan is refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScanRefusal {
    /// Reason for programs.
    pub reason: RefusalReason,
    /// Reason in words.
    pub detail: String,
}

impl ScanRefusal {
    fn malformed(detail: impl Into<String>) -> ScanRefusal {
        ScanRefusal { reason: RefusalReason::Scan, detail: detail.into() }
    }
}

impl From<TileError> for ScanRefusal {
    fn from(error: TileError) -> Self {
        Self::malformed(error.to_string())
    }
}

/// The content of a scan.
#[derive(Clone, Debug, PartialEq)]
pub enum ScanContent {
    /// Cells of tiles, within the extent of the grid. If the scan is refused, they must still be remembered: later
    /// scans of the stream refer to them.
    Tiles(StreamScan),
    /// Readings to ray-cast.
    Readings(Readings),
}

/// A decoded scan.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedScan {
    /// Sequence number.
    pub sequence: u64,
    /// Time of the scan, nanoseconds UTC; negative if the scan is refused for its time.
    pub utc_nanos: i64,
    /// Digest; 0 for a malformed scan of tiles.
    pub digest: u64,
    /// Content; `None` if nothing of it must be remembered.
    pub content: Option<ScanContent>,
    /// The refusal, if it is refused.
    pub refusal: Option<ScanRefusal>,
}
