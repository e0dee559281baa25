//! Tiles that were seen by the same scans of a day.
//!
//! Many tiles are worked off in several batches, each with the phasors and running sums of the pattern's scans made anew.
//!
//! Invariant: the running sums of a pattern go on from chunk to chunk, so that a run of readings costs two rows of them
//! however many chunks it spans. What a tile becomes does not depend on the others of its batch, and tiles with the same
//! history share their sums across batches.

use std::{
    collections::{HashMap, HashSet},
    sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError},
};

use rayon::prelude::*;
use tidemap_model::{PhasorSum, PhasorTable, RunningSums};

use super::{
    super::{
        day::{DayTile, GridDay},
        index::TileId,
        sensor_sums::{GroupSums, WeightedSums},
        sensors::{SensorId, Weights},
    },
    CHUNK, Rules, TileOutcome, Working,
    tile_day::TileDay,
    weighted::{WeightedRows, WeightedScans},
};

/// The scans that some tiles were seen by, and what these tiles share.
#[derive(Debug)]
pub(super) struct Pattern {
    /// The scans, first and end of each range.
    ranges: Vec<(u32, u32)>,
    times: OnceLock<Times>,
    /// Held while nothing is done in parallel: a thread that waits for others may begin another batch.
    gains: Mutex<Gains>,
}

/// Times of a pattern's scans.
#[derive(Debug)]
pub(super) struct Times {
    pub(super) utc_nanos: Vec<i64>,
    pub(super) civil_nanos: Arc<[i64]>,
    /// What is seen by all scans.
    pub(super) all: Counted,
    /// What the scans count; `None` where all are of the map's own sensor.
    pub(super) weighted: Option<WeightedScans>,
}

impl Times {
    /// How many scans see what turns over at these, and when the first and the last do.
    pub(super) fn count(&self, toggles: &[u32]) -> Counted {
        if toggles == [0] {
            return self.all;
        }
        let mut counted = Counted { observations: 0, first_nanos: i64::MAX, last_nanos: i64::MIN };
        for run in toggles.chunks(2) {
            let from = run.first().map_or(0, |&from| from as usize);
            let to = run.get(1).map_or(self.utc_nanos.len(), |&to| to as usize);
            for &nanos in self.utc_nanos.get(from..to).unwrap_or_default() {
                counted.observations += 1;
                counted.first_nanos = counted.first_nanos.min(nanos);
                counted.last_nanos = counted.last_nanos.max(nanos);
            }
        }
        counted
    }

    /// What the readings at which a bit with these toggles is set count.
    pub(super) fn weigh(&self, toggles: &[u32]) -> Weights {
        match &self.weighted {
            Some(weighted) => weighted.sum(toggles),
            None => Weights::own(run_length(toggles, self.utc_nanos.len())),
        }
    }
}

/// Number of scans at which a bit is set.
pub(super) fn run_length(toggles: &[u32], scans: usize) -> u64 {
    let end = u32::try_from(scans).unwrap_or(u32::MAX);
    toggles.chunks(2).map(|run| u64::from(run.get(1).unwrap_or(&end).saturating_sub(run[0]))).sum()
}

/// How often some cells were observed on the day, and when first and last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Counted {
    pub(super) observations: u64,
    pub(super) first_nanos: i64,
    pub(super) last_nanos: i64,
}

/// Phasors of one chunk of a pattern's scans.
pub(in crate::grid) struct Chunk<'a> {
    /// Number of the first scan.
    pub(in crate::grid) first: usize,
    pub(in crate::grid) phasors: &'a PhasorTable,
    /// Running sums: row i is that of the scans before scan `first` + i.
    pub(in crate::grid) rows: &'a RunningSums,
    /// The same, weighted; `None` where all scans are of the map's own sensor.
    pub(in crate::grid) weighted: Option<&'a WeightedRows>,
    /// What a free and an occupied reading of each scan count as; `None` where all are of the map's own sensor.
    pub(in crate::grid) levels: Option<(&'a [f64], &'a [f64])>,
    pub(in crate::grid) utc_nanos: &'a [i64],
    pub(in crate::grid) is_last: bool,
}

/// How far the toggles of a bit have been gone through.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::grid) struct Cursor {
    /// The next toggle.
    pub(in crate::grid) at: usize,
    /// Whether the bit is set so far.
    pub(in crate::grid) is_on: bool,
}

/// B_k over the scans at which some cells were observed on the day.
#[derive(Debug)]
struct Contribution {
    toggles: Vec<u32>,
    cursor: Cursor,
    sum: PhasorSum,
    /// G_k and D_k, where some of the scans are of another sensor than the map's own.
    weighted: Option<Box<(PhasorSum, PhasorSum)>>,
}

