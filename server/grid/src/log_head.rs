//! The head of the log: scans of streams become differences against the last scan of each tile in log order.
//!
//! There are several records of one tile, each with its own lifetime:
//!
//! ```text
//! client    tile as the client last sent it        base of the next differences on the wire
//!   │ wire
//! intake    tile as the stream has sent it         decodes the stream, in the stream's task
//!   │ queue
//! [`StreamTiles`]  tile as the stream last sent it  copy at the writer, one per stream
//!   │ [`LogHead::take`]
//! [`LogHead`]      last scan handed to the log     base of the next difference; rebuilt after a failure
//!   │ log (append, fdatasync)
//! `LiveTile::arrival`  last durable scan           base after a restart
//!   │ apply
//! `LiveTile` and `GridDay`  newest values, pending scans of the day
//!   │ update
//! `TileModel`      learned data of the updates
//! ```
//!
//! Invariant: a `LogHead` shows the map as it will be when everything handed to the log so far is applied; after a
//! failure it is built again from the map. `StreamTiles` shows its tiles as its stream has sent them. No tile beyond
//! the limits of indices gets into the log.

use std::{collections::HashMap, sync::Arc};

use crate::{
    index::{TileId, TileIndex},
    live::LiveGrid,
    mask::{Mask, TileMasks},
    scan::{CellRef, LoggedScan, ScanSource},
};

#[cfg(test)]
mod tests;

/// A cell of a stream, as the number slot·512 + place, where the slot is the tile's index in the stream's table.
pub type SlotCell = u32;

/// One scan, as its stream sends it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StreamScan {
    /// When it was made, nanoseconds UTC, at least 0.
    pub utc_nanos: i64,
    /// The source of its readings.
    pub source: ScanSource,
    /// Slots of the tiles that were seen, ascending, without duplicates; shared by scans that saw the same.
    pub seen: Arc<[u32]>,
    /// Cells whose observed bit differs from the last time the stream showed the tile; ascending.
    pub observed_flips: Vec<SlotCell>,
    /// Cells whose occupied bit differs; ascending.
    pub occupied_flips: Vec<SlotCell>,
}

/// The tiles of one stream, with the masks that the stream last sent of each.
#[derive(Debug, Default)]
pub struct StreamTiles {
    slots: Vec<StreamTile>,
    seen: Option<SeenSlots>,
    /// Whether two of the slots in `seen` are the same tile.
    has_twins: bool,
    /// Whether a scan after the scan in `seen` was refused.
    has_skipped: bool,
}

/// The slots of the scan before, and the tiles of the map that these slots are.
#[derive(Debug)]
struct SeenSlots {
    slots: Arc<[u32]>,
    tiles: Arc<[TileId]>,
}

#[derive(Debug)]
struct StreamTile {
    index: TileIndex,
    /// `None` until the map knows the tile.
    tile: Option<TileId>,
    masks: TileMasks,
}

impl StreamTiles {
    /// Appends a tile to the stream's table.
    pub fn push(&mut self, index: TileIndex) {
        self.slots.push(StreamTile { index, tile: None, masks: TileMasks::default() });
    }

    /// Drops the assignment of slots to tiles of the map, because the map may not have these tiles.
    pub fn forget_tiles(&mut self) {
        for slot in &mut self.slots {
            slot.tile = None;
        }
        self.seen = None;
    }

    fn is_like_before(&self, scan: &StreamScan) -> bool {
        self.seen.as_ref().is_some_and(|seen| Arc::ptr_eq(&seen.slots, &scan.seen))
    }

    /// Applies a refused scan: later scans are differences from it all the same.
    pub fn skip(&mut self, scan: &StreamScan) {
        self.flip(&scan.observed_flips, |slot, cells| {
            let observed = slot.masks.observed().flipped(places(cells));
            slot.masks = TileMasks::clipped(observed, slot.masks.occupied());
        });
        self.flip(&scan.occupied_flips, |slot, cells| {
            let occupied = slot.masks.occupied().flipped(places(cells));
            slot.masks = TileMasks::clipped(slot.masks.observed(), occupied);
        });
        self.has_skipped = true;
    }

