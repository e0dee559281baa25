//! The immutable view of a grid that queries read, and its predictions at any time.
//!
//! Invariant: a view never changes. A cell that was never observed has no probability.

use std::{collections::HashMap, sync::Arc};

use tidemap_model::{
    HoursSeen, InstantPhasors, LocalDay, MemoryBasis, Persistence, SpectralModel,
    models::Moment,
    selector::{ModelKind, ModelSelector},
};

use crate::{
    blend::memory_basis,
    generation::Generation,
    index::{CellBox, CellIndex, TILE_CELLS, TileId, TileIndex},
    live::{LiveGrid, TILE_CHUNK, TileChunk},
    live_tile::{LiveTile, ScanRun},
    mask::Mask,
    sensors::Sensors,
    spec::GridSpec,
    tempering::answers,
    tile::{ModelSlot, TileModel, TileUnavailable},
};

/// Maximum number of cells of an extent for pictures of the whole grid to have the size of the extent.
pub const EXTENT_CELLS_MAX: u128 = 1 << 24;

/// An immutable view of a grid.
#[derive(Clone, Debug)]
pub struct GridView {
    pub(crate) spec: Arc<GridSpec>,
    pub(crate) sensors: Arc<Sensors>,
    pub(crate) ids: Arc<HashMap<TileIndex, TileId>>,
    pub(crate) chunks: Vec<TileChunk>,
    pub(crate) run: ScanRun,
    pub(crate) last_seen: Arc<[TileId]>,
    pub(crate) generation: Arc<Generation>,
    pub(crate) scans: u64,
    pub(crate) pending_scans: u64,
    pub(crate) scans_ahead: u64,
    pub(crate) cell_observations: u64,
    pub(crate) shown: CellBox,
}

/// The prediction of one tile at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct TilePrediction {
    /// Where the tile is.
    pub index: TileIndex,
    /// Cells that were ever observed.
    pub known: Mask,
    /// Known cells that have changed.
    pub changed: Mask,
    /// Probability of each known cell to be occupied, by place; 0 for the other cells.
    pub probabilities: Box<[f32; 512]>,
}

/// The description of one cell.
#[derive(Clone, Debug, PartialEq)]
pub struct CellDescription {
    /// Whether it was ever read as both free and occupied, up to the last update.
    pub changed: bool,
    /// Mean and components.
    pub spectral: SpectralModel,
    /// Components in force.
    pub order: usize,
    /// Decayed error sums of the orders; `None` where the cell has not changed.
    pub errors: Option<[f64; tidemap_model::ORDER_MAX + 1]>,
    /// The day on which the cell's change alarm was raised, if the alarm is active.
    pub alarm_day: Option<LocalDay>,
    /// Last value and persistence.
    pub persistence: Persistence,
    /// Observations learned.
    pub folded: u64,
    /// Observations acknowledged, each newer than the observation before.
    pub observations: u64,
    /// First learned observation, nanoseconds UTC.
    pub first_nanos: Option<i64>,
    /// How well each hour of the day is known for a changed cell.
    pub seen: HoursSeen,
}

impl CellDescription {
    /// Order of the spectral model of this cell that a selector requests; 0 for a constant model.
    pub fn order_for(&self, selector: ModelSelector) -> usize {
        if selector.kind.has_order() { selector.order_or(self.order) } else { 0 }
    }

    /// Tempers predictions of the cell's model by how well the hours of the moments are known, unless a model was
    /// requested by name.
    pub fn temper(&self, selector: ModelSelector, moments: &[Moment], answers: &mut [f64]) {
        if selector.leaves_choice() && self.changed {
            for (answer, moment) in answers.iter_mut().zip(moments) {
                *answer = self.seen.at(moment.civil_nanos()).temper(self.spectral.mean(), *answer);
            }
        }
    }

    /// The data that the memory of the cell needs beside the cell's last value.
    pub fn memory_basis(&self) -> MemoryBasis {
        memory_basis(self.spectral.mean())
    }
}

