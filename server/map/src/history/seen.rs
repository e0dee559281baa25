//! One tile on one day, cell by cell: finds the scans, among those that saw the tile, at which a cell's bits flip.
//!
//! Invariant: places count the scans that saw the tile, from 0. Ranges and flips that do not fit the day, which may
//! occur in damaged data, are left out.

use tidemap_grid::{
    day::{Bit, DayTile, Flip},
    mask::Mask,
};

use super::bits::Bits;

/// The scans of a day that saw a tile.
#[derive(Debug, Default)]
pub(super) struct Seen {
    /// The first scan, the end, and the place of the first scan of each range; ascending.
    ranges: Vec<(u32, u32, u32)>,
    count: u32,
}

impl Seen {
    /// Makes it from the ranges of a day with `scans` scans.
    pub(super) fn new(ranges: &[(u32, u32)], scans: usize) -> Seen {
        let end = u32::try_from(scans).unwrap_or(u32::MAX);
        let mut seen = Seen::default();
        let mut before = 0;
        for &(from, to) in ranges {
            let (from, to) = (from.max(before), to.min(end));
            if from < to {
                seen.ranges.push((from, to, seen.count));
                seen.count += to - from;
                before = to;
            }
        }
        seen
    }

    /// Number of scans.
    pub(super) fn count(&self) -> usize {
        self.count as usize
    }

    /// Place of a scan.
    fn place(&self, scan: u32) -> Option<u32> {
        let at = self.ranges.partition_point(|&(_, to, _)| to <= scan);
        let &(from, _, place) = self.ranges.get(at)?;
        (from <= scan).then(|| place + (scan - from))
    }

    /// Scan at a place.
    pub(super) fn scan(&self, place: u32) -> u32 {
        let at = self.ranges.partition_point(|&(_, _, first)| first <= place);
        self.ranges.get(at.wrapping_sub(1)).map_or(0, |&(from, _, first)| from + (place - first))
    }

    /// Selects the bits of these scans from those of all scans of the day, in place.
    pub(super) fn gather(&self, all: &mut Bits, bits: &mut Bits) {
        if matches!(self.ranges.as_slice(), [(0, to, _)] if *to as usize == all.len()) {
            std::mem::swap(all, bits);
            return;
        }
        bits.reset(0);
        for &(from, to, _) in &self.ranges {
            bits.append(all, from as usize, to as usize);
        }
    }
}

/// The places at which the bits of one cell flip.
#[derive(Clone, Debug, Default)]
pub(super) struct CellFlips {
    pub(super) observed: Vec<u32>,
    pub(super) occupied: Vec<u32>,
}

/// The flips of some cells, by cell ascending.
pub(super) fn flips_of(tile: &DayTile, seen: &Seen, cells: Mask) -> Vec<CellFlips> {
    let mut of_cell = [u16::MAX; 512];
    let mut count = 0;
    for cell in cells.cells() {
        of_cell[usize::from(cell)] = count;
        count += 1;
    }
    let mut found = vec![CellFlips::default(); usize::from(count)];
    for flip in &tile.flips {
        let wanted = found.get_mut(usize::from(of_cell[usize::from(flip.cell())]));
        if let (Some(flips), Some(place)) = (wanted, seen.place(flip.scan)) {
            match flip.bit() {
                Bit::Observed => flips.observed.push(place),
                Bit::Occupied => flips.occupied.push(place),
            }
        }
    }
    found
}

/// The order in which flips are recorded: by scan, observed bits before occupied bits, by cell.
pub(super) fn order(flip: &Flip) -> (u32, Bit, u16) {
    (flip.scan, flip.bit(), flip.cell())
}

/// The two bits of a cell at the scans that saw its tile.
#[derive(Debug, Default)]
pub(super) struct CellBits {
    pub(super) observed: Bits,
    pub(super) occupied: Bits,
}

impl CellBits {
    pub(super) fn fill(&mut self, tile: &DayTile, cell: u16, flips: &CellFlips, seen: &Seen) {
        self.observed.fill(seen.count(), tile.first.observed().contains(cell), &flips.observed);
        self.occupied.fill(seen.count(), tile.first.occupied().contains(cell), &flips.occupied);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_and_scans_lead_to_each_other() {
        let seen = Seen::new(&[(3, 5), (4, 4), (9, 12), (11, 20)], 14);
        let scans = [3, 4, 9, 10, 11, 12, 13];
        assert_eq!(seen.count(), scans.len());
        for (place, scan) in (0..).zip(scans) {
            assert_eq!((seen.place(scan), seen.scan(place)), (Some(place), scan));
        }
        assert_eq!([0, 2, 5, 8, 14, u32::MAX].map(|scan| seen.place(scan)), [None; 6]);
        assert_eq!(Seen::default().scan(7), 0);
    }
}