    /// Flips bits of cells, slot by slot.
    fn flip(&mut self, flips: &[SlotCell], flip: impl Fn(&mut StreamTile, &[SlotCell])) {
        for cells in flips.chunk_by(|one, next| slot_of(*one) == slot_of(*next)) {
            let slot = cells.first().and_then(|cell| self.slots.get_mut(slot_of(*cell)));
            if let Some(slot) = slot {
                flip(slot, cells);
            }
        }
    }
}

/// Removes cells that two slots of one tile both flip; the cells are sorted.
fn cancel_pairs(cells: &mut Vec<CellRef>) {
    let odd = cells.chunk_by(|one, next| one == next).filter(|same| same.len() % 2 == 1);
    *cells = odd.filter_map(|same| same.first().copied()).collect();
}

/// The cells after the cells of a slot.
fn behind(cells: &[SlotCell], slot: usize) -> &[SlotCell] {
    let of_slot = cells.iter().take_while(|cell| slot_of(**cell) <= slot).count();
    cells.get(of_slot..).unwrap_or_default()
}

fn places(cells: &[SlotCell]) -> impl Iterator<Item = u16> {
    cells.iter().map(|cell| CellRef(*cell).cell())
}

/// Whether a slot is among ascending slots. Found in one step if no slot is left out.
fn is_among(seen: &[u32], slot: u32) -> bool {
    let place = seen.first().map_or(0, |first| slot.wrapping_sub(*first) as usize);
    seen.get(place) == Some(&slot) || seen.binary_search(&slot).is_ok()
}

fn slot_of(cell: SlotCell) -> usize {
    CellRef(cell).tile().0 as usize
}

/// The tiles of a map after everything handed to the log is applied.
#[derive(Debug)]
pub struct LogHead {
    new_ids: HashMap<TileIndex, TileId>,
    tiles: usize,
    masks: Vec<TileMasks>,
    seen: Arc<[TileId]>,
    last_owner: u64,
}

/// A scan for the log, and the tiles that first appear in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScanDelta {
    /// The scan.
    pub scan: LoggedScan,
    /// Tiles that appear for the first time.
    pub new_tiles: Vec<TileIndex>,
}

/// The scan would exceed the map's limit of tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooManyTiles;

impl LogHead {
    /// The head of a log without events in flight.
    pub fn new(grid: &LiveGrid) -> LogHead {
        let tiles = grid.tiles();
        LogHead {
            new_ids: HashMap::new(),
            tiles,
            masks: grid.tiles.iter().map(|tile| tile.arrival).collect(),
            seen: Arc::clone(grid.last_seen()),
            last_owner: 0,
        }
    }

    /// Number of tiles after everything in flight is applied.
    pub fn tiles(&self) -> usize {
        self.tiles
    }

