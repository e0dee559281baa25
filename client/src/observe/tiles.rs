//! What the scans of one producer have shown so far of each tile: the state that differences are told from.
//!
//! [`TileTable`] turns tiles into differences and differences into checksums; [`Shown`] only follows.
//!
//! Invariant: slots, masks, runs of seen slots, flips and digests are those of `ScanBatch` and `Scan` in
//! `observation.proto`. After a scan that [`TileTable::apply`] refuses for its cells the table is of no more use.

mod joined;
mod packing;

use std::collections::HashMap;

use tidemap_proto::v1::TileScan;

pub(crate) use joined::join;
pub use packing::{Run, runs_of, runs_to_wire};
pub(super) use packing::{flips, flips_to_wire, masks_to_wire};
use packing::{mask_at, runs_from_wire};

/// Cells of a tile: 8 along each axis.
pub const TILE_CELLS: u32 = 512;
/// Bytes of a tile's mask on the wire.
pub const MASK_BYTES: usize = 64;
/// From so many cells on, a tile's masks take less room whole than as flips.
const FLIPS_MAX: u32 = 48;
/// Factor of a tile's checksum in a digest.
const DIGEST_FACTOR: u64 = 0x9E37_79B9_7F4A_7C15;

/// A set of cells of one tile: bit `place % 64` of word `place / 64`, place = x + 8 * y + 64 * z.
pub type Mask = [u64; 8];

/// What a scan shows of a tile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileMasks {
    /// Cells that were observed.
    pub observed: Mask,
    /// Cells that were observed as occupied; each is observed.
    pub occupied: Mask,
}

impl TileMasks {
    /// Whether nothing was observed.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.observed == [0; 8]
    }

    /// Whether every occupied cell is observed.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.observed.iter().zip(&self.occupied).all(|(observed, occupied)| occupied & !observed == 0)
    }
}

/// A tile that a scan has seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SeenTile {
    /// Where it is: x, y, z in tiles from the grid's origin.
    pub tile: [i32; 3],
    /// What was seen.
    pub masks: TileMasks,
}

/// Why a scan of tiles makes no sense.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TileError {
    /// `new_tiles` is not a list of x, y, z.
    #[error("new_tiles has {0} numbers: they come in threes, x, y and z")]
    Coordinates(usize),
    /// A tile twice.
    #[error("tile {0:?} appears twice")]
    Twice([i32; 3]),
    /// A slot beyond the table.
    #[error("slot {slot} is used, but the table has {tiles} tiles")]
    Slot {
        /// Which.
        slot: u64,
        /// How many there are.
        tiles: usize,
    },
    /// The runs of seen slots are not pairs.
    #[error("seen has {0} numbers: they come in pairs, slots between and slots of a run")]
    Runs(usize),
    /// A run without slots.
    #[error("seen has a run of no slots: a run has at least 1")]
    EmptyRun,
    /// The first scan says "as before".
    #[error("seen is empty, but there is no scan of tiles before this one")]
    NothingBefore,
    /// Masks of another length.
    #[error("{what} has {found} bytes for {tiles} tiles: it takes {MASK_BYTES} a tile")]
    Masks {
        /// Which field.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The number of tiles.
        tiles: usize,
    },
    /// Parts of a scan that do not fit together.
    #[error("the parts of a scan are of different kinds")]
    Parts,
    /// A cell that is occupied and was not observed.
    #[error("a cell of tile {0:?} is occupied, but not observed")]
    OccupiedUnobserved([i32; 3]),
}

/// Masks by slot, and which slots the last scan saw.
#[derive(Clone, Debug, Default)]
pub struct Shown {
    masks: Vec<TileMasks>,
    seen: Vec<Run>,
}

impl Shown {
    /// What was last shown of a slot; nothing where it never was.
    #[must_use]
    pub fn masks(&self, slot: u32) -> TileMasks {
        self.masks.get(slot as usize).copied().unwrap_or_default()
    }

    /// What was last shown, by slot.
    #[must_use]
    pub fn all(&self) -> &[TileMasks] {
        &self.masks
    }

    /// The slots that the last scan saw.
    #[must_use]
    pub fn seen(&self) -> &[Run] {
        &self.seen
    }

    /// Makes room for so many slots.
    pub fn grow(&mut self, tiles: usize) {
        if tiles > self.masks.len() {
            self.masks.resize(tiles, TileMasks::default());
        }
    }

