//! Scans of tiles as a client sends them: what was sent is remembered, and only what differs is sent.
//!
//! Invariant: a decoder that takes the encoded scans of one encoder in their order has the same picture of every tile.
//! A new stream needs a new encoder.

use std::collections::HashMap;

use tidemap_map::grid::{
    front::SlotCell,
    index::TileIndex,
    mask::{Mask, TileMasks},
};

use super::{
    digest::{index_crc, masks_digest},
    flips::{pack_flips, pack_seen},
    shown::LAYER,
};
use crate::v1;

/// Bytes of both masks of a tile with its slot, about.
const MASKS_BYTES: u32 = 130;
/// Bytes of the occupied mask alone with its slot, about.
const OCCUPIED_BYTES: u32 = 66;

/// A scan for the wire.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedScan {
    /// The scan.
    pub scan: v1::TileScan,
    /// Tiles that are to be added to the stream's table in the same message, or an earlier one.
    pub new_tiles: Vec<TileIndex>,
    /// Its digest.
    pub digest: u64,
}

#[derive(Debug)]
struct Slot {
    masks: TileMasks,
    index_crc: u32,
    digest: u64,
}

/// What one stream has sent of its tiles.
#[derive(Debug)]
pub struct ScanEncoder {
    all: Mask,
    ids: HashMap<TileIndex, u32>,
    slots: Vec<Slot>,
    new_tiles: Vec<TileIndex>,
    seen: Vec<u32>,
    digest: u64,
    changes: Vec<(u32, TileMasks)>,
}

impl ScanEncoder {
    /// A stream that has sent nothing, to a map whose grid is flat or not.
    #[must_use]
    pub fn new(is_flat: bool) -> ScanEncoder {
        ScanEncoder {
            all: if is_flat { LAYER } else { Mask::FULL },
            ids: HashMap::new(),
            slots: Vec::new(),
            new_tiles: Vec::new(),
            seen: Vec::new(),
            digest: 0,
            changes: Vec::new(),
        }
    }

    /// Number of tiles in the stream's table.
    #[must_use]
    pub fn tiles_known(&self) -> usize {
        self.slots.len()
    }

    /// The slot of a tile, which is added to the stream's table where it is new.
    pub fn slot(&mut self, index: TileIndex) -> u32 {
        let next = u32::try_from(self.slots.len()).unwrap_or(u32::MAX);
        let slot = *self.ids.entry(index).or_insert(next);
        if slot == next {
            let (masks, index_crc) = (TileMasks::default(), index_crc(index));
            self.slots.push(Slot { masks, index_crc, digest: masks_digest(index_crc, &masks) });
            self.new_tiles.push(index);
        }
        slot
    }

    /// A scan that shows these tiles; of a tile that is named twice the last masks count. `None` where there is no tile:
    /// such a scan shows nothing, and cannot be sent.
    pub fn tiles(&mut self, tiles: &[(TileIndex, TileMasks)]) -> Option<EncodedScan> {
        if tiles.is_empty() {
            return None;
        }
        let mut shown: Vec<(u32, TileMasks)> = tiles.iter().map(|(index, masks)| (self.slot(*index), *masks)).collect();
        // Stable, so that the last of a tile is the last of its slot.
        shown.sort_by_key(|(slot, _)| *slot);
        shown.reverse();
        shown.dedup_by_key(|(slot, _)| *slot);
        shown.reverse();
        let seen: Vec<u32> = shown.iter().map(|(slot, _)| *slot).collect();
        self.changes.clear();
        for (slot, masks) in shown {
            if self.slots.get(slot as usize).is_some_and(|known| known.masks != masks) {
                self.changes.push((slot, masks));
            }
        }
        Some(self.encode((seen != self.seen).then_some(seen)))
    }

