//! Scans of an occupancy grid: what a stream sends, its table of tiles, and the digests by which both sides compare.
//!
//! Entry points: [`ScanDecoder`] for what a server receives, [`TileTable`] for what a client sends.
//!
//! Invariant: both sides keep the same picture of what the stream last showed of each tile. What makes the table itself
//! or the order of the stream ambiguous is an error of the message; what is wrong in one scan refuses that scan, and the
//! picture stays as it was before it. The slots that it names are then in doubt, and only masks end that.

use tidemap_map::{
    grid::{log_head::StreamScan, raycast::Readings},
    ids::RefusalReason,
};

use super::{InvalidField, OverLimit};

mod decode;
mod digest;
mod flips;
mod parts;
mod points;
mod shown;
mod split;
mod table;
#[cfg(test)]
mod tests;
mod tile_scan;

pub use decode::ScanDecoder;
pub use digest::{content_crc, content_digest, points_digest, ranges_digest, tile_digest};
pub use flips::{pack_flips, pack_seen, unpack_flips};
pub use split::{batch, set_times, split};
pub use table::{EncodedScan, TileError, TilePicture, TileTable, join_part, set_masks};

/// Bytes of a mask on the wire.
pub const MASK_BYTES: usize = 64;

/// What one stream may send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScanLimits {
    /// Scans of one message.
    pub batch_scans: usize,
    /// Points or rays of one scan.
    pub points: usize,
    /// Tiles of one scan, and of the stream's table.
    pub tiles: usize,
}

/// Why a message of scans ends its stream.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ScanError {
    /// A field is wrong.
    #[error(transparent)]
    Invalid(#[from] InvalidField),
    /// There is too much of something.
    #[error(transparent)]
    Limit(#[from] OverLimit),
}

/// Why one scan is refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScanRefusal {
    /// The reason to act on.
    pub reason: RefusalReason,
    /// The reason to read.
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

/// What a scan shows.
#[derive(Clone, Debug, PartialEq)]
pub enum ScanContent {
    /// Cells of tiles, within the grid's extent. Where the scan is refused they are only to be remembered: later scans
    /// of the stream refer to them.
    Tiles(StreamScan),
    /// Readings to be cast.
    Readings(Readings),
}

/// One scan with its number.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedScan {
    /// Its sequence number.
    pub sequence: u64,
    /// When it was made, nanoseconds UTC; negative where it is refused for that.
    pub utc_nanos: i64,
    /// Its digest; that of a malformed scan of tiles is 0.
    pub digest: u64,
    /// What it shows; `None` where nothing of it is to be remembered.
    pub content: Option<ScanContent>,
    /// Why it is refused.
    pub refusal: Option<ScanRefusal>,
}