    /// Turns a scan of a stream into a scan for the log. `stream` is the stream's number, not 0.
    ///
    /// # Errors
    /// [`TooManyTiles`] where the map would have more than `max_tiles`; then the log head is unchanged, and the
    /// stream's tiles have applied the scan.
    pub fn take(
        &mut self,
        grid: &LiveGrid,
        stream: u64,
        source: &mut StreamTiles,
        scan: &StreamScan,
        offset_secs: i32,
        max_tiles: usize,
    ) -> Result<ScanDelta, TooManyTiles> {
        let goes_on = self.goes_on(stream, source, scan);
        let is_like_before = source.is_like_before(scan);
        source.skip(scan);
        let mut new_tiles = Vec::new();
        if !is_like_before {
            new_tiles = self.resolve(grid, source, &scan.seen, max_tiles)?;
            let mut seen: Vec<TileId> =
                scan.seen.iter().filter_map(|&slot| source.slots.get(slot as usize)?.tile).collect();
            seen.sort_unstable();
            source.has_twins = seen.windows(2).any(|pair| pair.first() == pair.last());
            seen.dedup();
            source.seen = Some(SeenSlots { slots: Arc::clone(&scan.seen), tiles: seen.into() });
        }
        let Some(seen) = &source.seen else { return Err(TooManyTiles) };
        let seen = Arc::clone(&seen.tiles);
        let mut flips = FlipLists::default();
        if goes_on {
            // All tiles of the scan have the masks that this stream showed last.
            let (mut observed, mut occupied) = (&scan.observed_flips[..], &scan.occupied_flips[..]);
            while let Some(slot) = observed.first().into_iter().chain(occupied.first()).map(|cell| slot_of(*cell)).min()
            {
                (observed, occupied) = (behind(observed, slot), behind(occupied, slot));
                let slot = u32::try_from(slot).unwrap_or(u32::MAX);
                if is_among(&scan.seen, slot) {
                    self.show(source, slot, &mut flips);
                }
            }
        } else {
            for &slot in scan.seen.iter() {
                self.show(source, slot, &mut flips);
            }
        }
        self.last_owner = stream;
        source.has_skipped = false;
        let is_seen_before = Arc::ptr_eq(&self.seen, &seen) || self.seen == seen;
        if !is_seen_before {
            self.seen = Arc::clone(&seen);
        }
        flips.observed.sort_unstable();
        flips.occupied.sort_unstable();
        if source.has_twins {
            cancel_pairs(&mut flips.observed);
            cancel_pairs(&mut flips.occupied);
        }
        let scan = LoggedScan {
            utc_nanos: scan.utc_nanos,
            offset_secs,
            source: scan.source,
            seen: (!is_seen_before).then_some(seen),
            observed_flips: flips.observed,
            occupied_flips: flips.occupied,
        };
        Ok(ScanDelta { scan, new_tiles })
    }

    /// Whether a scan continues the last scan in the log, with the same stream and the same tiles: then all its tiles
    /// have the masks that this stream showed last.
    fn goes_on(&self, stream: u64, source: &StreamTiles, scan: &StreamScan) -> bool {
        source.is_like_before(scan) && !source.has_skipped && self.last_owner == stream
    }

    /// Maximum number of flips of a stream's scan in the log, without the flips of tiles that are observed again as a
    /// whole; changes nothing.
    pub fn flips_at_most(&self, grid: &LiveGrid, stream: u64, source: &StreamTiles, scan: &StreamScan) -> u64 {
        if self.goes_on(stream, source, scan) {
            return (scan.observed_flips.len() + scan.occupied_flips.len()) as u64;
        }
        let (mut observed, mut occupied) = (&scan.observed_flips[..], &scan.occupied_flips[..]);
        let mut flips = 0;
        for &number in scan.seen.iter() {
            let Some(slot) = source.slots.get(number as usize) else { continue };
            let (of_observed, of_occupied) = (take_slot(&mut observed, number), take_slot(&mut occupied, number));
            let tile = slot.tile.or_else(|| grid.find(slot.index)).or_else(|| self.new_ids.get(&slot.index).copied());
            let known = tile.and_then(|tile| self.masks.get(tile.0 as usize)).copied().unwrap_or_default();
            let observed = known.observed() ^ slot.masks.observed().flipped(of_observed);
            let occupied = known.occupied() ^ slot.masks.occupied().flipped(of_occupied);
            flips += u64::from(occupied.count());
            flips += if observed == Mask::FULL { 0 } else { u64::from(observed.count()) };
        }
        flips
    }

