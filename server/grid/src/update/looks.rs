//! Scores the cells of a tile in scan blocks: scans that no candidate period can distinguish are predicted together.
//!
//! Local time is divided into short time bins of a 60th of the shortest candidate period. Consecutive scans of one time
//! bin are a scan block (`look` in the code); it is predicted at the mean time of the bin's scans. The readings of a
//! cell in a block are sums, which cells without a change in the block share. Invariant: a scan counts in a block
//! exactly if it would count alone. The pieces in which an update is done never cut a block; an update that ends within
//! a time bin scores the bin in two parts.

use std::{collections::HashMap, ops::Range};

use tidemap_model::{Periodicities, PhasorTable, ReadingSums};

use super::{super::fold::Cursor, rules::Rules, shared_sums::Times};

#[cfg(test)]
mod tests;

/// The scan blocks of a pattern's scans on a day.
#[derive(Debug)]
pub(super) struct Looks {
    /// The first scan of each block, followed by the number of scans.
    bounds: Vec<usize>,
    /// The time at which each block is predicted, local civil time.
    civil_nanos: Vec<i64>,
}

impl Looks {
    /// The scan blocks of scans with these local times, in their order.
    pub(super) fn new(scans: &[i64], periodicities: &Periodicities) -> Looks {
        let width = periodicities.look_nanos();
        let (mut bounds, mut bins, mut before) = (Vec::new(), Vec::new(), None);
        // For each time bin: the number of scans, and the sum of their times since the start of the bin.
        let mut times: HashMap<i64, (i128, i128)> = HashMap::new();
        for (scan, &civil) in scans.iter().enumerate() {
            let bin = civil.div_euclid(width);
            if before != Some(bin) {
                bounds.push(scan);
                bins.push(bin);
                before = Some(bin);
            }
            let (count, sum) = times.entry(bin).or_default();
            *count += 1;
            *sum += i128::from(civil.rem_euclid(width));
        }
        bounds.push(scans.len());
        // The mean lies within the bin, because all its scans do.
        let mean = |&bin: &i64| {
            let within = times.get(&bin).map_or(0, |&(count, sum)| sum / count.max(1));
            bin.saturating_mul(width).saturating_add(i64::try_from(within).unwrap_or(0))
        };
        Looks { bounds, civil_nanos: bins.iter().map(mean).collect() }
    }

    /// The blocks in chunks; the phasors of one chunk are in memory at a time.
    pub(super) fn chunks<'a>(&'a self, times: &'a Times, rules: &'a Rules) -> impl Iterator<Item = LookChunk<'a>> {
        let chunk_looks = rules.limits.chunk_scans.max(1);
        let levels = Levels {
            own: rules.levels,
            of_scans: times.weighted.as_ref().map(|scans| scans.levels(0, times.utc_nanos.len())),
        };
        self.civil_nanos.chunks(chunk_looks).enumerate().map(move |(number, civil_nanos)| {
            let first = number * chunk_looks;
            let bounds = self.bounds.get(first..=first + civil_nanos.len()).unwrap_or_default();
            let phasors = PhasorTable::new(&rules.periodicities, civil_nanos);
            LookChunk::new(bounds, phasors, &times.utc_nanos, levels)
        })
    }
}

/// The values of free and occupied readings.
#[derive(Clone, Copy, Debug)]
struct Levels<'a> {
    own: (f64, f64),
    /// The values of each scan; `None` if all are of the map's own sensor.
    of_scans: Option<(&'a [f64], &'a [f64])>,
}

impl Levels<'_> {
    #[inline]
    fn of(&self, scan: usize, is_occupied: bool) -> f64 {
        let level =
            |own: f64, of_scans: Option<&[f64]>| of_scans.and_then(|levels| levels.get(scan)).copied().unwrap_or(own);
        match is_occupied {
            true => level(self.own.1, self.of_scans.map(|(_, occupied)| occupied)),
            false => level(self.own.0, self.of_scans.map(|(free, _)| free)),
        }
    }
}

/// The readings of free cells and of occupied cells, in all blocks of a chunk.
#[derive(Debug, Default)]
struct LevelReadings {
    free: ReadingSums,
    occupied: ReadingSums,
}

impl LevelReadings {
    fn of(&self, is_occupied: bool) -> &ReadingSums {
        if is_occupied { &self.occupied } else { &self.free }
    }
}

/// Consecutive scan blocks with their phasors.
#[derive(Debug)]
pub(super) struct LookChunk<'a> {
    bounds: &'a [usize],
    pub(super) phasors: PhasorTable,
    /// The times of all scans.
    utc_nanos: &'a [i64],
    levels: Levels<'a>,
    /// The readings if every scan counts.
    all: LevelReadings,
}

