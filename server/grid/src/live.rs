//! The grid of a map as its single writer holds it. Logged scans are applied here.
//!
//! Invariant: the state is a function of the scans applied and their order. The cost of a scan depends on the cells
//! that it changes, and on the tiles where the observed cells change.

use std::{collections::HashMap, sync::Arc};

use tidemap_model::{LocalDay, OrderCriterion, Periodicities};

use crate::{
    day::GridDay,
    fade::HalfLife,
    generation::Generation,
    index::{CellBox, TileId, TileIndex},
    live_tile::{LiveTile, ScanRun},
    mask::TileMasks,
    scan::ScanSource,
    sensors::{InvalidSensor, ProducerSensor, SensorId, Sensors},
    snapshot::{FutureScan, GridSnapshot},
    spec::GridSpec,
    tile::SumsSlot,
    update::{GridWork, rules::Rules},
};

mod due;
mod scans;

pub use scans::InvalidScans;

#[cfg(test)]
mod tests;

/// Number of tiles in one piece. Tiles are copied on publication piece by piece.
pub(crate) const TILE_CHUNK: usize = 64;

/// A chunk of tiles, shared with readers.
pub(crate) type TileChunk = Arc<Vec<Arc<LiveTile>>>;

/// The previous scan, so that unchanged tiles need not be visited again.
#[derive(Clone, Debug)]
struct Previous {
    day: LocalDay,
    seen: Arc<[TileId]>,
    /// Number of cells that the scan observed.
    observed: u64,
}

/// The grid at an update's log position, except the data that the update learns.
#[derive(Debug)]
pub struct GridBasis {
    tiles: Vec<Arc<LiveTile>>,
    last_seen: Arc<[TileId]>,
    days: Vec<GridDay>,
    future: Vec<FutureScan>,
    scans: u64,
    cell_observations: u64,
    shown: CellBox,
    /// The time at which the first of the scans that stay pending was received, or an earlier time; nanoseconds UTC.
    /// `None` until the map sets it.
    pub received_nanos: Option<i64>,
}

/// The grid as its writer holds it.
#[derive(Debug)]
pub struct LiveGrid {
    pub(crate) spec: Arc<GridSpec>,
    pub(crate) sensors: Arc<Sensors>,
    pub(crate) tiles: Vec<Arc<LiveTile>>,
    pub(crate) ids: Arc<HashMap<TileIndex, TileId>>,
    /// The tiles of the last scan in the log.
    pub(crate) last_seen: Arc<[TileId]>,
    previous: Option<Previous>,
    pub(crate) run: ScanRun,
    run_seen: Option<Arc<[TileId]>>,
    /// The sensor and the source of all scans of the run.
    run_origin: (SensorId, ScanSource),
    /// The tiles of the last scan whose newest values more scans like it would change; ascending.
    unsettled: Vec<TileId>,
    /// Scans that no update has learned, by local day.
    pub(crate) days: Vec<GridDay>,
    pub(crate) future: Vec<FutureScan>,
    /// Sum of the numbers of tiles of the scans in `future`.
    future_tiles: u64,
    pub(crate) pending_changes: u64,
    pub(crate) oldest_pending_nanos: Option<i64>,
    pub(crate) generation: Arc<Generation>,
    /// The sums of each tile; the running update has them.
    pub(crate) sums: Vec<SumsSlot>,
    published: Vec<TileChunk>,
    dirty: Vec<bool>,
    pub(crate) scans: u64,
    pub(crate) cell_observations: u64,
    /// The smallest box of all cells that scans were stated to show.
    pub(crate) shown: CellBox,
}

impl LiveGrid {
    /// An empty grid.
    pub fn new(spec: Arc<GridSpec>) -> LiveGrid {
        LiveGrid {
            sensors: Arc::new(Sensors::new(spec.sensor)),
            spec,
            tiles: Vec::new(),
            ids: Arc::default(),
            last_seen: Arc::from([]),
            previous: None,
            run: ScanRun::default(),
            run_seen: None,
            run_origin: (SensorId::OWN, ScanSource::Cells),
            unsettled: Vec::new(),
            days: Vec::new(),
            future: Vec::new(),
            future_tiles: 0,
            pending_changes: 0,
            oldest_pending_nanos: None,
            generation: Arc::default(),
            sums: Vec::new(),
            published: Vec::new(),
            dirty: Vec::new(),
            scans: 0,
            cell_observations: 0,
            shown: CellBox::default(),
        }
    }

    /// Restores a snapshot into an empty grid that has the sensors of the grid's producers.
    pub fn restore(self, snapshot: GridSnapshot) -> LiveGrid {
        let mut grid = self;
        for tile in snapshot.tiles {
            grid.add_tile(tile);
        }
        grid.generation = Arc::new(Generation { models: snapshot.models });
        grid.sums = snapshot.sums;
        grid.last_seen = snapshot.last_seen;
        grid.days = snapshot.days;
        grid.future = snapshot.future;
        grid.scans = snapshot.scans;
        grid.cell_observations = snapshot.cell_observations;
        grid.shown = snapshot.shown;
        grid.count_pending();
        grid
    }

    /// Takes the scans before an instant for an update. Also returns the grid without the data that the update will
    /// learn, and the latest time of the scans that had waited until their time came.
    pub fn start_update(
        &mut self,
        cut_nanos: i64,
        periodicities: &Periodicities,
        criterion: OrderCriterion,
    ) -> (GridWork, GridBasis, Option<i64>) {
        // The snapshot must not depend on the run.
        self.end_run();
        let (days, newest_future) = self.take_before(cut_nanos);
        let half_life = self.spec.half_life_nanos.map(HalfLife::of_nanos);
        let work = GridWork {
            rules: Rules::new(periodicities, criterion, self.spec.evidence, &self.sensors, half_life),
            generation: Arc::clone(&self.generation),
            sums: std::mem::take(&mut self.sums),
            days,
            tiles: self.tiles.len(),
        };
        let basis = GridBasis {
            tiles: self.tiles.clone(),
            last_seen: Arc::clone(&self.last_seen),
            days: self.days.clone(),
            future: self.future.clone(),
            scans: self.scans,
            cell_observations: self.cell_observations,
            shown: self.shown,
            received_nanos: None,
        };
        (work, basis, newest_future)
    }

