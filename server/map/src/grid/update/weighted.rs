//! What the scans of a pattern count, where some are of another sensor than the map's own.
//!
//! Invariant: all rows are as long as the pattern, and in its order.

use std::sync::Arc;

use tidemap_model::{Periodicities, PhasorTable, RunningSums};

use super::super::sensors::{SensorId, Sensors, Weights};

/// What each of some scans counts.
#[derive(Debug)]
pub(in crate::grid) struct WeightedScans {
    /// The sensor of each scan.
    pub(super) ids: Arc<Vec<SensorId>>,
    alpha: Vec<f64>,
    beta: Vec<f64>,
    /// What a free and an occupied reading of each scan count as.
    free: Vec<f64>,
    occupied: Vec<f64>,
    /// Σα and Σβ over the scans before each, and over all.
    before: Vec<Weights>,
}

impl WeightedScans {
    pub(in crate::grid) fn new(ids: Arc<Vec<SensorId>>, sensors: &Sensors) -> WeightedScans {
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

    /// What free and occupied readings of some scans count as.
    pub(super) fn levels(&self, first: usize, count: usize) -> (&[f64], &[f64]) {
        let of = |levels: &'_ [f64]| levels.len().min(first)..levels.len().min(first + count);
        (&self.free[of(&self.free)], &self.occupied[of(&self.occupied)])
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

/// Running sums of weighted phasors, beside those of the phasors.
#[derive(Debug)]
pub(in crate::grid) struct WeightedRows {
    /// Of phasors times α.
    pub(in crate::grid) alpha: RunningSums,
    /// Of phasors times β.
    pub(in crate::grid) beta: RunningSums,
}

impl WeightedRows {
    pub(in crate::grid) fn new(periodicities: &Periodicities) -> WeightedRows {
        WeightedRows { alpha: RunningSums::new(periodicities), beta: RunningSums::new(periodicities) }
    }

    /// Moves on to the next chunk of the scans, which begins with scan `first`.
    pub(in crate::grid) fn extend_chunk(&mut self, phasors: &PhasorTable, scans: &WeightedScans, first: usize) {
        self.alpha.extend_weighted(phasors, scans.alpha.get(first..).unwrap_or_default());
        self.beta.extend_weighted(phasors, scans.beta.get(first..).unwrap_or_default());
    }
}