impl<'a> LookChunk<'a> {
    fn new(bounds: &'a [usize], phasors: PhasorTable, utc_nanos: &'a [i64], levels: Levels<'a>) -> LookChunk<'a> {
        let mut chunk = LookChunk { bounds, phasors, utc_nanos, levels, all: LevelReadings::default() };
        let mut all = LevelReadings::default();
        chunk.set_levels(&mut all, |_| true);
        chunk.all = all;
        chunk
    }

    /// The scans of the chunk.
    fn scans(&self) -> Range<usize> {
        self.bounds.first().copied().unwrap_or(0)..self.bounds.last().copied().unwrap_or(0)
    }

    fn set_levels(&self, readings: &mut LevelReadings, counts: impl Fn(usize) -> bool) {
        for (is_occupied, readings) in [(false, &mut readings.free), (true, &mut readings.occupied)] {
            readings.clear();
            for look in self.bounds.windows(2) {
                let scans = (look[0]..look[1]).filter(|&scan| counts(scan));
                readings.push(scans.map(|scan| self.levels.of(scan, is_occupied)));
            }
        }
    }
}

/// The state of scoring the cells of a group on the day.
#[derive(Debug)]
pub(super) struct GroupScoring {
    /// Scans up to this time are not scored; `None`: nothing is scored.
    pub(super) newer_than: Option<i64>,
    /// Whether every scan of the pattern counts.
    pub(super) all: bool,
    /// The position in the toggles of the group.
    pub(super) cursor: Cursor,
}

/// Buffers for the groups of a tile while a chunk is scored.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Whether each scan of the chunk counts.
    counted: Vec<bool>,
    of_group: LevelReadings,
    mixed: ReadingSums,
}

/// The readings of a group's cells in the blocks of a chunk.
pub(super) struct GroupReadings<'a> {
    chunk: &'a LookChunk<'a>,
    /// Whether each scan counts; `None`: every scan counts.
    counted: Option<&'a [bool]>,
    levels: &'a LevelReadings,
    mixed: &'a mut ReadingSums,
    /// Number of scans that count.
    pub(super) scored: u64,
}

impl GroupScoring {
    /// The readings of the group's cells; `None` if no scan of the chunk counts. `toggles`: the toggles of the group.
    /// Chunks must be given in their order.
    pub(super) fn readings<'a>(
        &mut self,
        toggles: &[u32],
        chunk: &'a LookChunk<'a>,
        scratch: &'a mut Scratch,
    ) -> Option<GroupReadings<'a>> {
        let newer_than = self.newer_than?;
        let scans = chunk.scans();
        let Scratch { counted, of_group, mixed } = scratch;
        if self.all {
            let scored = scans.len() as u64;
            return Some(GroupReadings { chunk, counted: None, levels: &chunk.all, mixed, scored });
        }
        let first = scans.start;
        counted.clear();
        counted.extend(scans.map(|scan| {
            let is_newer = chunk.utc_nanos.get(scan).is_some_and(|&nanos| nanos > newer_than);
            self.cursor.is_on_at(toggles, scan) && is_newer
        }));
        let counted: &[bool] = counted;
        let scored = counted.iter().filter(|counts| **counts).count() as u64;
        if scored == 0 {
            return None;
        }
        chunk.set_levels(of_group, |scan| counted.get(scan - first).is_some_and(|counts| *counts));
        Some(GroupReadings { chunk, counted: Some(counted), levels: of_group, mixed, scored })
    }
}

impl GroupReadings<'_> {
    /// The readings of one of the cells; `toggles` are the toggles of its occupied bit.
    pub(super) fn of_cell(&mut self, toggles: &[u32], cursor: &mut Cursor) -> &ReadingSums {
        let (bounds, scans) = (self.chunk.bounds, self.chunk.scans());
        let next = |cursor: &Cursor| toggles.get(cursor.at).map_or(usize::MAX, |&toggle| toggle as usize);
        if next(cursor) >= scans.end {
            return self.levels.of(cursor.is_on);
        }
        self.mixed.clear();
        let mut look = 0;
        while next(cursor) < scans.end {
            let at = bounds.partition_point(|&bound| bound <= next(cursor)).saturating_sub(1).max(look);
            self.mixed.extend_from(self.levels.of(cursor.is_on), look..at);
            let of_look =
                bounds.get(at).copied().unwrap_or(scans.end)..bounds.get(at + 1).copied().unwrap_or(scans.end);
            let counts = |scan: usize| {
                self.counted.is_none_or(|counted| counted.get(scan - scans.start).is_some_and(|counts| *counts))
            };
            self.mixed.push(of_look.filter_map(|scan| {
                let is_on = cursor.is_on_at(toggles, scan);
                counts(scan).then(|| self.chunk.levels.of(scan, is_on))
            }));
            look = at + 1;
        }
        self.mixed.extend_from(self.levels.of(cursor.is_on), look..bounds.len().saturating_sub(1));
        &*self.mixed
    }
}

impl Cursor {
    /// Moves on to a scan, and returns whether the bit is set there.
    #[inline]
    fn is_on_at(&mut self, toggles: &[u32], scan: usize) -> bool {
        while toggles.get(self.at).is_some_and(|&toggle| toggle as usize <= scan) {
            *self = Cursor { at: self.at + 1, is_on: !self.is_on };
        }
        self.is_on
    }

    /// Moves on to the end of a chunk.
    pub(super) fn skip(&mut self, toggles: &[u32], chunk: &LookChunk<'_>) {
        if let Some(last) = chunk.scans().end.checked_sub(1) {
            self.is_on_at(toggles, last);
        }
    }
}
