//! Scans of tiles on the sending side: each scan is sent as its difference to the previous scan.
//!
//! [`TileTable`] turns tiles into differences and differences into digests; [`TilePicture`] only follows them.
//!
//! Invariant: a decoder that takes the scans of one table in their order has the same picture of every tile. After a
//! scan that [`TileTable::apply`] refuses for its cells the table must not be used again.

use std::collections::HashMap;

use tidemap_grid::{
    index::TileIndex,
    mask::{Mask, TileMasks},
};

use super::{
    MASK_BYTES, TileError,
    digest::tile_digest,
    flips::{SlotRun, pack_flips, pack_runs, runs_of, unpack_flips, unpack_runs},
};
use crate::v1::{TileScan, scan::Content};

/// A tile with more changed cells is sent as whole masks, which then take less room than flips.
const FLIPS_MAX: u32 = 48;

/// A scan of tiles for the wire.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedScan {
    /// The scan.
    pub scan: TileScan,
    /// Tiles that the stream's table gets with the message of this scan, or an earlier message.
    pub new_tiles: Vec<TileIndex>,
    /// The digest of the scan.
    pub digest: u64,
}

/// The content that a stream last showed of each slot, and the slots that its last scan saw.
#[derive(Clone, Debug, Default)]
pub struct TilePicture {
    /// Observed and occupied cells.
    masks: Vec<[Mask; 2]>,
    runs: Vec<SlotRun>,
}

impl TilePicture {
    /// The content last shown of a slot; empty for a slot that was never seen.
    #[must_use]
    pub fn masks(&self, slot: u32) -> TileMasks {
        let [observed, occupied] = self.masks.get(slot as usize).copied().unwrap_or_default();
        TileMasks::clipped(observed, occupied)
    }

    /// The content last shown, by slot.
    pub fn all(&self) -> impl Iterator<Item = TileMasks> {
        self.masks.iter().map(|&[observed, occupied]| TileMasks::clipped(observed, occupied))
    }

    /// The slots that the last scan saw, ascending.
    pub fn seen(&self) -> impl Iterator<Item = u32> {
        self.runs.iter().flat_map(|&(first, beyond)| first..beyond)
    }

    /// The slots that the last scan saw, in the form of `TileScan.seen`: a gap and a length for each run.
    #[must_use]
    pub fn packed_seen(&self) -> Vec<u32> {
        pack_runs(&self.runs)
    }

    /// Makes room for `tiles` slots.
    pub fn grow(&mut self, tiles: usize) {
        if tiles > self.masks.len() {
            self.masks.resize(tiles, Default::default());
        }
    }

    /// Follows a scan that a [`TileTable`] has accepted, and calls `touched` for each slot whose masks may have
    /// changed.
    pub fn follow(&mut self, scan: &TileScan, mut touched: impl FnMut(u32)) {
        if !scan.seen.is_empty() {
            // The scan was checked when it was accepted.
            let _ = unpack_runs(&scan.seen, usize::MAX, &mut self.runs);
        }
        for (index, &slot) in scan.masked.iter().enumerate() {
            let Some(masks) = self.masks.get_mut(slot as usize) else { continue };
            let observed = if scan.observed.is_empty() { Mask::FULL } else { mask_at(&scan.observed, index) };
            *masks = [observed, mask_at(&scan.occupied, index)];
            touched(slot);
        }
        for (side, packed) in [&scan.observed_flips, &scan.occupied_flips].into_iter().enumerate() {
            let mut last = None;
            for cell in unpack_flips(packed) {
                let slot = cell >> 9;
                let Some(masks) = self.masks.get_mut(slot as usize) else { continue };
                masks[side].flip((cell % 512) as u16);
                if last.replace(slot) != Some(slot) {
                    touched(slot);
                }
            }
        }
    }
}

/// The tiles of a stream, by slot, with what it last showed of each.
#[derive(Clone, Debug, Default)]
pub struct TileTable {
    tiles: Vec<TileIndex>,
    slots: HashMap<TileIndex, u32>,
    picture: TilePicture,
    /// The term that each slot adds to a digest.
    terms: Vec<u64>,
    /// Sum of the terms of the slots seen last.
    digest: u64,
    touched: Vec<u32>,
}

