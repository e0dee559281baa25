//! Tiles that were seen by the same scans of a day.
//!
//! Invariant: the running sums of a pattern go on from chunk to chunk, so that a run of readings costs two rows of them
//! however many chunks it spans.

use std::{collections::HashMap, sync::Arc};

use rayon::prelude::*;
use tidemap_model::{PhasorSum, PhasorTable, RunningSums};

use super::{
    super::{
        day::{DayTile, GridDay},
        index::TileId,
    },
    CHUNK, GridOutcome, Rules, Working,
    tile_day::TileDay,
};

/// Tiles that were seen by the same scans.
#[derive(Debug)]
pub(super) struct Pattern {
    /// Their scans, first and end of each range.
    ranges: Vec<(u32, u32)>,
    pub(super) tiles: Vec<(TileId, Working)>,
}

/// Times of a pattern's scans.
#[derive(Debug)]
pub(super) struct Times {
    pub(super) utc_nanos: Vec<i64>,
    pub(super) civil_nanos: Arc<[i64]>,
    /// What is seen by all scans.
    pub(super) all: Counted,
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
    pub(in crate::grid) utc_nanos: &'a [i64],
    pub(in crate::grid) is_last: bool,
}

/// B_k over the scans at which some cells were observed on the day.
#[derive(Debug)]
struct Contribution {
    toggles: Vec<u32>,
    at: usize,
    is_on: bool,
    sum: PhasorSum,
}

/// What a group's cells gain on the day.
#[derive(Clone, Debug)]
struct Gain {
    sum: Arc<PhasorSum>,
}

/// The gains of a pattern, and sums made of them, so that groups with the same history share theirs.
#[derive(Debug, Default)]
pub(super) struct Gains {
    gains: Vec<Gain>,
    by_toggles: HashMap<Vec<u32>, usize>,
    zero: Option<Arc<PhasorSum>>,
    /// By the group's sum before, by address, and the gain; the old sum is kept alive.
    shared: HashMap<(usize, usize), (Arc<PhasorSum>, Arc<PhasorSum>)>,
}

impl Gains {
    /// The gain of cells with these toggles, where one was asked for.
    pub(super) fn gain(&self, toggles: &Vec<u32>) -> Option<usize> {
        self.by_toggles.get(toggles).copied()
    }

    /// The sum of a group that was not observed before the day.
    pub(super) fn sum(&self, index: usize, rules: &Rules) -> Arc<PhasorSum> {
        self.gains
            .get(index)
            .map_or_else(|| Arc::new(PhasorSum::zero(&rules.periodicities)), |gain| Arc::clone(&gain.sum))
    }

    /// The sum of a group none of whose observations are in it; all share it.
    pub(super) fn zero(&mut self, rules: &Rules) -> Arc<PhasorSum> {
        Arc::clone(self.zero.get_or_insert_with(|| Arc::new(PhasorSum::zero(&rules.periodicities))))
    }

    /// The sum of a group after the day.
    pub(super) fn add_to(&mut self, before: &Arc<PhasorSum>, index: usize) -> Arc<PhasorSum> {
        let Some(gain) = self.gains.get(index) else { return Arc::clone(before) };
        let entry = self.shared.entry((Arc::as_ptr(before) as usize, index)).or_insert_with(|| {
            let mut sum = PhasorSum::clone(before);
            sum.add(&gain.sum);
            (Arc::clone(before), Arc::new(sum))
        });
        Arc::clone(&entry.1)
    }
}

impl Pattern {
    pub(super) fn new(ranges: Vec<(u32, u32)>) -> Pattern {
        Pattern { ranges, tiles: Vec::new() }
    }

    fn times(&self, day: &GridDay) -> Times {
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
        }
    }

    /// Works off the day for these tiles.
    pub(super) fn run(self, rules: &Rules, day: &GridDay) -> (Vec<(TileId, Working)>, GridOutcome) {
        let times = self.times(day);
        let unseen = DayTile::default();
        let mut contributions: Vec<Contribution> = Vec::new();
        let mut gains = Gains::default();
        let mut tiles: Vec<TileDay> = self
            .tiles
            .into_par_iter()
            .map(|(id, working)| {
                // Each tile seen has shown something; one that has not loses nothing here.
                let tile = day.tile(id).unwrap_or(&unseen);
                TileDay::new(id, working, tile, &self.ranges, &times, rules)
            })
            .collect();
        for toggles in tiles.iter().flat_map(TileDay::toggles) {
            if !gains.by_toggles.contains_key(toggles) {
                gains.by_toggles.insert(toggles.clone(), contributions.len());
                contributions.push(Contribution::new(toggles.clone(), rules));
            }
        }
        let mut rows = RunningSums::new(&rules.periodicities);
        for (number, civil_nanos) in times.civil_nanos.chunks(CHUNK).enumerate() {
            let first = number * CHUNK;
            let phasors = PhasorTable::new(&rules.periodicities, civil_nanos);
            rows.extend_chunk(&phasors);
            let utc_nanos = &times.utc_nanos[first..first + civil_nanos.len()];
            let is_last = first + civil_nanos.len() == times.utc_nanos.len();
            let chunk = Chunk { first, phasors: &phasors, rows: &rows, utc_nanos, is_last };
            contributions.par_iter_mut().for_each(|contribution| contribution.fold(&chunk));
            tiles.par_iter_mut().for_each(|tile| tile.fold(&chunk, rules));
        }
        gains.gains = contributions.into_iter().map(Contribution::gain).collect();
        for tile in &mut tiles {
            tile.regroup(&mut gains, &times, rules);
        }
        let (tiles, outcomes): (Vec<_>, Vec<_>) = tiles.into_par_iter().map(|tile| tile.refit(day.day, rules)).unzip();
        let mut outcome = GridOutcome::default();
        outcomes.iter().for_each(|of_tile| outcome.add(of_tile));
        (tiles, outcome)
    }
}

impl Contribution {
    fn new(toggles: Vec<u32>, rules: &Rules) -> Contribution {
        Contribution { toggles, at: 0, is_on: false, sum: PhasorSum::zero(&rules.periodicities) }
    }

    fn fold(&mut self, chunk: &Chunk<'_>) {
        fold_toggles(&self.toggles, &mut self.at, &mut self.is_on, &mut self.sum, chunk);
    }

    fn gain(self) -> Gain {
        Gain { sum: Arc::new(self.sum) }
    }
}

/// Adds the phasors of the scans of a chunk at which a bit is set. `at` is the next toggle, `is_on` the bit so far.
pub(in crate::grid) fn fold_toggles(
    toggles: &[u32],
    at: &mut usize,
    is_on: &mut bool,
    sum: &mut PhasorSum,
    chunk: &Chunk<'_>,
) {
    let end = chunk.first + chunk.utc_nanos.len();
    while let Some(&toggle) = toggles.get(*at).filter(|&&toggle| (toggle as usize) < end) {
        let row = chunk.rows.row(toggle as usize - chunk.first);
        if *is_on {
            sum.add_row(row);
            (*at, *is_on) = (*at + 1, false);
            continue;
        }
        match toggles.get(*at + 1).filter(|&&next| (next as usize) < end) {
            Some(&next) => {
                sum.add_difference(chunk.rows.row(next as usize - chunk.first), row);
                *at += 2;
            }
            None => {
                sum.subtract_row(row);
                (*at, *is_on) = (*at + 1, true);
            }
        }
    }
    if chunk.is_last && *is_on {
        sum.add_row(chunk.rows.row(chunk.utc_nanos.len()));
        *is_on = false;
    }
}