    /// Follows a scan that a [`TileTable`] has accepted, and calls `touched` for each slot whose masks may have changed.
    pub fn follow(&mut self, scan: &TileScan, mut touched: impl FnMut(u32)) {
        if let Ok(Some(seen)) = runs_from_wire(&scan.seen) {
            self.seen = seen;
        }
        for (index, &slot) in scan.masked.iter().enumerate() {
            let Some(masks) = self.masks.get_mut(slot as usize) else { continue };
            let observed = if scan.observed.is_empty() { [u64::MAX; 8] } else { mask_at(&scan.observed, index) };
            *masks = TileMasks { observed, occupied: mask_at(&scan.occupied, index) };
            touched(slot);
        }
        let mut flip = |packed: &[u32], side: fn(&mut TileMasks) -> &mut Mask| {
            let mut last = None;
            for cell in packing::flips(packed) {
                let slot = (cell / u64::from(TILE_CELLS)) as u32;
                let Some(masks) = self.masks.get_mut(slot as usize) else { continue };
                let place = (cell % u64::from(TILE_CELLS)) as usize;
                side(masks)[place / 64] ^= 1 << (place % 64);
                if last.replace(slot) != Some(slot) {
                    touched(slot);
                }
            }
        };
        flip(&scan.observed_flips, |masks| &mut masks.observed);
        flip(&scan.occupied_flips, |masks| &mut masks.occupied);
    }
}

/// The tiles of a producer with what it last showed of each.
#[derive(Clone, Debug, Default)]
pub struct TileTable {
    tiles: Vec<[i32; 3]>,
    slots: HashMap<[i32; 3], u32>,
    shown: Shown,
    /// What each slot adds to a digest.
    terms: Vec<u64>,
    /// Sum of the terms of the slots seen last.
    digest: u64,
    touched: Vec<u32>,
}

impl TileTable {
    /// The tiles, by slot.
    #[must_use]
    pub fn tiles(&self) -> &[[i32; 3]] {
        &self.tiles
    }

    /// What was last shown.
    #[must_use]
    pub fn shown(&self) -> &Shown {
        &self.shown
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
        for &tile in tiles {
            if self.slots.contains_key(&tile) {
                return Err(TileError::Twice(tile));
            }
            self.slot(tile);
        }
        Ok(())
    }

    /// The slot of a tile, and whether it is new.
    fn slot(&mut self, tile: [i32; 3]) -> (u32, bool) {
        if let Some(&slot) = self.slots.get(&tile) {
            return (slot, false);
        }
        // The daemon takes far fewer tiles than u32 holds.
        let slot = u32::try_from(self.tiles.len()).unwrap_or(u32::MAX);
        self.tiles.push(tile);
        self.slots.insert(tile, slot);
        self.shown.grow(self.tiles.len());
        self.terms.push(term(tile, &TileMasks::default()));
        (slot, true)
    }

    /// Takes a scan as on the wire; gives its digest.
    ///
    /// # Errors
    /// [`TileError`]
    pub fn apply(&mut self, scan: &TileScan) -> Result<u64, TileError> {
        self.check(scan)?;
        let mut touched = std::mem::take(&mut self.touched);
        touched.clear();
        let before = if scan.seen.is_empty() { None } else { Some(self.shown.seen.clone()) };
        self.shown.follow(scan, |slot| touched.push(slot));
        let mut unsound = None;
        for &slot in &touched {
            let (tile, masks) = (self.tiles[slot as usize], self.shown.masks(slot));
            if !masks.is_sound() {
                unsound = Some(tile);
            }
            let term = term(tile, &masks);
            let old = std::mem::replace(&mut self.terms[slot as usize], term);
            self.digest = self.digest.wrapping_add(term).wrapping_sub(old);
        }
        self.touched = touched;
        if before.is_some_and(|before| before != self.shown.seen) {
            let seen = self.shown.seen.iter().flat_map(Run::slots);
            self.digest = seen.fold(0_u64, |sum, slot| sum.wrapping_add(self.terms[slot as usize]));
        }
        unsound.map_or(Ok(self.digest), |tile| Err(TileError::OccupiedUnobserved(tile)))
    }