    /// Finds the map's tiles for the slots and adds new tiles. A tile beyond the limits gets no id and is not shown.
    fn resolve(
        &mut self,
        grid: &LiveGrid,
        source: &mut StreamTiles,
        seen: &[u32],
        max_tiles: usize,
    ) -> Result<Vec<TileIndex>, TooManyTiles> {
        // The map itself contains the durable tiles.
        if !self.new_ids.is_empty() {
            self.new_ids.retain(|_, id| id.0 as usize >= grid.tiles());
        }
        let mut unknown = Vec::new();
        for &slot in seen {
            let Some(slot) = source.slots.get_mut(slot as usize) else { continue };
            if slot.tile.is_none() {
                slot.tile = grid.find(slot.index).or_else(|| self.new_ids.get(&slot.index).copied());
            }
            if slot.tile.is_none() && slot.index.is_valid() {
                unknown.push(slot.index);
            }
        }
        unknown.sort_unstable();
        unknown.dedup();
        if self.tiles + unknown.len() > max_tiles.min(CellRef::TILES_MAX as usize) {
            return Err(TooManyTiles);
        }
        for &index in &unknown {
            self.new_ids.insert(index, TileId(u32::try_from(self.tiles).unwrap_or(u32::MAX)));
            self.tiles += 1;
            self.masks.push(TileMasks::default());
        }
        for &slot in seen {
            let Some(slot) = source.slots.get_mut(slot as usize) else { continue };
            slot.tile = slot.tile.or_else(|| self.new_ids.get(&slot.index).copied());
        }
        Ok(unknown)
    }

    /// Shows one tile of a stream to the map.
    fn show(&mut self, source: &StreamTiles, slot: u32, flips: &mut FlipLists) {
        let Some(slot) = source.slots.get(slot as usize) else { return };
        let Some(tile) = slot.tile else { return };
        let index = tile.0 as usize;
        let Some(masks) = self.masks.get_mut(index) else { return };
        let observed = masks.observed() ^ slot.masks.observed();
        let occupied = masks.occupied() ^ slot.masks.occupied();
        if !observed.is_empty() {
            flips.observed.extend(observed.cells().map(|cell| CellRef::new(tile, cell)));
        }
        if !occupied.is_empty() {
            flips.occupied.extend(occupied.cells().map(|cell| CellRef::new(tile, cell)));
        }
        *masks = slot.masks;
    }
}

#[derive(Default)]
struct FlipLists {
    observed: Vec<CellRef>,
    occupied: Vec<CellRef>,
}

/// Removes the cells of a slot, and the cells before them, from ascending cells.
fn take_slot<'a>(cells: &mut &'a [SlotCell], slot: u32) -> impl Iterator<Item = u16> + 'a {
    let first = cells.partition_point(|cell| CellRef(*cell).tile().0 < slot);
    let rest = &cells[first..];
    let end = rest.partition_point(|cell| CellRef(*cell).tile().0 <= slot);
    *cells = &rest[end..];
    rest[..end].iter().map(|cell| CellRef(*cell).cell())
}

#[cfg(test)]
mod limits {
    use super::*;
    use crate::{index::TILE_LIMIT, tests::empty};

    #[test]
    fn a_tile_beyond_the_limits_gets_no_id() {
        let grid = &empty();
        let (mut front, mut source) = (LogHead::new(grid), StreamTiles::default());
        let index = TileIndex { x: 1, y: 2, z: 3 };
        source.push(TileIndex { x: TILE_LIMIT, ..index });
        source.push(index);
        for places in [[3, 600], [4, 601]] {
            let sent = StreamScan {
                utc_nanos: 1,
                source: ScanSource::Cells,
                seen: Arc::from([0, 1]),
                observed_flips: places.to_vec(),
                occupied_flips: places.to_vec(),
            };
            let taken = front.take(grid, 1, &mut source, &sent, 0, 1).expect("room for one");
            assert!(taken.new_tiles.iter().all(|new| *new == index));
            assert_eq!(taken.scan.observed_flips, [CellRef(places[1] - 512)]);
        }
        assert_eq!(front.tiles, 1);
    }
}
