//! Bins of half an hour: the evidence from which cells are learned.
//!
//! Rays of one sensor contradict each other: a ray that grazes a table passes cells in which others end. So the rays of
//! a bin are one piece of evidence, as the posterior of an occupancy grid (Moravec and Elfes 1985; OctoMap, Hornung et
//! al. 2013): each scan adds the log odds of its sensor's hit or miss, and the cell counts as occupied in the bin if
//! they add up to more than 0. A rhythm is then one of things, such as "a table stands here from 9 to 12", and an
//! update costs bins instead of readings.
//!
//! Invariant: a day of bins has one scan for each bin with a scan, with the mean time of the bin's scans, and a cell is
//! observed in a bin if a scan of the bin observed it. The result does not depend on the order of the scans.

use std::{collections::HashMap, sync::Arc};

use rayon::prelude::*;

use crate::{
    day::{Bit, DayTile, GridDay, ScanTime},
    index::{TILE_CELLS, TileId},
    mask::{Mask, TileMasks},
    ray_odds::RayOdds,
    sensors::{SensorId, Sensors},
};

/// Length of a bin, nanoseconds of local civil time.
pub const BIN_NANOS: i64 = 1_800_000_000_000;

/// The bins of a day.
struct DayBins {
    /// The time of each bin.
    times: Vec<ScanTime>,
    /// The bin of each scan.
    of_scans: Vec<u32>,
    /// The log odds of each scan.
    odds: Vec<RayOdds>,
}

impl DayBins {
    fn new(day: &GridDay, sensors: &Sensors) -> DayBins {
        // By bin and offset from UTC: number of scans, and the sum of their times since the first.
        let mut sums: HashMap<(i64, i32), (i64, i128, i128)> = HashMap::new();
        let key = |scan: &ScanTime| (scan.civil_nanos().div_euclid(BIN_NANOS), scan.offset_secs);
        for scan in &day.scans {
            let (first, count, sum) = sums.entry(key(scan)).or_insert((scan.utc_nanos, 0, 0));
            *count += 1;
            *sum += i128::from(scan.utc_nanos) - i128::from(*first);
        }
        let mut times: Vec<((i64, i32), ScanTime)> = sums
            .into_iter()
            .map(|(key, (first, count, sum))| {
                let mean = i64::try_from(i128::from(first) + sum.div_euclid(count)).unwrap_or(first);
                (key, ScanTime { utc_nanos: mean, offset_secs: key.1, sensor: SensorId::OWN })
            })
            .collect();
        times.sort_unstable_by_key(|(key, time)| (time.utc_nanos, *key));
        let numbers: HashMap<(i64, i32), u32> = (0..).zip(&times).map(|(bin, (key, _))| (*key, bin)).collect();
        DayBins {
            of_scans: day.scans.iter().map(|scan| numbers.get(&key(scan)).copied().unwrap_or(0)).collect(),
            odds: day.scans.iter().map(|scan| sensors.odds(scan.sensor)).collect(),
            times: times.into_iter().map(|(_, time)| time).collect(),
        }
    }
}

/// The scans that saw some tiles, numbered without gaps.
struct SeenScans {
    ranges: Vec<(u32, u32)>,
    /// Consecutive scans of one bin: the number behind the last, and the bin.
    runs: Vec<(u32, u32)>,
    /// The sums of the log odds of all hits, and of all misses, before each scan, and after the last.
    before: Vec<RayOdds>,
    /// The bins, ascending.
    bins: Vec<u32>,
}

impl SeenScans {
    fn new(ranges: &[(u32, u32)], day: &DayBins) -> SeenScans {
        let (mut runs, mut before, mut sum): (Vec<(u32, u32)>, _, _) = (Vec::new(), Vec::new(), RayOdds::default());
        for scan in ranges.iter().flat_map(|&(first, end)| first..end) {
            let (bin, odds) = day.of_scans.get(scan as usize).zip(day.odds.get(scan as usize)).unzip();
            let (bin, odds) = (bin.copied().unwrap_or(0), odds.copied().unwrap_or_default());
            before.push(sum);
            sum = RayOdds { hit: sum.hit + odds.hit, miss: sum.miss + odds.miss };
            let end = u32::try_from(before.len()).unwrap_or(u32::MAX);
            match runs.last_mut() {
                Some((known, last)) if *last == bin => *known = end,
                _ => runs.push((end, bin)),
            }
        }
        before.push(sum);
        let mut bins: Vec<u32> = runs.iter().map(|&(_, bin)| bin).collect();
        bins.sort_unstable();
        bins.dedup();
        SeenScans { ranges: ranges.to_vec(), runs, before, bins }
    }

    /// The log odds of a cell that reads alike in scans `from` until before `to`.
    fn odds(&self, from: u32, to: u32, is_occupied: bool) -> i64 {
        let at = |scan: u32| self.before.get(scan as usize).copied().unwrap_or_default();
        let (from, to) = (at(from), at(to));
        if is_occupied { to.hit - from.hit } else { to.miss - from.miss }
    }

