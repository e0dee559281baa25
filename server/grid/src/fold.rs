//! Sums of phasors over the scans at which a bit is set, chunk by chunk of scans.
//!
//! Where some scans are of another sensor than the map's own, sums of phasors weighted by α and β are kept beside the
//! plain sums (see [`crate::sensors`]).
//!
//! Invariant: running sums continue from chunk to chunk, so that a run of equal readings costs two rows of them,
//! however many chunks it spans.

use std::sync::Arc;

use tidemap_model::{Periodicities, PhasorSum, PhasorTable, RunningSums};

use crate::sensors::{SensorId, Sensors, Weights};

/// Maximum number of scans of one map day whose phasors are in memory at a time.
pub(super) const CHUNK_SCANS_MAX: usize = 256;

/// The sums over one chunk of a pattern's scans.
pub(super) struct Chunk<'a> {
    /// Number of the first scan.
    pub(super) first: usize,
    /// Running sums: row i is the sum of the scans before scan `first` + i.
    pub(super) rows: &'a RunningSums,
    /// The running sums with the weights of readings; `None` where all scans are of the map's own sensor.
    pub(super) weighted: Option<&'a WeightedRows>,
    /// Number of scans.
    pub(super) scans: usize,
    pub(super) is_last: bool,
}

/// A position in the toggles of a bit.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cursor {
    /// The next toggle.
    pub(super) at: usize,
    /// Whether the bit is set so far.
    pub(super) is_on: bool,
}

/// Adds the phasors of the chunk's scans at which a bit is set. `rows` are some of the running sums of the chunk.
pub(super) fn fold_toggles(
    toggles: &[u32],
    cursor: &mut Cursor,
    sum: &mut PhasorSum,
    rows: &RunningSums,
    chunk: &Chunk<'_>,
) {
    let end = chunk.first + chunk.scans;
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
        sum.add_row(rows.row(chunk.scans));
        cursor.is_on = false;
    }
}

/// Number of scans at which a bit is set.
pub(super) fn run_length(toggles: &[u32], scans: usize) -> u64 {
    let end = u32::try_from(scans).unwrap_or(u32::MAX);
    toggles.chunks(2).map(|run| u64::from(run.get(1).unwrap_or(&end).saturating_sub(run[0]))).sum()
}

/// The weights of scans.
#[derive(Debug)]
pub(super) struct WeightedScans {
    /// The sensor of each scan.
    pub(super) ids: Arc<Vec<SensorId>>,
    alpha: Vec<f64>,
    beta: Vec<f64>,
    /// The values of a free reading of each scan; `occupied` has the values of an occupied reading.
    free: Vec<f64>,
    occupied: Vec<f64>,
    /// Σα and Σβ over the scans before each scan, and over all scans.
    before: Vec<Weights>,
}

impl WeightedScans {
    pub(super) fn new(ids: Arc<Vec<SensorId>>, sensors: &Sensors) -> WeightedScans {
        let weights: Vec<Weights> = ids.iter().map(|&id| sensors.weights(id)).collect();
        let mut before = Vec::with_capacity(ids.len() + 1);
        let mut sum = Weights::default();
        before.push(sum);
        for &weights in &weights {
            sum += weights;
            before.push(sum);
        }
        WeightedScans {
            alpha: weights.iter().map(|weights| weights.alpha).collect(),
            beta: weights.iter().map(|weights| weights.beta).collect(),
            free: ids.iter().map(|&id| sensors.levels(id).0).collect(),
            occupied: ids.iter().map(|&id| sensors.levels(id).1).collect(),
            before,
            ids,
        }
    }

    /// The values of free and occupied readings of a range of scans.
    pub(super) fn levels(&self, first: usize, count: usize) -> (&[f64], &[f64]) {
        let range = |levels: &'_ [f64]| levels.len().min(first)..levels.len().min(first + count);
        (&self.free[range(&self.free)], &self.occupied[range(&self.occupied)])
    }

    /// Σα and Σβ over the scans at which a bit with these toggles is set.
    pub(super) fn sum(&self, toggles: &[u32]) -> Weights {
        let mut sum = Weights::default();
        for run in self.runs(toggles) {
            let at = |scan: usize| self.before.get(scan).copied().unwrap_or_default();
            let (from, to) = (at(run.start), at(run.end));
            sum += Weights { alpha: to.alpha - from.alpha, beta: to.beta - from.beta };
        }
        sum
    }

    /// Whether a bit with these toggles is set at a scan of another sensor than the map's own.
    pub(super) fn has_others(&self, toggles: &[u32]) -> bool {
        self.runs(toggles).any(|run| self.ids.get(run).unwrap_or_default().iter().any(|id| *id != SensorId::OWN))
    }

    /// The scans at which a bit with these toggles is set.
    fn runs(&self, toggles: &[u32]) -> impl Iterator<Item = std::ops::Range<usize>> {
        let end = self.ids.len();
        toggles.chunks(2).map(move |run| {
            let from = run.first().map_or(end, |&from| end.min(from as usize));
            from..run.get(1).map_or(end, |&to| end.min(to as usize)).max(from)
        })
    }
}

/// Running sums of weighted phasors.
#[derive(Debug)]
pub(super) struct WeightedRows {
    /// Running sums of phasors times α.
    pub(super) alpha: RunningSums,
    /// Running sums of phasors times β.
    pub(super) beta: RunningSums,
}

impl WeightedRows {
    pub(super) fn new(periodicities: &Periodicities) -> WeightedRows {
        WeightedRows { alpha: RunningSums::new(periodicities), beta: RunningSums::new(periodicities) }
    }

    /// Moves on to the next chunk of the scans, which begins with scan `first`.
    pub(super) fn extend_chunk(&mut self, phasors: &PhasorTable, scans: &WeightedScans, first: usize) {
        self.alpha.extend_weighted(phasors, scans.alpha.get(first..).unwrap_or_default());
        self.beta.extend_weighted(phasors, scans.beta.get(first..).unwrap_or_default());
    }
}
