//! The exact scans of one local day that no update has learned yet, tile by tile.
//!
//! Invariant: nothing is lost: the masks of each scan can be derived from the stored data. Scans are numbered in the
//! order of arrival. A tile's flips refer to the last scan of this day that saw the tile. The size of a day depends on
//! the cells that its scans saw, however many tiles the grid has.

use std::sync::Arc;

use tidemap_model::LocalDay;

use crate::{index::TileId, mask::TileMasks, scan::ScanSource, sensors::SensorId};

/// When a scan was made, with which sensor, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScanTime {
    /// Nanoseconds UTC.
    pub utc_nanos: i64,
    /// Seconds to add to UTC for local civil time.
    pub offset_secs: i32,
    /// The sensor that made the scan.
    pub sensor: SensorId,
    /// The source of the scan's readings.
    pub source: ScanSource,
}

impl ScanTime {
    /// Local civil time, nanoseconds since 1970-01-01T00:00 local.
    #[inline]
    pub fn civil_nanos(&self) -> i64 {
        self.utc_nanos.saturating_add(i64::from(self.offset_secs) * 1_000_000_000)
    }
}

/// Consecutive scans that saw the same tiles.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PresenceRun {
    /// The first scan of the run.
    pub first: u32,
    /// Number of scans, at least 1.
    pub count: u32,
    /// The tiles, ascending.
    pub seen: Arc<[TileId]>,
}

impl PresenceRun {
    /// The share of the run in [`GridDay::changes`]: a seen tile is a quarter of the size of a scan.
    fn changes(&self) -> u64 {
        1 + self.seen.len() as u64 / 4
    }
}

/// One of the two bits of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Bit {
    /// Whether the cell was observed.
    Observed,
    /// Whether the cell was observed as occupied.
    Occupied,
}

/// A bit of a cell that differs from the tile's scan before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flip {
    /// The first scan with the new value.
    pub scan: u32,
    packed: u16,
}

impl Flip {
    /// A flip of a cell's bit.
    #[inline]
    pub fn new(scan: u32, cell: u16, bit: Bit) -> Flip {
        Flip { scan, packed: cell & 511 | if bit == Bit::Occupied { 512 } else { 0 } }
    }

    /// The cell's place in its tile.
    #[inline]
    pub fn cell(self) -> u16 {
        self.packed & 511
    }

    /// The bit that flips.
    #[inline]
    pub fn bit(self) -> Bit {
        if self.packed & 512 == 0 { Bit::Observed } else { Bit::Occupied }
    }
}

/// One tile on one day.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DayTile {
    /// The masks of the tile in the day's first scan of it.
    pub first: TileMasks,
    /// The changes after the first scan, in the order of the scans.
    pub flips: Vec<Flip>,
    /// The masks of the tile in its last scan: `first` with all flips.
    pub last: TileMasks,
}

/// The exact scans of one local day.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GridDay {
    /// The local date.
    pub day: LocalDay,
    /// Times of the scans.
    pub scans: Vec<ScanTime>,
    /// The tiles that the scans saw; the counts of the runs add up to the number of scans.
    pub presence: Vec<PresenceRun>,
    /// The tiles that the scans of the day saw, ascending.
    tiles: Vec<(TileId, Box<DayTile>)>,
}

/// Share of a tile in [`GridDay::changes`] without its flips: the tile's size in units of 12 bytes.
const TILE_CHANGES: u64 = (size_of::<DayTile>() + size_of::<(TileId, Box<DayTile>)>()).div_ceil(12) as u64;

impl GridDay {
    /// A day without scans.
    pub fn new(day: LocalDay) -> GridDay {
        GridDay { day, scans: Vec::new(), presence: Vec::new(), tiles: Vec::new() }
    }

    /// Adds a scan and returns its number. [`GridDay::show`] then gives the masks of its tiles.
    pub fn push(&mut self, time: ScanTime, seen: &Arc<[TileId]>) -> u32 {
        self.take(time, seen).0
    }

    /// Does the same as [`GridDay::push`]; also returns the increase of [`GridDay::changes`].
    pub(crate) fn take(&mut self, time: ScanTime, seen: &Arc<[TileId]>) -> (u32, u64) {
        let scan = u32::try_from(self.scans.len()).unwrap_or(u32::MAX);
        self.scans.push(time);
        match self.presence.last_mut() {
            Some(run) if Arc::ptr_eq(&run.seen, seen) || run.seen == *seen => {
                run.count += 1;
                (scan, 1)
            }
            _ => {
                let run = PresenceRun { first: scan, count: 1, seen: Arc::clone(seen) };
                let changes = 1 + run.changes();
                self.presence.push(run);
                (scan, changes)
            }
        }
    }