impl GridView {
    /// The current grid, as readers see it from now on.
    pub fn new(grid: &mut LiveGrid) -> GridView {
        GridView {
            spec: Arc::clone(&grid.spec),
            sensors: Arc::clone(&grid.sensors),
            ids: Arc::clone(&grid.ids),
            chunks: grid.publish(),
            run: grid.run,
            last_seen: Arc::clone(grid.last_seen()),
            generation: Arc::clone(&grid.generation),
            scans: grid.scans,
            pending_scans: grid.pending_scans() + grid.future(),
            scans_ahead: grid.future(),
            cell_observations: grid.cell_observations,
            shown: grid.shown,
        }
    }

    /// The view without the newest readings.
    pub fn models_only(&self) -> GridView {
        GridView { chunks: Vec::new(), ..self.clone() }
    }

    /// The fixed properties of the grid.
    pub fn spec(&self) -> &GridSpec {
        &self.spec
    }

    /// Values of a free and an occupied reading of the map's own sensor.
    pub fn levels(&self) -> (f64, f64) {
        self.spec.sensor.levels()
    }

    /// Number of tiles.
    pub fn tiles(&self) -> usize {
        self.ids.len()
    }

    /// Scans acknowledged.
    pub fn scans(&self) -> u64 {
        self.scans
    }

    /// Scans that no update has learned.
    pub fn pending_scans(&self) -> u64 {
        self.pending_scans
    }

    /// Number of scans that no update has learned and that wait because their time is more than
    /// [`FUTURE_MAX_NANOS`](tidemap_model::time::FUTURE_MAX_NANOS) later than the clock.
    pub fn scans_ahead(&self) -> u64 {
        self.scans_ahead
    }

    /// Observations of single cells in the scans acknowledged.
    pub fn cell_observations(&self) -> u64 {
        self.cell_observations
    }

    /// A tile according to its newest scans.
    pub fn live(&self, tile: TileId) -> Option<&LiveTile> {
        let index = tile.0 as usize;
        self.chunks.get(index / TILE_CHUNK)?.get(index % TILE_CHUNK).map(AsRef::as_ref)
    }

    /// The tile of this index.
    pub fn find(&self, index: TileIndex) -> Option<TileId> {
        self.ids.get(&index).copied()
    }

    /// The smallest box of whole tiles that holds every tile.
    pub fn bounds(&self) -> CellBox {
        let empty = CellBox { min: CellIndex::default(), max: CellIndex::default() };
        self.ids.keys().fold(empty, |bounds, index| bounds.union(&index.cells()))
    }

    /// The cells of a picture of the whole grid: the extent, where the grid has one of at most [`EXTENT_CELLS_MAX`];
    /// else the smallest box of all known cells and of the cells that scans were stated to show. Empty if no cell is
    /// known.
    pub fn region(&self) -> CellBox {
        let empty = CellBox { min: CellIndex::default(), max: CellIndex::default() };
        let known = self.ids.iter().fold(empty, |known, (index, &id)| {
            let tile = index.cells();
            if known.intersection(&tile) == tile {
                return known;
            }
            known.union(&self.known_of(id).map_or(tile, |cells| known_box(*index, cells)))
        });
        match self.spec.extent {
            _ if known.is_empty() => empty,
            Some(extent) if extent.count() <= EXTENT_CELLS_MAX => extent,
            _ => known.union(&self.shown).intersection(&self.spec.allowed()),
        }
    }

    /// The known cells of a tile; `None` where this information is only on the disk.
    fn known_of(&self, id: TileId) -> Option<Mask> {
        let live = self.live(id).map(|live| live.known);
        match self.generation.model(id) {
            Some(ModelSlot::Cold(_)) => live,
            Some(ModelSlot::Resident(model)) => Some(live.unwrap_or(Mask::EMPTY) | model.observed()),
            None => Some(live.unwrap_or(Mask::EMPTY)),
        }
    }

    /// The tiles that reach into a box, by position: z, then y, then x ascending.
    pub fn tiles_in(&self, region: &CellBox) -> Vec<(TileIndex, TileId)> {
        let reaches = |index: &&TileIndex| !index.cells().intersection(region).is_empty();
        let mut tiles: Vec<(TileIndex, TileId)> =
            self.ids.keys().filter(reaches).filter_map(|&index| Some((index, self.find(index)?))).collect();
        tiles.sort_unstable_by_key(|(index, _)| (index.z, index.y, index.x));
        tiles
    }

