//! The learned data of one tile: the cells that were observed together, and the models and sums of changed cells.
//!
//! A cell that never changed is a bit. Cells that were observed at the same times so far form an observation group and
//! share B_k = Σ e^(-jω_k t) over its observations; groups of different tiles with the same history share it too. A
//! cell that changed has A_k over its occupied readings. Where a tile has many groups, the sums of groups without a
//! changed cell stop at some day, and later observations are kept as [`ObservationRuns`].
//!
//! Invariant: the groups of a tile are disjoint and hold exactly the cells that were ever observed; a changed cell lies
//! in a group; `TileSums` runs parallel to the groups and cells of its `TileModel`.

use std::sync::Arc;

use tidemap_model::{HoursSeen, LocalDay, OrderErrors, OrderWatch, PhasorSum, SpectralModel};

use crate::{
    fade::GroupFade,
    index::TileId,
    mask::Mask,
    observation_runs::ObservationRuns,
    observed_times::ObservedTimes,
    sensor_sums::{GroupSums, SensorSums, SensorWeights},
    sensors::{SensorId, Sensors, Weights},
    standing::Standing,
};

/// Cells of a tile that have been observed at the same times so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Group {
    /// The cells.
    pub cells: Mask,
    /// Number of observations of each cell, at least 1.
    pub observations: u64,
    /// Time of the first observation, nanoseconds UTC.
    pub first_nanos: i64,
    /// Time of the last observation, nanoseconds UTC.
    pub last_nanos: i64,
    /// How well each hour of the day is known.
    pub seen: HoursSeen,
}

/// The model of a cell that has changed.
#[derive(Clone, Debug, PartialEq)]
pub struct CellModel {
    /// The place of the cell in the tile.
    pub cell: u16,
    /// Number of occupied readings.
    pub occupied: u64,
    /// Mean and strongest components.
    pub spectral: SpectralModel,
    /// Components in force.
    pub order: u8,
    /// Decayed errors of each order.
    pub errors: OrderErrors,
    /// The day on which the cell's change alarm was raised, if the alarm is active.
    pub alarm_day: Option<LocalDay>,
}

/// The models of one tile in a generation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TileModel {
    /// Observation groups, ordered by their lowest cell.
    pub groups: Vec<Group>,
    /// Cells that were always read as occupied.
    pub always_occupied: Mask,
    /// Cells that have changed, ascending by place.
    pub cells: Vec<CellModel>,
    /// The weights of readings; `None` if all are of the map's own sensor and there is no half-life.
    pub sensors: Option<Box<SensorWeights>>,
}

impl TileModel {
    /// Cells that were ever observed.
    pub fn observed(&self) -> Mask {
        self.groups.iter().fold(Mask::EMPTY, |all, group| all | group.cells)
    }

    /// Cells that have changed.
    pub fn changed(&self) -> Mask {
        let mut mask = Mask::EMPTY;
        for cell in &self.cells {
            mask.insert(cell.cell);
        }
        mask
    }

    /// The group of a cell.
    pub fn group_of(&self, cell: u16) -> Option<&Group> {
        self.groups.iter().find(|group| group.cells.contains(cell))
    }

    /// The model of a cell that has changed.
    pub fn cell(&self, cell: u16) -> Option<&CellModel> {
        let at = self.cells.binary_search_by_key(&cell, |model| model.cell).ok()?;
        self.cells.get(at)
    }

    /// Σα and Σβ over the readings of a group, by its index.
    pub fn weights(&self, group: usize) -> Weights {
        let known = self.sensors.as_ref().and_then(|sensors| sensors.groups.get(group).copied());
        known.unwrap_or_else(|| Weights::own(self.groups.get(group).map_or(0, |group| group.observations)))
    }

    /// Total weight of the readings of a group, by its index.
    pub fn weight(&self, group: usize) -> f64 {
        let known = self.sensors.as_ref().and_then(|sensors| sensors.fades.get(group));
        known.map_or_else(|| self.groups.get(group).map_or(0.0, |group| group.observations as f64), |fade| fade.weight)
    }

