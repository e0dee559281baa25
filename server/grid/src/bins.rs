//! Bins of half an hour: the evidence from which cells are learned.
//!
//! Rays of one sensor contradict each other: a ray that grazes a table passes cells in which others end. So the rays of
//! a bin are one piece of evidence, as the posterior of an occupancy grid (Moravec and Elfes 1985; OctoMap, Hornung et
//! al. 2013): each scan adds the log odds of its sensor's hit or miss, and the cell counts as occupied in the bin if
//! they add up to more than 0. A rhythm is then one of things, such as "a table stands here from 9 to 12", and an
//! update costs bins instead of readings.
//!
//! Invariant: a day of bins has one scan for each bin with a scan, with the mean time of the bin's scans, and a cell is
//! observed in a bin if a scan of the bin observed it, except where another sensor sees a thing there (see
//! [`crate::standing`]). The result does not depend on the order of the scans.

use std::{
    collections::{BTreeSet, HashMap},
    sync::Arc,
};

use rayon::prelude::*;

use crate::{
    day::{Bit, DayTile, GridDay, ScanTime},
    index::{TILE_CELLS, TileId},
    mask::{Mask, TileMasks},
    ray_odds::RayOdds,
    scan::ScanSource,
    sensors::{SensorId, Sensors},
    standing::Standing,
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
    /// The sources of the day's scans, ascending.
    sources: Vec<ScanSource>,
    /// The index in `sources` of each scan's source.
    source_of_scans: Vec<u32>,
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
                let (offset_secs, source) = (key.1, ScanSource::Cells);
                (key, ScanTime { utc_nanos: mean, offset_secs, sensor: SensorId::OWN, source })
            })
            .collect();
        times.sort_unstable_by_key(|(key, time)| (time.utc_nanos, *key));
        let numbers: HashMap<(i64, i32), u32> = (0..).zip(&times).map(|(bin, (key, _))| (*key, bin)).collect();
        let sources: BTreeSet<ScanSource> = day.scans.iter().map(|scan| scan.source).collect();
        let sources: Vec<ScanSource> = sources.into_iter().collect();
        let index = |scan: &ScanTime| sources.binary_search(&scan.source).ok().and_then(|at| u32::try_from(at).ok());
        DayBins {
            of_scans: day.scans.iter().map(|scan| numbers.get(&key(scan)).copied().unwrap_or(0)).collect(),
            odds: day.scans.iter().map(|scan| sensors.odds(scan.sensor, scan.source)).collect(),
            source_of_scans: day.scans.iter().map(|scan| index(scan).unwrap_or(0)).collect(),
            sources,
            times: times.into_iter().map(|(_, time)| time).collect(),
        }
    }
}

/// The scans of one source, among the scans that saw some tiles.
struct SourceScans {
    source: ScanSource,
    /// The number of scans of this source, and the sums of their log odds, before each of all scans, and after the
    /// last.
    before: Vec<(u32, RayOdds)>,
    /// Whether the source has a scan in each bin.
    is_in_bin: Vec<bool>,
}

impl SourceScans {
    /// The log odds of a cell that reads alike in the scans `from` until before `to`; `None` without a scan of this
    /// source.
    fn odds(&self, from: u32, to: u32, is_occupied: bool) -> Option<i64> {
        let at = |scan: u32| self.before.get(scan as usize).copied().unwrap_or_default();
        let ((first, from), (end, to)) = (at(from), at(to));
        (end > first).then(|| if is_occupied { to.hit - from.hit } else { to.miss - from.miss })
    }
}

/// The scans that saw some tiles, numbered without gaps.
struct SeenScans {
    ranges: Vec<(u32, u32)>,
    /// Consecutive scans of one bin: the number behind the last, and the bin.
    runs: Vec<(u32, u32)>,
    /// The number of scans.
    count: u32,
    by_source: Vec<SourceScans>,
    /// The bins, ascending.
    bins: Vec<u32>,
}