    /// The model of a tile from the last update.
    ///
    /// # Errors
    /// [`TileUnavailable`] where the model cannot be read from the disk.
    pub fn model(&self, tile: TileId) -> Result<Arc<TileModel>, TileUnavailable> {
        self.generation.model(tile).map_or_else(|| Ok(Arc::default()), ModelSlot::get)
    }

    /// The probability of each cell of a tile at one time, given in nanoseconds UTC and as phasors on the map's civil
    /// time. A cell observed only since the last update predicts 0.5, as a state does, unless the latest value is
    /// requested.
    ///
    /// # Errors
    /// [`TileUnavailable`] where the tile cannot be read from the disk.
    pub fn predict_tile(
        &self,
        tile: TileId,
        utc_nanos: i64,
        phasors: &InstantPhasors,
        selector: ModelSelector,
    ) -> Result<TilePrediction, TileUnavailable> {
        let model = self.model(tile)?;
        let unseen = LiveTile::new(TileIndex::default());
        let live = self.live(tile).unwrap_or(&unseen);
        let levels = self.levels();
        let learned = model.observed();
        let known = live.known | learned;
        let mut prediction =
            TilePrediction { index: live.index, known, changed: model.changed(), probabilities: Box::new([0.0; 512]) };
        let out = &mut prediction.probabilities;
        if selector.kind == ModelKind::Latest {
            set_levels(out, known, live.occupied, levels);
            if live.has_other_readers(&self.sensors) {
                for cell in live.known.cells() {
                    out[usize::from(cell)] = live.value(cell, &self.sensors) as f32;
                }
            }
            return Ok(prediction);
        }
        self.set_constants(out, &model);
        for cell in known.without(learned).cells() {
            out[usize::from(cell)] = 0.5;
        }
        let answer = answers(&model, selector, phasors);
        for cell in &model.cells {
            let order = match selector.kind {
                ModelKind::Mean => 0,
                _ => selector.order.unwrap_or(usize::from(cell.order)),
            };
            if let Some(out) = out.get_mut(usize::from(cell.cell)) {
                *out = answer(cell, order) as f32;
            }
        }
        if selector.is_blended() {
            for cell in live.known.cells() {
                let Some(out) = out.get_mut(usize::from(cell)) else { continue };
                let last = live.value(cell, &self.sensors);
                // The probability does not change.
                if *out != last as f32 {
                    let persistence = live.persistence(cell, self.run, &self.sensors);
                    let p = f64::from(*out);
                    let mean = model.cell(cell).map_or(p, |cell| cell.spectral.mean());
                    *out = crate::blend::blend_cell(&persistence, mean, p, utc_nanos, selector.blend) as f32;
                }
            }
        }
        Ok(prediction)
    }

    /// Sets the cells of a tile's groups to the values of cells that have never changed.
    pub(crate) fn set_constants(&self, out: &mut [f32; TILE_CELLS], model: &TileModel) {
        if model.sensors.is_none() {
            set_levels(out, model.observed(), model.always_occupied, self.levels());
            return;
        }
        for (index, group) in model.groups.iter().enumerate() {
            let levels = model.constant_levels(index, &self.sensors);
            set_levels(out, group.cells, model.always_occupied, levels);
        }
    }

    /// Describes one cell; `None` if it was never observed.
    ///
    /// # Errors
    /// [`TileUnavailable`] where its tile cannot be read from the disk.
    pub fn describe(&self, cell: CellIndex) -> Result<Option<CellDescription>, TileUnavailable> {
        let (index, place) = cell.tile();
        let Some(tile) = self.find(index) else { return Ok(None) };
        let model = self.model(tile)?;
        Ok(self.describe_place(tile, &model, place))
    }