    /// Whether cells that were always read alike may differ in their levels; this happens with readings of several
    /// sensors.
    pub(crate) fn has_own_levels(&self) -> bool {
        self.sensors.as_ref().is_some_and(|sensors| {
            let is_own = |(weights, fade): (&Weights, &GroupFade)| weights.alpha == 0.0 && weights.beta == fade.weight;
            sensors.fades.is_empty() || !sensors.groups.iter().zip(&sensors.fades).all(is_own)
        })
    }

    /// Σβ over the occupied readings of a changed cell, by its index.
    pub fn occupied_weight(&self, cell: usize) -> f64 {
        let known = self.sensors.as_ref().and_then(|sensors| sensors.occupied.get(cell).copied());
        known.unwrap_or_else(|| self.cells.get(cell).map_or(0.0, |cell| cell.occupied as f64))
    }

    /// The mean reading of the group's cells that were always read as free, and of those always read as occupied. The
    /// group is given by its index.
    pub(crate) fn constant_levels(&self, group: usize, sensors: &Sensors) -> (f64, f64) {
        let weights = self.weights(group);
        let weight = self.weight(group);
        if weight == 0.0 || weights == (Weights { alpha: 0.0, beta: weight }) {
            return sensors.levels(SensorId::OWN);
        }
        let mean = |is_occupied| sensors.value_of_units(weights.units(is_occupied) / weight);
        (mean(false), mean(true))
    }

    /// Starts to keep the weights of readings; all readings so far were of the map's own sensor. If `fades` is true,
    /// also starts to keep the fading of the readings; all readings so far count alike.
    pub(crate) fn keep_weights(&mut self, fades: bool) {
        let sensors = self.sensors.get_or_insert_with(|| {
            let groups = self.groups.iter().map(|group| Weights::own(group.observations)).collect();
            let occupied = self.cells.iter().map(|cell| cell.occupied as f64).collect();
            Box::new(SensorWeights { groups, occupied, fades: Vec::new() })
        });
        if fades && sensors.fades.len() != self.groups.len() {
            sensors.fades =
                self.groups.iter().map(|group| GroupFade::of_equal(group.observations, group.last_nanos)).collect();
        }
    }

    /// Memory in bytes, about.
    pub fn bytes(&self) -> usize {
        let components: usize = self.cells.iter().map(|cell| cell.spectral.components().len() * 24).sum();
        size_of::<Self>()
            + self.groups.len() * size_of::<Group>()
            + self.cells.len() * size_of::<CellModel>()
            + components
            + self.sensors.as_ref().map_or(0, |sensors| sensors.bytes())
    }
}

/// The sums from which the next generation's models of a tile follow.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TileSums {
    /// B_k of each group; for a group without a changed cell, without the part that `runs` holds.
    pub groups: Vec<Arc<PhasorSum>>,
    /// A_k of each changed cell, over the cell's occupied readings, each weighted by β.
    pub cells: Vec<PhasorSum>,
    /// The observation runs of cells without a complete sum. Unless these are empty, no group has both changed cells
    /// and others.
    pub runs: ObservationRuns,
    /// The times at which each group was observed.
    pub times: Vec<Arc<ObservedTimes>>,
    /// Support and change alarm of each changed cell.
    pub watches: Vec<OrderWatch>,
    /// The cells that each source of scans last read as occupied.
    pub standing: Standing,
    /// Weighted sums of the groups; `None` where all their readings are of the map's own sensor.
    pub sensors: Option<Box<SensorSums>>,
}

impl TileSums {
    /// All sums that groups and tiles may share.
    pub fn shared(&self) -> impl Iterator<Item = &Arc<PhasorSum>> {
        self.groups.iter().chain(self.sensors.iter().flat_map(|sensors| sensors.sums()))
    }

