//! Scans on one connection: messages within the daemon's limits, by a table of tiles that starts empty.
//!
//! Slots are those of the producer's table, on every connection. What differs from an earlier scan is sent as the
//! difference, unless the daemon has forgotten that scan with an earlier connection: then the tile is sent whole.
//!
//! Invariant: what the daemon makes of the messages is what the producer has seen; no message exceeds the limits.

use tidemap_proto::{
    convert::scans::split,
    v1::{Scan, ScanBatch, TileScan, scan::Content},
};

use super::{
    tiles::{Run, Shown, TILE_CELLS, TileMasks, flips, flips_to_wire, masks_to_wire, runs_to_wire},
    window::KeptScan,
};

/// Upper bounds of one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScanLimits {
    /// Scans.
    pub scans: usize,
    /// Bytes of the encoded message, at least 4096.
    pub bytes: usize,
}

/// Most bytes of everything in a message but the scans.
const MESSAGE_BYTES_EXTRA: usize = 128;
/// Most bytes of a time.
const TIME_BYTES: usize = 10;
/// Most bytes of a tile's place.
const TILE_BYTES: usize = 15;
/// Most bytes of a tile's masks, told whole.
const MASKS_BYTES: usize = 5 + 2 * super::tiles::MASK_BYTES;

/// What one connection has been told.
#[derive(Clone, Debug)]
pub struct ScanStream {
    /// What the scan sent last has shown.
    shown: Shown,
    /// Tiles told.
    tiles: usize,
    /// Whether a scan of tiles was sent.
    has_sent: bool,
    /// Slots of which the daemon has forgotten what was shown.
    forgotten: Vec<bool>,
    forgotten_left: usize,
}

impl ScanStream {
    /// A new connection, to a daemon that has the scan which showed `base`.
    #[must_use]
    pub fn new(base: &Shown) -> Self {
        let forgotten: Vec<bool> = base.all().iter().map(|masks| !masks.is_empty()).collect();
        let forgotten_left = forgotten.iter().filter(|forgotten| **forgotten).count();
        Self { shown: base.clone(), tiles: 0, has_sent: false, forgotten, forgotten_left }
    }

    /// Packs scans, at least one and as many as fit: how many, and the messages to send in order.
    pub fn pack<'a>(
        &mut self,
        scans: impl Iterator<Item = &'a KeptScan>,
        tiles: &[[i32; 3]],
        first_sequence: u64,
        limits: ScanLimits,
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
        put_times(&mut message, &times);
        // One scan may be too large for a message.
        let messages = if bytes > limits.bytes { split(message, limits.bytes) } else { vec![message] };
        (times.len(), messages)
    }

    /// Most bytes that a scan takes.
    fn bytes(&self, scan: &KeptScan) -> usize {
        let tiles = scan.tiles().saturating_sub(self.tiles) * TILE_BYTES;
        let again = if self.has_sent { 0 } else { self.shown.seen().len() * 10 };
        scan.bytes() + TIME_BYTES + tiles + again + self.forgotten_left * MASKS_BYTES
    }

    fn new_tiles<'a>(&mut self, scan: &KeptScan, tiles: &'a [[i32; 3]]) -> impl Iterator<Item = i32> + use<'a> {
        let told = self.tiles;
        self.tiles = told.max(scan.tiles());
        tiles.get(told..self.tiles).unwrap_or_default().iter().flatten().copied()
    }

    fn wire(&mut self, kept: &KeptScan) -> Content {
        kept.shown_in(&mut self.shown);
        let Content::Tiles(scan) = kept.content() else { return kept.content().clone() };
        let mut scan = scan.clone();
        if scan.seen.is_empty() && !self.has_sent {
            scan.seen = runs_to_wire(self.shown.seen());
        }
        self.has_sent = true;
        if self.forgotten_left > 0 {
            self.remind(&mut scan);
        }
        Content::Tiles(scan)
    }

    /// Tells the tiles whole that the daemon has forgotten.
    fn remind(&mut self, scan: &mut TileScan) {
        let mut whole: Vec<(u32, TileMasks)> = scan.masked.iter().map(|&slot| (slot, self.shown.masks(slot))).collect();
        for slot in self.shown.seen().iter().flat_map(Run::slots) {
            if self.forgotten.get_mut(slot as usize).is_some_and(std::mem::take) {
                self.forgotten_left -= 1;
                whole.push((slot, self.shown.masks(slot)));
            }
        }
        whole.sort_unstable_by_key(|(slot, _)| *slot);
        whole.dedup_by_key(|(slot, _)| *slot);
        masks_to_wire(scan, &whole);
        // Whole masks are as the flips leave them.
        let masked: Vec<u32> = whole.iter().map(|(slot, _)| *slot).collect();
        for flips in [&mut scan.observed_flips, &mut scan.occupied_flips] {
            *flips = flips_where(flips, |slot| masked.binary_search(&slot).is_err());
        }
    }
}

/// The flips of some slots.
fn flips_where(packed: &[u32], among: impl Fn(u32) -> bool) -> Vec<u32> {
    let slot_of = |cell: u64| u32::try_from(cell / u64::from(TILE_CELLS)).unwrap_or(u32::MAX);
    let kept: Vec<u64> = flips(packed).filter(|&cell| among(slot_of(cell))).collect();
    flips_to_wire(&kept)
}

fn put_times(message: &mut ScanBatch, times: &[i64]) {
    let deltas = || times.windows(2).map(|pair| pair[1].wrapping_sub(pair[0]));
    let unit = deltas().fold(0_u64, |unit, delta| divisor(unit, delta.unsigned_abs()));
    let unit = i64::try_from(unit).unwrap_or(1).max(1);
    message.time_unit_nanos = unit.unsigned_abs();
    message.first_time_nanos = times.first().copied().unwrap_or_default();
    message.time_deltas = times.first().map(|_| 0).into_iter().chain(deltas().map(|delta| delta / unit)).collect();
}

fn divisor(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
mod tests;