    /// Describes the cells of a tile within a region whose change alarm rings, by place.
    ///
    /// # Errors
    /// [`TileUnavailable`] where the tile cannot be read from the disk.
    pub fn cell_alarms(
        &self,
        (index, tile): (TileIndex, TileId),
        region: &CellBox,
    ) -> Result<Vec<(CellIndex, CellDescription)>, TileUnavailable> {
        let model = self.model(tile)?;
        let rings = model.cells.iter().filter(|cell| cell.alarm_day.is_some());
        let within = rings.map(|cell| (index.cell(cell.cell), cell.cell)).filter(|(cell, _)| region.contains(*cell));
        Ok(within.filter_map(|(cell, place)| Some((cell, self.describe_place(tile, &model, place)?))).collect())
    }

    fn describe_place(&self, tile: TileId, model: &TileModel, place: u16) -> Option<CellDescription> {
        let live = self.live(tile).filter(|live| live.known.contains(place))?;
        let persistence = live.persistence(place, self.run, &self.sensors);
        let observations = persistence.to_parts().pairs + u64::from(persistence.last().is_some());
        Some(CellDescription { observations, persistence, ..self.describe_learned(model, place) })
    }

    /// The description of a cell by its tile's model, without its newest readings.
    pub fn describe_learned(&self, model: &TileModel, place: u16) -> CellDescription {
        let at = model.groups.iter().position(|group| group.cells.contains(place));
        let group = at.and_then(|at| model.groups.get(at));
        let mut description = CellDescription {
            changed: false,
            spectral: SpectralModel::default(),
            order: 0,
            errors: None,
            alarm_day: None,
            folded: group.map_or(0, |group| group.observations),
            observations: 0,
            first_nanos: group.map(|group| group.first_nanos),
            persistence: Persistence::default(),
            seen: HoursSeen::default(),
        };
        if let Some(model) = model.cell(place) {
            description.changed = true;
            description.seen = group.map_or(description.seen, |group| group.seen);
            description.spectral = model.spectral.clone();
            description.order = usize::from(model.order);
            description.errors = Some(*model.errors.sums());
            description.alarm_day = model.alarm_day;
        } else if let (Some(at), Some(group)) = (at, group) {
            let levels = model.constant_levels(at, &self.sensors);
            let level = if model.always_occupied.contains(place) { levels.1 } else { levels.0 };
            description.spectral = SpectralModel::from_parts(level, group.observations, Vec::new()).unwrap_or_default();
        }
        description
    }
}

/// The smallest box of some cells of a tile.
fn known_box(index: TileIndex, known: Mask) -> CellBox {
    let layer = known.0.iter().fold(0, |all, layer| all | layer);
    // This byte combines the bits of all rows of a layer.
    let columns = layer.to_le_bytes().into_iter().fold(0, |all, row| all | row);
    let (mut rows, mut layers) = (0_u8, 0_u8);
    for bit in 0..8 {
        rows |= u8::from(layer >> (8 * bit) & 0xff != 0) << bit;
        layers |= u8::from(known.0[bit as usize] != 0) << bit;
    }
    let cells = index.cells();
    let first = |bits: u8| bits.trailing_zeros().min(8) as i32;
    let beyond = |bits: u8| 8 - bits.leading_zeros() as i32;
    let at = |x: i32, y: i32, z: i32| CellIndex { x: cells.min.x + x, y: cells.min.y + y, z: cells.min.z + z };
    CellBox {
        min: at(first(columns), first(rows), first(layers)),
        max: at(beyond(columns), beyond(rows), beyond(layers)),
    }
}

fn set_levels(out: &mut [f32; TILE_CELLS], cells: Mask, occupied: Mask, levels: (f64, f64)) {
    let (free, full) = (levels.0 as f32, levels.1 as f32);
    for ((out, cells), occupied) in out.as_chunks_mut::<64>().0.iter_mut().zip(cells.0).zip(occupied.0) {
        if cells == u64::MAX && occupied == 0 {
            out.fill(free);
            continue;
        }
        for (bit, out) in out.iter_mut().enumerate() {
            let level = if occupied >> bit & 1 == 1 { full } else { free };
            *out = if cells >> bit & 1 == 1 { level } else { *out };
        }
    }
}
