//! Reads pending readings, which no history holds yet.
//!
//! Invariant: together with the history of all finished updates, this is every acknowledged observation except those
//! that a running update has taken.

use tidemap_grid::day::GridDay;
use tidemap_model::Sample;

use super::LiveMap;
use crate::{
    history::{Reading, Subject, cell_readings, day_readings},
    ids::StateId,
    update::UpdateWork,
};

impl LiveMap {
    /// Number of updates published so far.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Observations that no update has taken, from one instant until before another, in order of arrival; at most
    /// `at_most`.
    pub fn pending_readings(&self, subject: Subject, from_nanos: i64, to_nanos: i64, at_most: usize) -> Vec<Reading> {
        let within = from_nanos..to_nanos;
        match subject {
            Subject::State(state) => {
                let samples = self.pending.of_state(state).filter(|sample| within.contains(&sample.utc_nanos));
                samples.map(|sample: &Sample| (sample.utc_nanos, sample.value)).take(at_most).collect()
            }
            Subject::Cell(tile, cell) => {
                let Some(grid) = &self.grid else { return Vec::new() };
                let is_requested = |day: &&GridDay| day.scans.iter().any(|scan| within.contains(&scan.utc_nanos));
                let days = grid.days().iter().filter(is_requested);
                let pending = days.flat_map(|day| day_readings(day, tile, cell, &self.spec.periodicities));
                let future = grid.future_scans().iter().filter_map(|scan| {
                    let at = scan.tiles.binary_search_by_key(&tile, |(tile, _)| *tile).ok()?;
                    let (_, masks) = scan.tiles.get(at)?;
                    masks.observed().contains(cell).then(|| (scan.time.utc_nanos, masks.occupied().contains(cell)))
                });
                let requested = pending.chain(future).filter(|(nanos, _)| within.contains(nanos));
                cell_readings(requested.take(at_most)).collect()
            }
        }
    }

    /// A bounded extract of what the next update could learn, to judge whether an update is worth it: the states with
    /// the largest numbers of pending observations, ascending. It contains every n-th reading in order of arrival, but
    /// the first rows of changes and events, because a row has no meaning without the row before. It does not contain
    /// the observations of a running update.
    pub fn pending_extract(&self, states_max: usize, readings_max: usize) -> Vec<(StateId, Vec<Reading>)> {
        let reading = |sample: &Sample| (sample.utc_nanos, sample.value);
        self.pending.extract(states_max, |state, samples| {
            let is_of_rows = self.reporting(state).may_end();
            let step = if is_of_rows { 1 } else { samples.len().div_ceil(readings_max.max(1)) };
            samples.iter().step_by(step.max(1)).take(readings_max).map(reading).collect()
        })
    }
}

impl UpdateWork {
    /// Earliest time of the observations, nanoseconds UTC.
    pub fn from_nanos(&self) -> Option<i64> {
        let samples = self.samples.iter().flat_map(|(_, samples)| samples).map(|sample| sample.utc_nanos);
        let scans = self.grid.iter().flat_map(|grid| grid.days()).flat_map(|day| &day.scans).map(|scan| scan.utc_nanos);
        samples.chain(scans).min()
    }
}