    /// Publishes the result of an update.
    pub fn finish_update(&mut self, basis: GridBasis, generation: Generation, sums: Vec<SumsSlot>) -> GridSnapshot {
        self.generation = Arc::new(generation);
        self.sums = sums;
        let GridBasis { tiles, last_seen, days, future, scans, cell_observations, shown, received_nanos } = basis;
        GridSnapshot {
            tiles,
            models: self.generation.models.clone(),
            sums: self.sums.clone(),
            last_seen,
            days,
            future,
            scans,
            cell_observations,
            shown,
            received_nanos,
        }
    }

    /// Checks that a new producer may have the sensor it announces, and returns the sensor it gets: `None` for the
    /// map's own. `others`: sensors that other producers will have, and that may be new too.
    ///
    /// # Errors
    /// [`InvalidSensor`] where the producer may not have it.
    pub fn may_have(
        &self,
        announced: ProducerSensor,
        others: impl Iterator<Item = ProducerSensor>,
    ) -> Result<Option<ProducerSensor>, InvalidSensor> {
        let sensor = self.sensors.check(announced)?;
        if self.sensors.find(sensor).is_none() {
            let mut sensors = Sensors::clone(&self.sensors);
            for other in others {
                // If there is no room for this other sensor, there is none for the announced sensor either.
                let _ = sensors.add(Some(other));
            }
            sensors.add(sensor)?;
        }
        Ok(sensor)
    }

    /// The sensors of the grid's producers.
    pub fn sensors(&self) -> &Sensors {
        &self.sensors
    }

    /// Numbers the sensor of a new producer, which [`LiveGrid::may_have`] has accepted.
    pub fn add_sensor(&mut self, sensor: Option<ProducerSensor>) {
        if self.sensors.find(sensor).is_none() {
            // An invalid sensor counts as the map's own; no log contains one.
            let _ = Arc::make_mut(&mut self.sensors).add(sensor);
        }
    }

    fn add_tile(&mut self, tile: Arc<LiveTile>) {
        let id = TileId(u32::try_from(self.tiles.len()).unwrap_or(u32::MAX));
        Arc::make_mut(&mut self.ids).insert(tile.index, id);
        self.tiles.push(tile);
        self.touch(id);
    }

    fn touch(&mut self, tile: TileId) {
        Self::note_touch(&mut self.dirty, tile);
    }

    fn note_touch(dirty: &mut Vec<bool>, tile: TileId) {
        let chunk = tile.0 as usize / TILE_CHUNK;
        if chunk >= dirty.len() {
            dirty.resize(chunk + 1, true);
        }
        dirty[chunk] = true;
    }

    /// Number of tiles.
    pub fn tiles(&self) -> usize {
        self.tiles.len()
    }

    /// The tile of this index.
    pub fn find(&self, index: TileIndex) -> Option<TileId> {
        self.ids.get(&index).copied()
    }

    /// The masks of the last scan of a tile in log order.
    pub fn arrival(&self, tile: TileId) -> Option<TileMasks> {
        Some(self.tiles.get(tile.0 as usize)?.arrival)
    }

    /// The tiles of the last scan in the log.
    pub fn last_seen(&self) -> &Arc<[TileId]> {
        &self.last_seen
    }

    /// Number of scans that wait because their time is too far in the future.
    pub fn future(&self) -> u64 {
        self.future.len() as u64
    }

    /// Sum of the numbers of tiles of the scans that wait.
    pub fn future_tiles(&self) -> u64 {
        self.future_tiles
    }

    /// The latest time before `limit_nanos` of the scans that wait.
    pub fn newest_future_before(&self, limit_nanos: i64) -> Option<i64> {
        self.future.iter().map(|scan| scan.time.utc_nanos).filter(|&nanos| nanos < limit_nanos).max()
    }

    /// Number of scans that no update has learned, without the scans that wait because of their time.
    pub fn pending_scans(&self) -> u64 {
        self.days.iter().map(|day| day.scans.len() as u64).sum()
    }

    /// The scans that no update has learned, by local day, ascending.
    pub fn days(&self) -> &[GridDay] {
        &self.days
    }

    /// Changes of cells in the scans that no update has learned.
    pub fn pending_changes(&self) -> u64 {
        self.pending_changes
    }

    /// Earliest time of the scans that no update has learned, nanoseconds UTC.
    pub fn oldest_pending_nanos(&self) -> Option<i64> {
        self.oldest_pending_nanos
    }

    /// The scans that wait because their time is too far in the future, in order of arrival.
    pub fn future_scans(&self) -> &[FutureScan] {
        &self.future
    }

    /// Publishes the tiles: readers see these from now on.
    pub(crate) fn publish(&mut self) -> Vec<TileChunk> {
        for (index, dirty) in self.dirty.iter_mut().enumerate() {
            if !std::mem::take(dirty) {
                continue;
            }
            let from = index * TILE_CHUNK;
            let chunk = Arc::new(self.tiles[from..self.tiles.len().min(from + TILE_CHUNK)].to_vec());
            match self.published.get_mut(index) {
                Some(published) => *published = chunk,
                None => self.published.push(chunk),
            }
        }
        self.published.clone()
    }
}