    /// The sums of a group.
    pub(crate) fn group(&self, index: usize) -> Option<GroupSums> {
        let plain = Arc::clone(self.groups.get(index)?);
        let weighted = self.sensors.as_ref().and_then(|sensors| sensors.groups.get(index).cloned().flatten());
        Some(GroupSums { plain, weighted, times: self.times.get(index).cloned() })
    }

    /// Replaces the sums of all groups.
    pub(crate) fn set_groups(&mut self, groups: Vec<GroupSums>) {
        let has_others = groups.iter().any(|group| group.weighted.is_some());
        let mut weighted = Vec::with_capacity(if has_others { groups.len() } else { 0 });
        self.groups = Vec::with_capacity(groups.len());
        self.times = Vec::with_capacity(groups.len());
        for group in groups {
            self.groups.push(group.plain);
            self.times.extend(group.times);
            if has_others {
                weighted.push(group.weighted);
            }
        }
        self.sensors = has_others.then(|| Box::new(SensorSums { groups: weighted }));
    }

    /// Replaces the sums of a group.
    pub(crate) fn set_group(&mut self, index: usize, group: GroupSums) {
        let count = self.groups.len();
        let Some(plain) = self.groups.get_mut(index) else { return };
        *plain = group.plain;
        if group.weighted.is_some() && self.sensors.is_none() {
            self.sensors = Some(Box::new(SensorSums { groups: vec![None; count] }));
        }
        if let Some(weighted) = self.sensors.as_mut().and_then(|sensors| sensors.groups.get_mut(index)) {
            *weighted = group.weighted;
        }
    }

    /// Appends a group.
    pub(crate) fn push_group(&mut self, group: GroupSums) {
        self.groups.push(group.plain);
        self.times.extend(group.times);
        if let Some(sensors) = &mut self.sensors {
            sensors.groups.push(group.weighted);
        }
    }

    /// Approximate memory in bytes; a sum that groups share counts once, a sum that tiles share counts for each tile.
    pub fn bytes(&self) -> usize {
        let mut distinct: Vec<&Arc<PhasorSum>> = self.shared().collect();
        distinct.sort_unstable_by_key(|sum| Arc::as_ptr(sum));
        distinct.dedup_by_key(|sum| Arc::as_ptr(sum));
        self.own_bytes() + distinct.iter().map(|sum| sum.bytes()).sum::<usize>()
    }

    /// Approximate memory in bytes of the data that is never shared.
    pub(crate) fn own_bytes(&self) -> usize {
        let pointers = self.groups.len() * size_of::<Arc<PhasorSum>>();
        let cells: usize = self.cells.iter().map(PhasorSum::bytes).sum();
        let sensors = self.sensors.as_ref().map_or(0, |sensors| size_of_val(sensors.groups.as_slice()));
        let times = self.times.len() * (size_of::<ObservedTimes>() + 3 * size_of::<usize>());
        let watches = size_of_val(self.watches.as_slice());
        let standing = self.standing.bytes();
        size_of::<Self>() + pointers + cells + self.runs.bytes() + sensors + times + watches + standing
    }
}

/// A tile's model and sums, while an update changes them.
#[derive(Debug, Default)]
pub(crate) struct TileData {
    pub(crate) model: TileModel,
    pub(crate) sums: TileSums,
}

impl TileData {
    /// Releases memory reserved for more groups and cells.
    pub(crate) fn shrink(&mut self) {
        self.model.groups.shrink_to_fit();
        self.model.cells.shrink_to_fit();
        self.sums.groups.shrink_to_fit();
        self.sums.cells.shrink_to_fit();
        self.sums.times.shrink_to_fit();
        self.sums.watches.shrink_to_fit();
        if let Some(weights) = &mut self.model.sensors {
            weights.groups.shrink_to_fit();
            weights.occupied.shrink_to_fit();
            weights.fades.shrink_to_fit();
        }
        if let Some(sums) = &mut self.sums.sensors {
            sums.groups.shrink_to_fit();
        }
    }
}