impl TileTable {
    /// The tiles, by slot.
    #[must_use]
    pub fn tiles(&self) -> &[TileIndex] {
        &self.tiles
    }

    /// The content last shown.
    #[must_use]
    pub fn picture(&self) -> &TilePicture {
        &self.picture
    }

    /// Adds tiles: x, y, z of each.
    ///
    /// # Errors
    /// [`TileError`]
    pub fn extend(&mut self, new_tiles: &[i32]) -> Result<(), TileError> {
        let (tiles, rest) = new_tiles.as_chunks::<3>();
        if !rest.is_empty() {
            return Err(TileError::Coordinates(new_tiles.len()));
        }
        for &[x, y, z] in tiles {
            let tile = TileIndex { x, y, z };
            if !self.slot(tile).1 {
                return Err(TileError::Twice(tile));
            }
        }
        Ok(())
    }

    /// The slot of a tile, and whether it is new.
    fn slot(&mut self, tile: TileIndex) -> (u32, bool) {
        if let Some(&slot) = self.slots.get(&tile) {
            return (slot, false);
        }
        // The daemon takes far fewer tiles than u32 holds.
        let slot = u32::try_from(self.tiles.len()).unwrap_or(u32::MAX);
        self.tiles.push(tile);
        self.slots.insert(tile, slot);
        self.picture.grow(self.tiles.len());
        self.terms.push(tile_digest(tile, &TileMasks::default()));
        (slot, true)
    }

    /// Applies a scan as it is on the wire; returns its digest.
    ///
    /// # Errors
    /// [`TileError`]
    pub fn apply(&mut self, scan: &TileScan) -> Result<u64, TileError> {
        self.check(scan)?;
        let mut touched = std::mem::take(&mut self.touched);
        touched.clear();
        let before = if scan.seen.is_empty() { None } else { Some(self.picture.runs.clone()) };
        self.picture.follow(scan, |slot| touched.push(slot));
        let mut unsound = None;
        for &slot in &touched {
            let (tile, [observed, occupied]) = (self.tiles[slot as usize], self.picture.masks[slot as usize]);
            if !occupied.without(observed).is_empty() {
                unsound = Some(tile);
            }
            let term = tile_digest(tile, &TileMasks::clipped(observed, occupied));
            let old = std::mem::replace(&mut self.terms[slot as usize], term);
            self.digest = self.digest.wrapping_add(term).wrapping_sub(old);
        }
        self.touched = touched;
        if before.is_some_and(|before| before != self.picture.runs) {
            self.digest = self.picture.seen().fold(0_u64, |sum, slot| sum.wrapping_add(self.terms[slot as usize]));
        }
        unsound.map_or(Ok(self.digest), |tile| Err(TileError::OccupiedUnobserved(tile)))
    }

    /// Whether every slot of a scan is in the table and its fields fit together.
    fn check(&self, scan: &TileScan) -> Result<(), TileError> {
        let tiles = self.tiles.len();
        let within = |slot: u64| if slot < tiles as u64 { Ok(()) } else { Err(TileError::Slot { slot, tiles }) };
        if scan.seen.is_empty() && self.picture.runs.is_empty() {
            return Err(TileError::NothingBefore);
        }
        unpack_runs(&scan.seen, tiles, &mut Vec::new())?;
        let count = scan.masked.len();
        for (what, bytes, needs) in
            [("observed", &scan.observed, !scan.observed.is_empty()), ("occupied", &scan.occupied, true)]
        {
            if needs && bytes.len() != count * MASK_BYTES {
                return Err(TileError::Masks { what, found: bytes.len(), tiles: count });
            }
        }
        scan.masked.iter().try_for_each(|&slot| within(u64::from(slot)))?;
        for packed in [&scan.observed_flips, &scan.occupied_flips] {
            // The numbers ascend: the last is the highest.
            within(packed.iter().copied().map(u64::from).sum::<u64>() >> 9)?;
        }
        Ok(())
    }