    /// Sets the masks that a scan showed of a tile that it saw. By default a tile keeps its masks of the scan before.
    /// Returns the increase of [`GridDay::changes`].
    pub fn show(&mut self, scan: u32, tile: TileId, masks: TileMasks) -> u64 {
        let at = match self.place(tile) {
            Ok(at) => at,
            Err(at) => {
                self.tiles.insert(at, (tile, Box::new(DayTile { first: masks, flips: Vec::new(), last: masks })));
                return TILE_CHANGES;
            }
        };
        let Some((_, known)) = self.tiles.get_mut(at) else { return 0 };
        let before = known.flips.len();
        known.show(scan, masks);
        (known.flips.len() - before) as u64
    }

    /// The index of a tile, or the index at which it must be inserted.
    fn place(&self, tile: TileId) -> Result<usize, usize> {
        // The tiles of the first scan of a day arrive in order.
        match self.tiles.last() {
            Some((last, _)) if *last < tile => Err(self.tiles.len()),
            _ => self.tiles.binary_search_by_key(&tile, |(tile, _)| *tile),
        }
    }

    /// A tile on this day.
    pub fn tile(&self, tile: TileId) -> Option<&DayTile> {
        self.tiles.get(self.place(tile).ok()?).map(|(_, tile)| &**tile)
    }

    /// The tiles that the day's scans saw, ascending.
    pub fn tiles(&self) -> impl DoubleEndedIterator<Item = (TileId, &DayTile)> + ExactSizeIterator {
        self.tiles.iter().map(|(id, tile)| (*id, &**tile))
    }

    /// Replaces a tile of the day as a whole.
    pub fn put(&mut self, id: TileId, tile: DayTile) {
        match self.place(id) {
            Ok(at) => *self.tiles[at].1 = tile,
            Err(at) => self.tiles.insert(at, (id, Box::new(tile))),
        }
    }

    /// The tiles to be changed, in the order of [`GridDay::tiles`].
    pub fn tiles_mut(&mut self) -> &mut Vec<(TileId, Box<DayTile>)> {
        &mut self.tiles
    }

    /// The scans that saw each tile, as ranges of their numbers, first and end; in the order of [`GridDay::tiles`].
    pub fn presence_by_tile(&self) -> Vec<Vec<(u32, u32)>> {
        let mut ranges: Vec<Vec<(u32, u32)>> = vec![Vec::new(); self.tiles.len()];
        for run in &self.presence {
            // Both lists ascend, and mostly contain the same tiles.
            let mut at = 0;
            for tile in run.seen.iter() {
                if self.tiles.get(at).is_some_and(|(known, _)| known < tile) {
                    at += self.tiles[at..].partition_point(|(known, _)| known < tile);
                }
                if self.tiles.get(at).is_none_or(|(known, _)| known != tile) {
                    continue;
                }
                match ranges[at].last_mut() {
                    Some((_, end)) if *end == run.first => *end = run.first + run.count,
                    _ => ranges[at].push((run.first, run.first + run.count)),
                }
                at += 1;
            }
        }
        ranges
    }

    /// Splits the scans before an instant from the others. `None` for a part without scans.
    pub fn split(self, cut_nanos: i64) -> (Option<GridDay>, Option<GridDay>) {
        let is_after = |scan: &ScanTime| scan.utc_nanos >= cut_nanos;
        if !self.scans.iter().any(is_after) {
            return (Some(self), None);
        }
        if self.scans.iter().all(is_after) {
            return (None, Some(self));
        }
        let mut parts = [GridDay::new(self.day), GridDay::new(self.day)];
        // The number of each scan in its part, and which consecutive scans go into the same part.
        let mut numbers = Vec::with_capacity(self.scans.len());
        for run in &self.presence {
            for &time in self.scans.get(run.first as usize..).unwrap_or_default().iter().take(run.count as usize) {
                numbers.push(parts[usize::from(is_after(&time))].push(time, &run.seen));
            }
        }
        let alike = self.scans.chunk_by(|one, next| is_after(one) == is_after(next));
        let mut end = 0;
        let runs: Vec<(u32, u32, usize)> = alike
            .map(|scans| {
                let first = end;
                end += u32::try_from(scans.len()).unwrap_or(u32::MAX);
                (first, end, usize::from(scans.first().is_some_and(is_after)))
            })
            .collect();
        let presence = self.presence_by_tile();
        for ((id, tile), ranges) in self.tiles.into_iter().zip(presence) {
            let (mut masks, mut flips) = (tile.first, tile.flips.as_slice());
            for (from, to) in ranges {
                let of_range = runs.partition_point(|&(_, end, _)| end <= from);
                for &(first, end, part) in runs.iter().skip(of_range).take_while(|&&(first, _, _)| first < to) {
                    // The masks are set where the part's scans of the tile restart, and at each flip.
                    let mut scan = first.max(from);
                    while scan < end.min(to) {
                        flips = apply_flips(&mut masks, flips, scan);
                        if let Some(&number) = numbers.get(scan as usize) {
                            parts[part].show(number, id, masks);
                        }
                        scan = flips.first().map_or(u32::MAX, |flip| flip.scan);
                    }
                }
            }
        }
        parts.iter_mut().for_each(GridDay::shrink);
        let [before, after] = parts;
        (Some(before), Some(after))
    }