    /// Whether every slot of a scan is in the table and its fields fit together.
    fn check(&self, scan: &TileScan) -> Result<(), TileError> {
        let tiles = self.tiles.len();
        let within = |slot: u64| if slot < tiles as u64 { Ok(()) } else { Err(TileError::Slot { slot, tiles }) };
        match runs_from_wire(&scan.seen)? {
            Some(runs) => runs.last().map_or(Ok(()), |run| within(u64::from(run.start) + u64::from(run.len) - 1))?,
            None if self.shown.seen.is_empty() => return Err(TileError::NothingBefore),
            None => {}
        }
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
            // Ascending: the last is the highest.
            let last: Option<u64> =
                if packed.is_empty() { None } else { Some(packed.iter().copied().map(u64::from).sum()) };
            last.map_or(Ok(()), |cell| within(cell / u64::from(TILE_CELLS)))?;
        }
        Ok(())
    }

    /// Takes tiles as they were seen, and gives the scan that says how they differ from what was shown before, the tiles
    /// that are new (x, y, z of each), and the digest.
    ///
    /// # Errors
    /// [`TileError`]; nothing has then been taken.
    pub fn changes(&mut self, seen: &[SeenTile]) -> Result<(Vec<i32>, TileScan, u64), TileError> {
        if let Some(unsound) = seen.iter().find(|seen| !seen.masks.is_sound()) {
            return Err(TileError::OccupiedUnobserved(unsound.tile));
        }
        let mut places: Vec<[i32; 3]> = seen.iter().map(|seen| seen.tile).collect();
        places.sort_unstable();
        if let Some(twice) = places.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(TileError::Twice(twice[0]));
        }
        let mut new_tiles = Vec::new();
        let mut by_slot: Vec<(u32, &TileMasks)> = Vec::with_capacity(seen.len());
        for SeenTile { tile, masks } in seen {
            let (slot, is_new) = self.slot(*tile);
            if is_new {
                new_tiles.extend(tile);
            }
            by_slot.push((slot, masks));
        }
        by_slot.sort_unstable_by_key(|(slot, _)| *slot);
        let scan = self.difference(&by_slot);
        let digest = self.apply(&scan)?;
        Ok((new_tiles, scan, digest))
    }

    fn difference(&self, by_slot: &[(u32, &TileMasks)]) -> TileScan {
        let mut scan = TileScan::default();
        let runs = runs_of(by_slot.iter().map(|(slot, _)| *slot));
        if runs != self.shown.seen {
            scan.seen = runs_to_wire(&runs);
        }
        let (mut observed_flips, mut occupied_flips) = (Vec::new(), Vec::new());
        let mut whole: Vec<(u32, TileMasks)> = Vec::new();
        for &(slot, masks) in by_slot {
            let before = self.shown.masks(slot);
            let observed: Mask = std::array::from_fn(|word| before.observed[word] ^ masks.observed[word]);
            let occupied: Mask = std::array::from_fn(|word| before.occupied[word] ^ masks.occupied[word]);
            let flips: u32 = observed.iter().chain(&occupied).map(|word| word.count_ones()).sum();
            if flips > FLIPS_MAX {
                whole.push((slot, *masks));
                continue;
            }
            for (difference, flips) in [(observed, &mut observed_flips), (occupied, &mut occupied_flips)] {
                flips.extend(places(&difference).map(|place| u64::from(slot) * u64::from(TILE_CELLS) + place));
            }
        }
        masks_to_wire(&mut scan, &whole);
        scan.observed_flips = flips_to_wire(&observed_flips);
        scan.occupied_flips = flips_to_wire(&occupied_flips);
        scan
    }
}

/// The places of a mask, ascending.
pub(crate) fn places(mask: &Mask) -> impl Iterator<Item = u64> {
    (0..).zip(*mask).flat_map(|(word, bits): (u64, u64)| {
        let rest = |bits: u64| (bits != 0).then_some(bits);
        std::iter::successors(rest(bits), move |bits| rest(bits & (bits - 1)))
            .map(move |bits| word * 64 + u64::from(bits.trailing_zeros()))
    })
}

/// What a tile adds to a digest.
fn term(tile: [i32; 3], masks: &TileMasks) -> u64 {
    let mut bytes = [0; 12 + 2 * MASK_BYTES];
    let (place, both) = bytes.split_at_mut(12);
    for (four, coordinate) in place.as_chunks_mut::<4>().0.iter_mut().zip(tile) {
        *four = coordinate.to_le_bytes();
    }
    for (eight, word) in both.as_chunks_mut::<8>().0.iter_mut().zip(masks.observed.iter().chain(&masks.occupied)) {
        *eight = word.to_le_bytes();
    }
    DIGEST_FACTOR.wrapping_mul(u64::from(crc32c::crc32c(&bytes)))
}

#[cfg(test)]
mod tests;
