//! Tiles that were seen by the same scans of a day.
//!
//! Many tiles are processed in several batches, each of which computes the phasors and running sums of the pattern's
//! scans again.
//!
//! Invariant: running sums continue from chunk to chunk, so that a run of readings costs two rows of them, however many
//! chunks it spans. The result of a tile does not depend on the other tiles of its batch, and tiles with the same
//! history share their sums across batches.

use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use rayon::prelude::*;
use tidemap_model::{PhasorTable, RunningSums};

use super::{
    super::{
        day::{DayTile, GridDay},
        fold::{Chunk, WeightedRows},
    },
    looks::Looks,
    rules::Rules,
    shared_sums::{Gains, Times},
    tile_day::{BusyTile, TileDay},
};
use crate::pace::Pace;

/// The scans that saw some tiles, and the data that these tiles share.
#[derive(Debug)]
pub(super) struct Pattern {
    /// The scans, as the first scan and the end of each range.
    ranges: Vec<(u32, u32)>,
    times: OnceLock<Times>,
    /// The lock is never held across parallel work: a thread that waits for others may start another batch.
    gains: Mutex<Gains>,
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

    /// Processes the day for some of the tiles.
    pub(super) fn run(&self, rules: &Rules, day: &GridDay, tiles: Vec<BusyTile>, pace: &dyn Pace) -> Vec<BusyTile> {
        let times = self.times.get_or_init(|| Times::new(&self.ranges, day, rules));
        let unseen = DayTile::default();
        let mut tiles: Vec<TileDay> = tiles
            .into_par_iter()
            .map(|tile| {
                // Each seen tile has shown masks, so the default is never used.
                let of_day = day.tile(tile.id).unwrap_or(&unseen);
                TileDay::new(tile, (day.day, of_day), &self.ranges, times, rules)
            })
            .collect();
        if tiles.iter().any(TileDay::is_scored) {
            for chunk in Looks::new(&times.civil_nanos, &rules.periodicities).chunks(times, rules) {
                tiles.par_iter_mut().for_each(|tile| {
                    pace.await_turn();
                    tile.score(&chunk, rules);
                });
            }
        }
        let mut contributions = self.gains().missing(tiles.iter().flat_map(TileDay::toggles), times, rules);
        let mut rows = RunningSums::new(&rules.periodicities);
        let mut weighted = times.weighted.as_ref().map(|_| WeightedRows::new(&rules.periodicities));
        for (number, civil_nanos) in times.civil_nanos.chunks(rules.limits.chunk_scans).enumerate() {
            let first = number * rules.limits.chunk_scans;
            let phasors = PhasorTable::new(&rules.periodicities, civil_nanos);
            rows.extend_chunk(&phasors);
            if let (Some(rows), Some(scans)) = (&mut weighted, &times.weighted) {
                rows.extend_chunk(&phasors, scans, first);
            }
            let scans = civil_nanos.len();
            let is_last = first + scans == times.utc_nanos.len();
            let chunk = Chunk { first, rows: &rows, weighted: weighted.as_ref(), scans, is_last };
            pace.await_turn();
            contributions.par_iter_mut().for_each(|contribution| contribution.fold(&chunk));
            tiles.par_iter_mut().for_each(|tile| {
                pace.await_turn();
                tile.fold(&chunk);
            });
        }
        let mut gains = self.gains();
        gains.take(contributions);
        for tile in &mut tiles {
            tile.regroup(&mut gains, times, rules);
        }
        drop(gains);
        let retrain = |tile: TileDay| {
            pace.await_turn();
            tile.retrain(times, rules)
        };
        tiles.into_par_iter().map(retrain).collect()
    }
}