impl SeenScans {
    fn new(ranges: &[(u32, u32)], day: &DayBins) -> SeenScans {
        let mut scans =
            SeenScans { ranges: ranges.to_vec(), runs: Vec::new(), count: 0, by_source: Vec::new(), bins: Vec::new() };
        let mut sources = vec![false; day.sources.len()];
        for scan in ranges.iter().flat_map(|&(first, end)| first..end) {
            let bin = day.of_scans.get(scan as usize).copied().unwrap_or(0);
            let source = day.source_of_scans.get(scan as usize).copied().unwrap_or(0);
            if let Some(is_among) = sources.get_mut(source as usize) {
                *is_among = true;
            }
            scans.count += 1;
            match scans.runs.last_mut() {
                Some((known, last)) if *last == bin => *known = scans.count,
                _ => scans.runs.push((scans.count, bin)),
            }
        }
        scans.bins = scans.runs.iter().map(|&(_, bin)| bin).collect();
        scans.bins.sort_unstable();
        scans.bins.dedup();
        let of_source = |(index, &source): (u32, &ScanSource)| {
            let (mut before, mut sum, mut is_in_bin) =
                (Vec::with_capacity(scans.count as usize + 1), (0, RayOdds::default()), vec![false; scans.bins.len()]);
            for scan in ranges.iter().flat_map(|&(first, end)| first..end) {
                before.push(sum);
                if day.source_of_scans.get(scan as usize) == Some(&index) {
                    let odds = day.odds.get(scan as usize).copied().unwrap_or_default();
                    sum = (sum.0 + 1, RayOdds { hit: sum.1.hit + odds.hit, miss: sum.1.miss + odds.miss });
                    let bin = day.of_scans.get(scan as usize).copied().unwrap_or(0);
                    if let Some(is_in_bin) = scans.bin(bin).and_then(|bin| is_in_bin.get_mut(bin)) {
                        *is_in_bin = true;
                    }
                }
            }
            before.push(sum);
            SourceScans { source, before, is_in_bin }
        };
        scans.by_source =
            (0..).zip(&day.sources).zip(sources).filter(|(_, among)| *among).map(|(one, _)| of_source(one)).collect();
        scans
    }

    /// The index of a bin among those of the scans.
    fn bin(&self, bin: u32) -> Option<usize> {
        self.bins.binary_search(&bin).ok()
    }

    /// The masks of a tile in each of the bins.
    fn masks(&self, tile: &DayTile, standing: &mut Standing) -> Vec<TileMasks> {
        let flipped = tile.flips.iter().fold(Mask::EMPTY, |all, flip| all | Mask::of(flip.cell()));
        let steady = tile.first.observed().without(flipped);
        let steady = (steady, tile.first.occupied() & steady);
        let bins = self.bins.len();
        // By source, and then by bin.
        let in_bins = self.by_source.iter().flat_map(|scans| &scans.is_in_bin);
        let mut masks: Vec<(Mask, Mask)> =
            in_bins.map(|is_in_bin| if *is_in_bin { steady } else { (Mask::EMPTY, Mask::EMPTY) }).collect();
        let mut slots = [0_u16; TILE_CELLS];
        let mut cells: Vec<CellOdds> = Vec::new();
        for cell in flipped.cells() {
            slots[usize::from(cell)] = cells.len() as u16;
            let (is_observed, is_occupied) =
                (tile.first.observed().contains(cell), tile.first.occupied().contains(cell));
            cells.push(CellOdds { is_observed, is_occupied, since: 0, odds: vec![None; masks.len()] });
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
        for (place, mut cell) in flipped.cells().zip(cells) {
            cell.read_until(self.count, self);
            for (odds, (observed, occupied)) in cell.odds.iter().zip(&mut masks) {
                let Some(odds) = *odds else { continue };
                observed.insert(place);
                if odds > 0 {
                    occupied.insert(place);
                }
            }
        }
        let in_bin = |bin: usize| {
            let of_source = |(source, scans): (usize, &SourceScans)| {
                let &(observed, occupied) = masks.get(source * bins + bin)?;
                scans.is_in_bin.get(bin)?.then(|| (scans.source, TileMasks::clipped(observed, occupied)))
            };
            let readings: Vec<(ScanSource, TileMasks)> =
                self.by_source.iter().enumerate().filter_map(of_source).collect();
            standing.read(&readings)
        };
        (0..bins).map(in_bin).collect()
    }
}

/// The readings of a cell that changes within the day.
struct CellOdds {
    is_observed: bool,
    is_occupied: bool,
    /// The first scan that is not in `odds` yet.
    since: u32,
    /// The log odds by source, and then by bin; `None` where the cell was not observed.
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
            let Some(bin) = scans.bin(bin) else { break };
            for (source, of_source) in scans.by_source.iter().enumerate() {
                let Some(more) = of_source.odds(from, to, self.is_occupied) else { continue };
                if let Some(odds) = self.odds.get_mut(source * scans.bins.len() + bin) {
                    *odds = Some(odds.unwrap_or(0) + more);
                }
            }
            (from, run) = (to, run + 1);
        }
    }
}

/// A day of scans as a day of bins. `standing`: what the sources read before the day, for each tile of the day; it is
/// continued.
pub(crate) fn bins_of(day: &GridDay, sensors: &Sensors, standing: &mut [Standing]) -> GridDay {
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
    let tiles: Vec<_> = day.tiles().zip(scans).zip(standing).filter(|((_, scans), _)| !scans.bins.is_empty()).collect();
    let tiles: Vec<_> = tiles
        .into_par_iter()
        .map(|(((id, tile), scans), standing)| {
            let masks = scans.masks(tile, standing);
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