    /// A scan that shows these slots, ascending (`None`: the same as the scan before), with the cells of them whose bits
    /// differ from what was last sent, ascending. Cells of slots that there are not are left out. `None` where no slot is
    /// shown.
    pub fn flips(
        &mut self,
        seen: Option<&[u32]>,
        observed_flips: &[SlotCell],
        occupied_flips: &[SlotCell],
    ) -> Option<EncodedScan> {
        if seen.unwrap_or(&self.seen).is_empty() {
            return None;
        }
        let (mut observed_flips, mut occupied_flips) = (observed_flips, occupied_flips);
        self.changes.clear();
        while let Some(slot) = observed_flips.first().into_iter().chain(occupied_flips.first()).map(|c| c >> 9).min() {
            let masks = self.slots.get(slot as usize).map_or(TileMasks::default(), |known| known.masks);
            let observed = flipped(masks.observed(), &mut observed_flips, slot);
            let occupied = flipped(masks.occupied(), &mut occupied_flips, slot);
            if (slot as usize) < self.slots.len() {
                self.changes.push((slot, TileMasks::clipped(observed, occupied)));
            }
        }
        let seen = seen.filter(|seen| *seen != self.seen).map(<[u32]>::to_vec);
        Some(self.encode(seen))
    }

    /// Puts the changes into a scan and takes them over.
    fn encode(&mut self, seen: Option<Vec<u32>>) -> EncodedScan {
        // Observed masks can be left out only where all masked tiles were observed whole.
        let (mut with_observed, mut without) = (0u64, 0u64);
        for (slot, masks) in &self.changes {
            let flips = count(&self.slots[*slot as usize].masks, masks);
            with_observed += u64::from(flips.min(MASKS_BYTES));
            let is_whole = masks.observed() == self.all;
            without += u64::from(if is_whole { flips.min(OCCUPIED_BYTES) } else { flips });
        }
        let leaves_out = without <= with_observed;
        let mut scan = v1::TileScan::default();
        let (mut observed_flips, mut occupied_flips) = (Vec::new(), Vec::new());
        for (slot, masks) in &self.changes {
            let known = &mut self.slots[*slot as usize];
            let before = std::mem::replace(&mut known.masks, *masks);
            self.digest = self.digest.wrapping_sub(known.digest);
            known.digest = masks_digest(known.index_crc, masks);
            self.digest = self.digest.wrapping_add(known.digest);
            let limit = match (leaves_out, masks.observed() == self.all) {
                (true, true) => OCCUPIED_BYTES,
                (true, false) => u32::MAX,
                (false, _) => MASKS_BYTES,
            };
            if count(&before, masks) > limit {
                scan.masked.push(*slot);
                scan.occupied.extend(masks.occupied().to_bytes());
                if !leaves_out {
                    scan.observed.extend(masks.observed().to_bytes());
                }
            } else {
                let cells = |changed: Mask| changed.cells().map(|cell| slot * 512 + u32::from(cell));
                observed_flips.extend(cells(before.observed() ^ masks.observed()));
                occupied_flips.extend(cells(before.occupied() ^ masks.occupied()));
            }
        }
        scan.observed_flips = pack_flips(&observed_flips);
        scan.occupied_flips = pack_flips(&occupied_flips);
        if let Some(seen) = seen {
            scan.seen = pack_seen(&seen);
            let of = |slot: &u32| self.slots.get(*slot as usize).map_or(0, |known| known.digest);
            self.digest = seen.iter().map(of).fold(0, u64::wrapping_add);
            self.seen = seen;
        }
        EncodedScan { scan, new_tiles: std::mem::take(&mut self.new_tiles), digest: self.digest }
    }
}

/// Bits in which masks differ: a byte each, about, where they are sent as flips.
fn count(before: &TileMasks, now: &TileMasks) -> u32 {
    (before.observed() ^ now.observed()).count() + (before.occupied() ^ now.occupied()).count()
}

fn flipped(mut mask: Mask, flips: &mut &[SlotCell], slot: u32) -> Mask {
    let of_slot = flips.partition_point(|cell| cell >> 9 <= slot);
    let (now, rest) = flips.split_at(of_slot);
    for cell in now {
        mask.flip((cell % 512) as u16);
    }
    *flips = rest;
    mask
}