/// The gains of a pattern, and sums made of them, so that groups with the same history share theirs.
#[derive(Debug, Default)]
pub(super) struct Gains {
    gains: Vec<GroupSums>,
    by_toggles: HashMap<Vec<u32>, usize>,
    zero: Option<Arc<PhasorSum>>,
    /// By the group's sums before, by address, and the gain; the old sums are kept alive.
    shared: HashMap<([usize; 3], usize), (GroupSums, GroupSums)>,
}

impl Gains {
    /// What is to be computed of these toggles.
    fn missing<'a>(
        &self,
        toggles: impl Iterator<Item = &'a Vec<u32>>,
        times: &Times,
        rules: &Rules,
    ) -> Vec<Contribution> {
        let mut asked = HashSet::new();
        let missing = toggles.filter(|toggles| !self.by_toggles.contains_key(*toggles) && asked.insert(*toggles));
        missing.map(|toggles| Contribution::new(toggles.clone(), times, rules)).collect()
    }

    /// Takes what was computed; another batch may have been first.
    fn take(&mut self, contributions: Vec<Contribution>) {
        for Contribution { toggles, sum, weighted, .. } in contributions {
            let next = self.gains.len();
            if *self.by_toggles.entry(toggles).or_insert(next) == next {
                let weighted = weighted.map(|weighted| {
                    let (alpha, beta) = *weighted;
                    WeightedSums { alpha: Arc::new(alpha), beta: Arc::new(beta) }
                });
                self.gains.push(GroupSums { plain: Arc::new(sum), weighted });
            }
        }
    }

    /// The gain of cells with these toggles, where one was asked for.
    pub(super) fn gain(&self, toggles: &Vec<u32>) -> Option<usize> {
        self.by_toggles.get(toggles).copied()
    }

    /// The sums of a group that was not observed before the day.
    pub(super) fn sum(&mut self, index: usize, rules: &Rules) -> GroupSums {
        match self.gains.get(index) {
            Some(gain) => gain.clone(),
            None => self.zero(rules),
        }
    }

    /// The sums of a group none of whose observations are in them; all share them.
    pub(super) fn zero(&mut self, rules: &Rules) -> GroupSums {
        let zero = self.zero.get_or_insert_with(|| Arc::new(PhasorSum::zero(&rules.periodicities)));
        GroupSums { plain: Arc::clone(zero), weighted: None }
    }

    /// The sums of a group after the day.
    pub(super) fn add_to(&mut self, before: GroupSums, index: usize) -> GroupSums {
        let Some(gain) = self.gains.get(index) else { return before };
        let entry = self.shared.entry((before.addresses(), index)).or_insert_with(|| {
            let after = before.plus(gain);
            (before, after)
        });
        entry.1.clone()
    }
}

impl Pattern {
    pub(super) fn new(ranges: Vec<(u32, u32)>) -> Pattern {
        Pattern { ranges, times: OnceLock::new(), gains: Mutex::default() }
    }

    /// Number of the scans.
    pub(super) fn scans(&self) -> usize {
        self.ranges.iter().map(|(first, end)| (end - first) as usize).sum()
    }

    fn gains(&self) -> MutexGuard<'_, Gains> {
        self.gains.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn times(&self, day: &GridDay, rules: &Rules) -> Times {
        let scans: Vec<_> = self
            .ranges
            .iter()
            .filter_map(|&(first, end)| day.scans.get(first as usize..end as usize))
            .flatten()
            .collect();
        Times {
            utc_nanos: scans.iter().map(|scan| scan.utc_nanos).collect(),
            civil_nanos: scans.iter().map(|scan| scan.civil_nanos()).collect(),
            all: Counted {
                observations: scans.len() as u64,
                first_nanos: scans.iter().map(|scan| scan.utc_nanos).min().unwrap_or(i64::MAX),
                last_nanos: scans.iter().map(|scan| scan.utc_nanos).max().unwrap_or(i64::MIN),
            },
            weighted: scans
                .iter()
                .any(|scan| scan.sensor != SensorId::OWN)
                .then(|| WeightedScans::new(Arc::new(scans.iter().map(|scan| scan.sensor).collect()), &rules.sensors)),
        }
    }