/// A source of tiles that are not in memory.
pub trait TileSource: Send + Sync + std::fmt::Debug {
    /// The model of a tile.
    ///
    /// # Errors
    /// [`TileUnavailable`] where it cannot be read.
    fn model(&self, tile: TileId) -> Result<Arc<TileModel>, TileUnavailable>;

    /// The sums of a tile.
    ///
    /// # Errors
    /// [`TileUnavailable`] where they cannot be read.
    fn sums(&self, tile: TileId) -> Result<Arc<TileSums>, TileUnavailable>;

    /// The concrete type, so that the store recognises its own sources.
    fn as_any(&self) -> &dyn std::any::Any;
}

/// A tile cannot be read from the disk.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("tile {} cannot be read: {reason}", .tile.0)]
pub struct TileUnavailable {
    /// The tile.
    pub tile: TileId,
    /// The reason.
    pub reason: String,
}

/// The place of a tile that is not in memory.
#[derive(Clone, Debug)]
pub struct ColdTile {
    /// The source that has the tile.
    pub source: Arc<dyn TileSource>,
    /// The tile.
    pub tile: TileId,
}

/// A tile's model, in memory or where it is kept.
#[derive(Clone, Debug)]
pub enum ModelSlot {
    /// The model is in memory.
    Resident(Arc<TileModel>),
    /// The model is on the disk.
    Cold(ColdTile),
}

/// A tile's sums, in memory or where they are kept.
#[derive(Clone, Debug)]
pub enum SumsSlot {
    /// The sums are in memory.
    Resident(Arc<TileSums>),
    /// The sums are on the disk.
    Cold(ColdTile),
}

impl Default for ModelSlot {
    /// A tile that no update has seen.
    fn default() -> ModelSlot {
        ModelSlot::Resident(Arc::default())
    }
}

impl Default for SumsSlot {
    /// A tile that no update has seen.
    fn default() -> SumsSlot {
        SumsSlot::Resident(Arc::default())
    }
}

impl ModelSlot {
    /// The model.
    ///
    /// # Errors
    /// [`TileUnavailable`] where the model cannot be read.
    pub fn get(&self) -> Result<Arc<TileModel>, TileUnavailable> {
        match self {
            ModelSlot::Resident(model) => Ok(Arc::clone(model)),
            ModelSlot::Cold(ColdTile { source, tile }) => source.model(*tile),
        }
    }
}

impl PartialEq for ModelSlot {
    /// Compares the contents, whether they are in memory or on the disk.
    fn eq(&self, other: &ModelSlot) -> bool {
        matches!((self.get(), other.get()), (Ok(one), Ok(other)) if one == other)
    }
}

impl PartialEq for SumsSlot {
    /// Compares the contents, whether they are in memory or on the disk.
    fn eq(&self, other: &SumsSlot) -> bool {
        matches!((self.get(), other.get()), (Ok(one), Ok(other)) if one == other)
    }
}

impl SumsSlot {
    /// The sums.
    ///
    /// # Errors
    /// [`TileUnavailable`] where they cannot be read.
    pub fn get(&self) -> Result<Arc<TileSums>, TileUnavailable> {
        match self {
            SumsSlot::Resident(sums) => Ok(Arc::clone(sums)),
            SumsSlot::Cold(ColdTile { source, tile }) => source.sums(*tile),
        }
    }

    /// The sums, for changes; a copy if others hold them too.
    ///
    /// # Errors
    /// [`TileUnavailable`] where they cannot be read.
    pub(crate) fn take(&mut self) -> Result<TileSums, TileUnavailable> {
        let sums = match self {
            SumsSlot::Resident(sums) => std::mem::take(sums),
            SumsSlot::Cold(ColdTile { source, tile }) => source.sums(*tile)?,
        };
        Ok(Arc::unwrap_or_clone(sums))
    }

    /// Memory in bytes, about.
    pub fn bytes(&self) -> usize {
        match self {
            SumsSlot::Resident(sums) => sums.bytes(),
            SumsSlot::Cold(_) => 0,
        }
    }
}