    /// The masks of a tile in each of the bins.
    fn masks(&self, tile: &DayTile) -> Vec<TileMasks> {
        let flipped = tile.flips.iter().fold(Mask::EMPTY, |all, flip| all | Mask::of(flip.cell()));
        let steady = tile.first.observed().without(flipped);
        let mut observed = vec![steady; self.bins.len()];
        let mut occupied = vec![tile.first.occupied() & steady; self.bins.len()];
        let mut slots = [0_u16; TILE_CELLS];
        let mut cells: Vec<CellOdds> = Vec::new();
        for cell in flipped.cells() {
            slots[usize::from(cell)] = cells.len() as u16;
            let (is_observed, is_occupied) =
                (tile.first.observed().contains(cell), tile.first.occupied().contains(cell));
            cells.push(CellOdds { is_observed, is_occupied, since: 0, odds: vec![None; self.bins.len()] });
        }
        let (mut passed, mut ranges) = (0, self.ranges.as_slice());
        for flip in &tile.flips {
            // The flips ascend by scan.
            while let Some(&(first, end)) = ranges.first().filter(|(_, end)| flip.scan >= *end) {
                passed += end - first;
                ranges = &ranges[1..];
            }
            let number = ranges.first().map_or(passed, |(first, _)| passed + flip.scan.saturating_sub(*first));
            let slot = slots.get(usize::from(flip.cell())).copied().unwrap_or(0);
            let Some(cell) = cells.get_mut(usize::from(slot)) else { continue };
            cell.read_until(number, self);
            match flip.bit() {
                Bit::Observed => cell.is_observed = !cell.is_observed,
                Bit::Occupied => cell.is_occupied = !cell.is_occupied,
            }
        }
        let end = u32::try_from(self.before.len().saturating_sub(1)).unwrap_or(u32::MAX);
        for (place, mut cell) in flipped.cells().zip(cells) {
            cell.read_until(end, self);
            for ((odds, observed), occupied) in cell.odds.iter().zip(&mut observed).zip(&mut occupied) {
                let Some(odds) = *odds else { continue };
                observed.insert(place);
                if odds > 0 {
                    occupied.insert(place);
                }
            }
        }
        observed.into_iter().zip(occupied).map(|(observed, occupied)| TileMasks::clipped(observed, occupied)).collect()
    }
}

/// The readings of a cell that changes within the day.
struct CellOdds {
    is_observed: bool,
    is_occupied: bool,
    /// The first scan that is not in `odds` yet.
    since: u32,
    /// The log odds in each bin; `None` where the cell was not observed.
    odds: Vec<Option<i64>>,
}

impl CellOdds {
    /// Adds the scans before `end`, in which the cell reads alike.
    fn read_until(&mut self, end: u32, scans: &SeenScans) {
        let mut from = self.since;
        self.since = end.max(from);
        if !self.is_observed {
            return;
        }
        let mut run = scans.runs.partition_point(|&(until, _)| until <= from);
        while let Some(&(until, bin)) = scans.runs.get(run).filter(|_| from < end) {
            let to = until.min(end);
            let of_bin = scans.bins.binary_search(&bin).ok().and_then(|at| self.odds.get_mut(at));
            if let Some(odds) = of_bin {
                *odds = Some(odds.unwrap_or(0) + scans.odds(from, to, self.is_occupied));
            }
            (from, run) = (to, run + 1);
        }
    }
}

/// A day of scans as a day of bins.
pub(crate) fn bins_of(day: &GridDay, sensors: &Sensors) -> GridDay {
    let bins = DayBins::new(day, sensors);
    let presence = day.presence_by_tile();
    let mut by_ranges: HashMap<&[(u32, u32)], Arc<SeenScans>> = HashMap::new();
    let scans: Vec<Arc<SeenScans>> = presence
        .iter()
        .map(|ranges| Arc::clone(by_ranges.entry(ranges).or_insert_with(|| Arc::new(SeenScans::new(ranges, &bins)))))
        .collect();
    let mut seen: Vec<Vec<TileId>> = vec![Vec::new(); bins.times.len()];
    for ((tile, _), scans) in day.tiles().zip(&scans) {
        for &bin in &scans.bins {
            if let Some(seen) = seen.get_mut(bin as usize) {
                seen.push(tile);
            }
        }
    }
    let mut binned = GridDay::new(day.day);
    for (&time, seen) in bins.times.iter().zip(seen) {
        binned.push(time, &Arc::from(seen));
    }
    let tiles: Vec<_> = day.tiles().zip(scans).filter(|(_, scans)| !scans.bins.is_empty()).collect();
    let tiles: Vec<_> = tiles
        .into_par_iter()
        .map(|((id, tile), scans)| {
            let masks = scans.masks(tile);
            let mut shown = scans.bins.iter().zip(&masks);
            let first = shown.next().map(|(_, masks)| *masks).unwrap_or_default();
            let mut of_bins = DayTile { first, flips: Vec::new(), last: first };
            for (&bin, &masks) in shown {
                of_bins.show(bin, masks);
            }
            (id, of_bins)
        })
        .collect();
    for (id, tile) in tiles {
        binned.put(id, tile);
    }
    binned
}

#[cfg(test)]
mod tests;