    /// The amount of data held for the update of the day: scans, tiles, flips and presence.
    pub fn changes(&self) -> u64 {
        let tiles = self.tiles.iter().map(|(_, tile)| TILE_CHANGES + tile.flips.len() as u64);
        self.scans.len() as u64 + tiles.sum::<u64>() + self.presence.iter().map(PresenceRun::changes).sum::<u64>()
    }

    /// Releases memory reserved for more scans.
    pub(crate) fn shrink(&mut self) {
        self.scans.shrink_to_fit();
        self.presence.shrink_to_fit();
        self.tiles.shrink_to_fit();
        for (_, tile) in &mut self.tiles {
            tile.flips.shrink_to_fit();
        }
    }

    /// Memory in bytes, about.
    pub fn bytes(&self) -> usize {
        let tiles = self.tiles.iter();
        let flips: usize =
            tiles.map(|(_, tile)| size_of::<DayTile>() + tile.flips.capacity() * size_of::<Flip>()).sum();
        let seen: usize = self.presence.iter().map(|run| 40 + 4 * run.seen.len()).sum();
        self.scans.capacity() * size_of::<ScanTime>()
            + self.tiles.capacity() * size_of::<(TileId, Box<DayTile>)>()
            + flips
            + seen
    }
}

/// Applies the flips of one scan, which must come first in `flips`; returns the flips after them.
fn apply_flips<'a>(masks: &mut TileMasks, flips: &'a [Flip], scan: u32) -> &'a [Flip] {
    let count = flips.iter().take_while(|flip| flip.scan == scan).count();
    let (of_scan, rest) = flips.split_at(count);
    if !of_scan.is_empty() {
        let cells = |bit: Bit| of_scan.iter().filter(move |flip| flip.bit() == bit).map(|flip| flip.cell());
        let observed = masks.observed().flipped(cells(Bit::Observed));
        *masks = TileMasks::clipped(observed, masks.occupied().flipped(cells(Bit::Occupied)));
    }
    rest
}

/// A tile's masks scan by scan, over the scans that saw it.
#[derive(Debug)]
pub struct DayTileScans<'a> {
    ranges: std::slice::Iter<'a, (u32, u32)>,
    range: (u32, u32),
    masks: TileMasks,
    flips: &'a [Flip],
}

impl DayTile {
    /// Adds the masks of a scan after those that the tile has.
    pub(crate) fn show(&mut self, scan: u32, masks: TileMasks) {
        for (bit, before, now) in [
            (Bit::Observed, self.last.observed(), masks.observed()),
            (Bit::Occupied, self.last.occupied(), masks.occupied()),
        ] {
            for cell in (before ^ now).cells() {
                self.flips.push(Flip::new(scan, cell, bit));
            }
        }
        self.last = masks;
    }

    /// The masks of each scan that saw the tile; `ranges` as [`GridDay::presence_by_tile`] gives them.
    pub fn scans<'a>(&'a self, ranges: &'a [(u32, u32)]) -> DayTileScans<'a> {
        DayTileScans { ranges: ranges.iter(), range: (0, 0), masks: self.first, flips: &self.flips }
    }
}

impl Iterator for DayTileScans<'_> {
    type Item = (u32, TileMasks);

    fn next(&mut self) -> Option<(u32, TileMasks)> {
        while self.range.0 >= self.range.1 {
            self.range = *self.ranges.next()?;
        }
        let scan = self.range.0;
        self.range.0 += 1;
        self.flips = apply_flips(&mut self.masks, self.flips, scan);
        Some((scan, self.masks))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_day_costs_what_its_scans_saw() {
        let mut day = GridDay::new(LocalDay(17_000));
        let (far, near) = (TileId(u32::MAX), TileId(3));
        let counted = [far, near].map(|tile| {
            let (scan, changes) = day.take(
                ScanTime { utc_nanos: 0, offset_secs: 0, source: ScanSource::Cells, sensor: SensorId::OWN },
                &Arc::from([tile]),
            );
            changes + day.show(scan, tile, TileMasks::default())
        });
        assert_eq!(day.tiles().map(|(tile, _)| tile).collect::<Vec<_>>(), [near, far]);
        assert_eq!(day.presence_by_tile(), [vec![(1, 2)], vec![(0, 1)]]);
        assert_eq!((day.tile(TileId(4)), day.tile(far).is_some()), (None, true));
        assert_eq!(day.changes(), counted.iter().sum::<u64>());
        day.shrink();
        assert!(day.bytes() < 1000 && day.changes() * 12 >= 2 * size_of::<DayTile>() as u64);
    }
}