    /// Works off the day for some of the tiles.
    pub(super) fn run(
        &self,
        rules: &Rules,
        day: &GridDay,
        tiles: Vec<(TileId, Working)>,
    ) -> Vec<((TileId, Working), TileOutcome)> {
        let times = self.times.get_or_init(|| self.times(day, rules));
        let unseen = DayTile::default();
        let mut tiles: Vec<TileDay> = tiles
            .into_par_iter()
            .map(|(id, working)| {
                // Each tile seen has shown something; one that has not loses nothing here.
                let tile = day.tile(id).unwrap_or(&unseen);
                TileDay::new(id, working, tile, &self.ranges, times, rules)
            })
            .collect();
        let mut contributions = self.gains().missing(tiles.iter().flat_map(TileDay::toggles), times, rules);
        let mut rows = RunningSums::new(&rules.periodicities);
        let mut weighted = times.weighted.as_ref().map(|_| WeightedRows::new(&rules.periodicities));
        for (number, civil_nanos) in times.civil_nanos.chunks(CHUNK).enumerate() {
            let first = number * CHUNK;
            let phasors = PhasorTable::new(&rules.periodicities, civil_nanos);
            rows.extend_chunk(&phasors);
            if let (Some(rows), Some(scans)) = (&mut weighted, &times.weighted) {
                rows.extend_chunk(&phasors, scans, first);
            }
            let levels = times.weighted.as_ref().map(|scans| scans.levels(first, civil_nanos.len()));
            let utc_nanos = &times.utc_nanos[first..first + civil_nanos.len()];
            let is_last = first + civil_nanos.len() == times.utc_nanos.len();
            let weighted = weighted.as_ref();
            let chunk = Chunk { first, phasors: &phasors, rows: &rows, weighted, levels, utc_nanos, is_last };
            contributions.par_iter_mut().for_each(|contribution| contribution.fold(&chunk));
            tiles.par_iter_mut().for_each(|tile| tile.fold(&chunk, rules));
        }
        let mut gains = self.gains();
        gains.take(contributions);
        for tile in &mut tiles {
            tile.regroup(&mut gains, times, rules);
        }
        drop(gains);
        tiles.into_par_iter().map(|tile| tile.refit(day.day, rules)).collect()
    }
}

impl Contribution {
    fn new(toggles: Vec<u32>, times: &Times, rules: &Rules) -> Contribution {
        let zero = || PhasorSum::zero(&rules.periodicities);
        let has_others = times.weighted.as_ref().is_some_and(|scans| scans.has_others(&toggles));
        let weighted = has_others.then(|| Box::new((zero(), zero())));
        Contribution { toggles, cursor: Cursor::default(), sum: zero(), weighted }
    }

    fn fold(&mut self, chunk: &Chunk<'_>) {
        let from = self.cursor;
        fold_toggles(&self.toggles, &mut self.cursor, &mut self.sum, chunk.rows, chunk);
        if let (Some((alpha, beta)), Some(rows)) = (self.weighted.as_deref_mut(), chunk.weighted) {
            fold_toggles(&self.toggles, &mut { from }, alpha, &rows.alpha, chunk);
            fold_toggles(&self.toggles, &mut { from }, beta, &rows.beta, chunk);
        }
    }
}

/// Adds the phasors of the scans of a chunk at which a bit is set, as `rows`, which are some of the chunk, have them.
pub(in crate::grid) fn fold_toggles(
    toggles: &[u32],
    cursor: &mut Cursor,
    sum: &mut PhasorSum,
    rows: &RunningSums,
    chunk: &Chunk<'_>,
) {
    let end = chunk.first + chunk.utc_nanos.len();
    while let Some(&toggle) = toggles.get(cursor.at).filter(|&&toggle| (toggle as usize) < end) {
        let row = rows.row(toggle as usize - chunk.first);
        if cursor.is_on {
            sum.add_row(row);
            *cursor = Cursor { at: cursor.at + 1, is_on: false };
            continue;
        }
        match toggles.get(cursor.at + 1).filter(|&&next| (next as usize) < end) {
            Some(&next) => {
                sum.add_difference(rows.row(next as usize - chunk.first), row);
                cursor.at += 2;
            }
            None => {
                sum.subtract_row(row);
                *cursor = Cursor { at: cursor.at + 1, is_on: true };
            }
        }
    }
    if chunk.is_last && cursor.is_on {
        sum.add_row(rows.row(chunk.utc_nanos.len()));
        cursor.is_on = false;
    }
}

/// Writes the value of each scan of a chunk that begins with scan `first`: that of a bit that is clear, or set, there.
pub(super) fn fill(values: &mut [f64], toggles: &[u32], cursor: Cursor, first: usize, (clear, set): (&[f64], &[f64])) {
    let (length, mut from, mut is_on) = (values.len(), 0, cursor.is_on);
    let mut write = |from: usize, to: usize, is_on: bool| {
        let levels = if is_on { set } else { clear };
        values[from..to].copy_from_slice(&levels[from..to]);
        to == length
    };
    for &toggle in toggles.get(cursor.at..).unwrap_or_default() {
        let to = (toggle as usize).saturating_sub(first).min(length);
        if write(from, to, is_on) {
            return;
        }
        (from, is_on) = (to, !is_on);
    }
    write(from, length, is_on);
}