    /// Encodes the tiles of a scan, none twice, as their difference to what was shown before.
    ///
    /// # Errors
    /// [`TileError`]; the table is then as it was.
    pub fn encode(&mut self, seen: &[(TileIndex, TileMasks)]) -> Result<EncodedScan, TileError> {
        let mut tiles: Vec<TileIndex> = seen.iter().map(|(tile, _)| *tile).collect();
        tiles.sort_unstable();
        if let Some(twice) = tiles.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(TileError::Twice(twice[0]));
        }
        if tiles.is_empty() {
            return Err(TileError::NoTile);
        }
        let mut new_tiles = Vec::new();
        let mut by_slot: Vec<(u32, TileMasks)> = Vec::with_capacity(seen.len());
        for &(tile, masks) in seen {
            let (slot, is_new) = self.slot(tile);
            if is_new {
                new_tiles.push(tile);
            }
            by_slot.push((slot, masks));
        }
        by_slot.sort_unstable_by_key(|(slot, _)| *slot);
        let scan = self.difference(&by_slot);
        let digest = self.apply(&scan)?;
        Ok(EncodedScan { scan, new_tiles, digest })
    }

    fn difference(&self, by_slot: &[(u32, TileMasks)]) -> TileScan {
        let mut scan = TileScan::default();
        let runs = runs_of(by_slot.iter().map(|(slot, _)| *slot));
        if runs != self.picture.runs {
            scan.seen = pack_runs(&runs);
        }
        let mut flips = [Vec::new(), Vec::new()];
        let mut whole: Vec<(u32, TileMasks)> = Vec::new();
        for &(slot, masks) in by_slot {
            let before = self.picture.masks(slot);
            let changed = [before.observed() ^ masks.observed(), before.occupied() ^ masks.occupied()];
            if changed.iter().map(Mask::count).sum::<u32>() > FLIPS_MAX {
                whole.push((slot, masks));
                continue;
            }
            for (flips, changed) in flips.iter_mut().zip(changed) {
                flips.extend(changed.cells().map(|cell| slot << 9 | u32::from(cell)));
            }
        }
        set_masks(&mut scan, &whole);
        [scan.observed_flips, scan.occupied_flips] = flips.map(|cells| pack_flips(&cells));
        scan
    }
}

/// The mask at an index of masks in a row; empty where it is cut off.
fn mask_at(bytes: &[u8], index: usize) -> Mask {
    bytes.as_chunks::<MASK_BYTES>().0.get(index).map_or(Mask::EMPTY, Mask::from_bytes)
}

/// Writes masks of slots, which ascend, in place of those that the scan has.
pub fn set_masks(scan: &mut TileScan, masks: &[(u32, TileMasks)]) {
    let bytes = |side: fn(&TileMasks) -> Mask| masks.iter().flat_map(|(_, masks)| side(masks).to_bytes()).collect();
    scan.masked = masks.iter().map(|(slot, _)| *slot).collect();
    let all_observed = masks.iter().all(|(_, masks)| masks.observed() == Mask::FULL);
    scan.observed = if all_observed { Vec::new() } else { bytes(TileMasks::observed) };
    scan.occupied = bytes(TileMasks::occupied);
}

/// Appends the next part of a scan that spans messages: the columns are joined; pose, frame and limits are those of the
/// first part.
///
/// # Errors
/// [`TileError::Parts`]
pub fn join_part(whole: &mut Option<Content>, part: Option<Content>) -> Result<(), TileError> {
    match (whole, part) {
        (Some(Content::Tiles(whole)), Some(Content::Tiles(part))) => {
            whole.seen.extend(part.seen);
            whole.masked.extend(part.masked);
            whole.observed.extend(part.observed);
            whole.occupied.extend(part.occupied);
            whole.observed_flips.extend(part.observed_flips);
            whole.occupied_flips.extend(part.occupied_flips);
        }
        (Some(Content::Cloud(whole)), Some(Content::Cloud(part))) => whole.xyz_m.extend(part.xyz_m),
        (Some(Content::Ranges(whole)), Some(Content::Ranges(part))) => whole.ranges_m.extend(part.ranges_m),
        _ => return Err(TileError::Parts),
    }
    Ok(())
}

#[cfg(test)]
mod tests;
