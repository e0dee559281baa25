//! Scans on one connection: messages within the limits of the daemon, with a table of tiles that starts empty.
//!
//! The slots are the entries of the table of the producer, on every connection. A scan is sent as its difference to the
//! previous scan; a tile that the daemon showed on an earlier connection and has forgotten is sent whole.
//!
//! Invariant: the daemon decodes exactly what the producer has seen; no message exceeds the limits.

use tidemap_grid::{index::TileIndex, mask::TileMasks};
use tidemap_proto::{
    convert::scans::{MASK_BYTES, TilePicture, pack_flips, set_masks, set_times, split, unpack_flips},
    v1::{Scan, ScanBatch, TileScan, scan::Content},
};

use super::window::KeptScan;

/// Upper bounds of one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScanMessageLimits {
    /// Maximum number of scans.
    pub scans: usize,
    /// Maximum number of bytes of the encoded message, at least 4096.
    pub bytes: usize,
}

/// Maximum number of bytes of a message without its scans.
const MESSAGE_BYTES_EXTRA: usize = 128;
/// Maximum number of bytes of a time.
const TIME_BYTES: usize = 10;
/// Maximum number of bytes of the index of a tile.
const TILE_BYTES: usize = 15;
/// Maximum number of bytes of the whole masks of a tile.
const MASKS_BYTES: usize = 5 + 2 * MASK_BYTES;

/// The state of the scan stream on one connection.
#[derive(Clone, Debug)]
pub struct ScanStream {
    /// The tiles after the last sent scan.
    picture: TilePicture,
    /// Number of tiles sent.
    tiles: usize,
    /// Whether a scan of tiles was sent.
    has_sent: bool,
    /// Slots whose tiles the daemon has forgotten.
    forgotten: Vec<bool>,
    forgotten_left: usize,
}

impl ScanStream {
    /// A new connection to a daemon whose last scan showed `base`.
    #[must_use]
    pub fn new(base: &TilePicture) -> Self {
        let forgotten: Vec<bool> = base.all().map(|masks| !masks.observed().is_empty()).collect();
        let forgotten_left = forgotten.iter().filter(|forgotten| **forgotten).count();
        Self { picture: base.clone(), tiles: 0, has_sent: false, forgotten, forgotten_left }
    }

    /// Packs at least one scan and as many as fit: returns their number, and the messages in order.
    pub fn pack<'a>(
        &mut self,
        scans: impl Iterator<Item = &'a KeptScan>,
        tiles: &[TileIndex],
        first_sequence: u64,
        limits: ScanMessageLimits,
    ) -> (usize, Vec<ScanBatch>) {
        let mut bytes = MESSAGE_BYTES_EXTRA;
        let mut times = Vec::new();
        let mut message = ScanBatch { first_sequence, ..ScanBatch::default() };
        for scan in scans.take(limits.scans.max(1)) {
            bytes += self.bytes(scan);
            if bytes > limits.bytes && !times.is_empty() {
                break;
            }
            let content = self.wire(scan);
            message.new_tiles.extend(self.new_tiles(scan, tiles));
            message.scans.push(Scan { content: Some(content) });
            times.push(scan.time_nanos());
        }
        set_times(&mut message, &times);
        // A single scan may be too large for a message.
        let messages = if bytes > limits.bytes { split(message, limits.bytes) } else { vec![message] };
        (times.len(), messages)
    }

    /// Maximum number of bytes of a scan.
    fn bytes(&self, scan: &KeptScan) -> usize {
        let tiles = scan.tiles().saturating_sub(self.tiles) * TILE_BYTES;
        let again = if self.has_sent { 0 } else { self.picture.packed_seen().len() * 5 };
        scan.bytes() + TIME_BYTES + tiles + again + self.forgotten_left * MASKS_BYTES
    }

    fn new_tiles<'a>(&mut self, scan: &KeptScan, tiles: &'a [TileIndex]) -> impl Iterator<Item = i32> + use<'a> {
        let sent = self.tiles;
        self.tiles = sent.max(scan.tiles());
        tiles.get(sent..self.tiles).unwrap_or_default().iter().flat_map(|tile| [tile.x, tile.y, tile.z])
    }

    fn wire(&mut self, kept: &KeptScan) -> Content {
        kept.follow_in(&mut self.picture);
        let Content::Tiles(scan) = kept.content() else { return kept.content().clone() };
        let mut scan = scan.clone();
        if scan.seen.is_empty() && !self.has_sent {
            scan.seen = self.picture.packed_seen();
        }
        self.has_sent = true;
        if self.forgotten_left > 0 {
            self.remind(&mut scan);
        }
        Content::Tiles(scan)
    }

    /// Adds whole masks of the tiles that the daemon has forgotten.
    fn remind(&mut self, scan: &mut TileScan) {
        let mut whole: Vec<(u32, TileMasks)> =
            scan.masked.iter().map(|&slot| (slot, self.picture.masks(slot))).collect();
        for slot in self.picture.seen() {
            if self.forgotten.get_mut(slot as usize).is_some_and(std::mem::take) {
                self.forgotten_left -= 1;
                whole.push((slot, self.picture.masks(slot)));
            }
        }
        whole.sort_unstable_by_key(|(slot, _)| *slot);
        whole.dedup_by_key(|(slot, _)| *slot);
        set_masks(scan, &whole);
        // Whole masks already include the flips.
        let masked: Vec<u32> = whole.iter().map(|(slot, _)| *slot).collect();
        for flips in [&mut scan.observed_flips, &mut scan.occupied_flips] {
            *flips = flips_where(flips, |slot| masked.binary_search(&slot).is_err());
        }
    }
}

/// The flips of some slots.
fn flips_where(packed: &[u32], among: impl Fn(u32) -> bool) -> Vec<u32> {
    let kept: Vec<u32> = unpack_flips(packed).filter(|&cell| among(cell >> 9)).collect();
    pack_flips(&kept)
}

#[cfg(test)]
mod tests;
