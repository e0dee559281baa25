//! The rules that an update applies to all cells of a grid alike.

use std::sync::Arc;

use tidemap_model::{OrderCriterion, Periodicities};

use super::super::{
    fade::HalfLife,
    fold::CHUNK_SCANS_MAX,
    sensors::{SensorId, Sensors},
    spec::Evidence,
};

/// Sizes of the pieces in which an update is done. Results do not depend on them, except for rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UpdateLimits {
    /// Scans whose phasors are in memory at a time, 1 to 256.
    pub chunk_scans: usize,
    /// Maximum number of observation groups of a tile with a sum for each; with more groups, cells that never changed
    /// have runs.
    pub summed_groups_max: usize,
    /// The observation runs of a tile may take as much memory as this many sums for each group without one.
    pub runs_per_sum: usize,
    /// A batch gets no more tiles once it has this many cells, whatever the number of its scans: the phasors of a scan
    /// cost as much as about a hundred cells.
    pub batch_cells_min: usize,
    /// Maximum number of cells of a batch.
    pub batch_cells_max: usize,
}

impl Default for UpdateLimits {
    fn default() -> UpdateLimits {
        UpdateLimits {
            chunk_scans: CHUNK_SCANS_MAX,
            summed_groups_max: 16,
            runs_per_sum: 1,
            batch_cells_min: 2_000,
            batch_cells_max: 30_000,
        }
    }
}

/// The rules that all cells share.
#[derive(Clone, Debug)]
pub(crate) struct Rules {
    pub(crate) periodicities: Periodicities,
    pub(crate) criterion: OrderCriterion,
    pub(crate) evidence: Evidence,
    pub(crate) sensors: Arc<Sensors>,
    /// The half-life; `None`: all readings count alike.
    pub(crate) half_life: Option<HalfLife>,
    /// Values of a free and an occupied reading of the map's own sensor.
    pub(crate) levels: (f64, f64),
    pub(crate) limits: UpdateLimits,
}

impl Rules {
    pub(crate) fn new(
        periodicities: &Periodicities,
        criterion: OrderCriterion,
        evidence: Evidence,
        sensors: &Arc<Sensors>,
        half_life: Option<HalfLife>,
    ) -> Rules {
        let (sensors, levels) = (Arc::clone(sensors), sensors.levels(SensorId::OWN));
        let (periodicities, limits) = (periodicities.clone(), UpdateLimits::default());
        Rules { periodicities, criterion, evidence, sensors, half_life, levels, limits }
    }
}
