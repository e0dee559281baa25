//! The update of a grid: each day's scans are scored, orders are chosen, sums are folded in, models refitted.
//!
//! The tiles that were seen by the same scans of a day are worked off together: they share the phasors of those scans and
//! their running sums, in chunks that stay in cache. A cell then costs one row of sums per change of its value, and a
//! prediction per observation where it has a spectrum to be scored. What was done can be noted meanwhile ([`progress`]), so
//! that an update that was cut off goes on from there.
//!
//! [`progress`]: super::progress
//!
//! Invariant: each cell's model is what `StateModel::update` of tidemap-model gives for its readings, to 1e-9.

use std::{
    collections::HashMap,
    sync::{Arc, atomic::AtomicU64},
};

use rayon::prelude::*;
use tidemap_model::{LocalDay, ORDER_MAX, OrderCriterion, Periodicities};

use super::{
    day::GridDay,
    generation::Generation,
    index::TileId,
    progress::{Account, BusyTile, DoneTile, Notes, Share, TileOutcome, share_alike},
    sensors::{SensorId, Sensors},
    tile::{ModelSlot, SumsSlot, TileModel, TileSums, TileUnavailable},
};

mod batch;
mod observed;
mod pattern;
mod tile_day;
mod weighted;

use batch::Batch;
use pattern::Pattern;
pub(super) use pattern::{Chunk, Cursor, fold_toggles};
pub(super) use weighted::{WeightedRows, WeightedScans};

/// Scans of one map day whose phasors are in memory at a time. Tests come across the ends of chunks often.
pub(crate) const CHUNK: usize = if cfg!(test) { 3 } else { 256 };

/// Observation groups of a tile up to which each has its sum; with more, cells that never changed have sightings. Tests
/// come across it often.
pub(crate) const SUMMED_GROUPS_MAX: usize = if cfg!(test) { 2 } else { 16 };

/// What all cells share.
#[derive(Clone, Debug)]
pub(crate) struct Rules {
    pub(crate) periodicities: Periodicities,
    pub(crate) criterion: OrderCriterion,
    pub(crate) sensors: Arc<Sensors>,
    /// Values of a free and an occupied reading of the map's own sensor.
    pub(crate) levels: (f64, f64),
}

impl Rules {
    pub(crate) fn new(periodicities: &Periodicities, criterion: OrderCriterion, sensors: &Arc<Sensors>) -> Rules {
        let (sensors, levels) = (Arc::clone(sensors), sensors.levels(SensorId::OWN));
        Rules { periodicities: periodicities.clone(), criterion, sensors, levels }
    }
}

/// The update of a grid, ready to run.
#[derive(Debug)]
pub(crate) struct GridWork {
    pub(crate) rules: Rules,
    pub(crate) generation: Arc<Generation>,
    pub(crate) sums: Vec<SumsSlot>,
    pub(crate) days: Vec<GridDay>,
    pub(crate) tiles: usize,
}

/// What an update did to the cells of a grid, all together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GridOutcome {
    /// Tiles that had scans.
    pub tiles: u64,
    /// Scans folded in.
    pub scans: u64,
    /// Observations of single cells folded in.
    pub observations: u64,
    /// Cells with a spectrum, in all tiles that had scans.
    pub changed_cells: u64,
    /// Observations of cells with a spectrum that were predicted first and scored.
    pub scored: u64,
    /// Sum of squared errors over them, per order 0..=15.
    pub squared_errors: [f64; ORDER_MAX + 1],
    /// Sum of squared errors, each predicted with the order in force for its cell on its day.
    pub squared_error_in_force: f64,
    /// The same with the order that was chosen for its cell on that day.
    pub squared_error_chosen: f64,
    /// How many cells of these tiles had each order before; those without a spectrum are not counted.
    pub cells_by_order_before: [u64; ORDER_MAX + 1],
    /// How many cells have each order now.
    pub cells_by_order: [u64; ORDER_MAX + 1],
}

impl GridOutcome {
    fn add(&mut self, other: &TileOutcome) {
        self.observations += other.observations;
        self.scored += other.scored;
        self.squared_error_in_force += other.squared_error_in_force;
        self.squared_error_chosen += other.squared_error_chosen;
        for (sum, error) in self.squared_errors.iter_mut().zip(&other.squared_errors) {
            *sum += error;
        }
    }
}

/// What an update of a grid learned.
#[derive(Debug)]
pub(crate) struct GridResult {
    pub(crate) generation: Generation,
    pub(crate) sums: Vec<SumsSlot>,
    pub(crate) outcome: GridOutcome,
    pub(crate) days: Vec<GridDay>,
}

/// A tile's model and sums while they are changed.
#[derive(Debug, Default)]
pub(crate) struct Working {
    pub(crate) model: TileModel,
    pub(crate) sums: TileSums,
}

impl Working {
    /// Gives back memory that is held for more groups and cells.
    fn shrink(&mut self) {
        self.model.groups.shrink_to_fit();
        self.model.cells.shrink_to_fit();
        self.sums.groups.shrink_to_fit();
        self.sums.cells.shrink_to_fit();
        if let Some(weights) = &mut self.model.sensors {
            weights.groups.shrink_to_fit();
            weights.occupied.shrink_to_fit();
        }
        if let Some(sums) = &mut self.sums.sensors {
            sums.groups.shrink_to_fit();
        }
    }
}

impl GridWork {
    /// Number of tiles that have scans to fold in.
    pub(crate) fn busy_tiles(&self) -> u64 {
        let mut is_busy = vec![false; self.tiles];
        for (tile, _) in self.days.iter().flat_map(GridDay::tiles) {
            if let Some(is_busy) = is_busy.get_mut(tile.0 as usize) {
                *is_busy = true;
            }
        }
        is_busy.into_iter().filter(|is_busy| *is_busy).count() as u64
    }

    /// Number of scans to fold in.
    pub(crate) fn scans(&self) -> u64 {
        self.days.iter().map(|day| day.scans.len() as u64).sum()
    }

    /// Runs the update on the threads of the rayon pool that this is called in. `progress` counts tiles, of which each is
    /// done in equal parts on each of its days.
    ///
    /// # Errors
    /// [`TileUnavailable`] where a tile cannot be read back from the disk; nothing has been learned then.
    pub(crate) fn run(mut self, progress: &AtomicU64, notes: &Notes<'_>) -> Result<GridResult, TileUnavailable> {
        let mut sums = std::mem::take(&mut self.sums);
        sums.resize_with(self.tiles, SumsSlot::default);
        let mut models = self.generation.models.clone();
        models.resize_with(self.tiles, ModelSlot::default);
        let mut outcome = GridOutcome::default();
        let mut tiles = Tiles { models: &models, sums: &mut sums, busy: HashMap::new(), done: HashMap::new() };
        tiles.resume(notes, &mut outcome.cells_by_order_before)?;
        let share = Share::new(progress, self.busy_tiles(), &self.days);
        for day in &self.days {
            outcome.scans += day.scans.len() as u64;
            let (batches, skipped) = tiles.batches(day, &mut outcome.cells_by_order_before)?;
            share.add(skipped);
            let done: Vec<_> =
                batches.into_par_iter().map(|batch| batch.run(&self.rules, day, notes, &share)).collect();
            tiles.busy.extend(done.into_iter().flatten());
        }
        let Tiles { busy, done: resumed, .. } = tiles;
        let mut busy: Vec<(TileId, BusyTile)> = busy.into_iter().collect();
        // Sums of errors are added in an order that does not depend on what was resumed.
        busy.sort_unstable_by_key(|(tile, _)| *tile);
        if !resumed.is_empty() {
            let unchanged = sums.iter().filter_map(|slot| match slot {
                SumsSlot::Resident(sums) => Some(&**sums),
                SumsSlot::Cold(_) => None,
            });
            share_alike(unchanged, busy.iter_mut().map(|(_, tile)| &mut tile.working.sums));
        }
        outcome.tiles = busy.len() as u64;
        for (tile, BusyTile { mut working, account }) in busy {
            working.shrink();
            outcome.add(&account.outcome);
            let Working { model, sums: of_tile } = working;
            count_orders(&model, &mut outcome.cells_by_order);
            outcome.changed_cells += model.cells.len() as u64;
            models[tile.0 as usize] = ModelSlot::Resident(Arc::new(model));
            sums[tile.0 as usize] = SumsSlot::Resident(Arc::new(of_tile));
        }
        Ok(GridResult { generation: Generation { models }, sums, outcome, days: self.days })
    }
}

/// All tiles while the update runs.
struct Tiles<'a> {
    /// As they were before.
    models: &'a [ModelSlot],
    /// As they were before; taken out by the update.
    sums: &'a mut [SumsSlot],
    /// Those that the update has changed.
    busy: HashMap<TileId, BusyTile>,
    /// Last day that an earlier run has folded in.
    done: HashMap<TileId, LocalDay>,
}

impl Tiles<'_> {
    /// Takes over what an earlier run has noted. How many cells of its tiles had each order is added up.
    fn resume(&mut self, notes: &Notes<'_>, orders: &mut CellsByOrder) -> Result<(), TileUnavailable> {
        for DoneTile { tile, through, model, sums, outcome } in notes.resume() {
            let index = tile.0 as usize;
            let (Some(before), Some(slot)) = (self.models.get(index), self.sums.get_mut(index)) else { continue };
            count_orders(&*before.get()?, orders);
            *slot = SumsSlot::default();
            let busy = BusyTile { working: Working { model, sums }, account: Account::of_earlier_run(outcome) };
            self.busy.insert(tile, busy);
            self.done.insert(tile, through);
        }
        Ok(())
    }

    /// Puts the tiles of a day together that were seen by the same scans. Gives also how many have nothing to be done. How
    /// many cells of those that no day of the update had before have each order is added up.
    fn batches(&mut self, day: &GridDay, orders: &mut CellsByOrder) -> Result<(Vec<Batch>, usize), TileUnavailable> {
        let mut by_ranges: HashMap<Vec<(u32, u32)>, usize> = HashMap::new();
        let mut batches: Vec<Batch> = Vec::new();
        let (mut full, mut skipped) = (Vec::new(), 0);
        for ((tile, _), ranges) in day.tiles().zip(day.presence_by_tile()) {
            if ranges.is_empty() || self.done.get(&tile).is_some_and(|through| day.day <= *through) {
                skipped += 1;
                continue;
            }
            let index = tile.0 as usize;
            let busy = match self.busy.remove(&tile) {
                Some(busy) => busy,
                None => {
                    let model = self.models.get(index).map_or_else(|| Ok(Arc::default()), ModelSlot::get)?;
                    count_orders(&model, orders);
                    let sums = self.sums.get_mut(index).map_or_else(|| Ok(TileSums::default()), SumsSlot::take)?;
                    let working = Working { model: Arc::unwrap_or_clone(model), sums };
                    BusyTile { working, account: Account::default() }
                }
            };
            let at = match by_ranges.get(&ranges) {
                Some(&at) => at,
                None => {
                    batches.push(Batch::new(Arc::new(Pattern::new(ranges.clone()))));
                    by_ranges.insert(ranges, batches.len() - 1);
                    batches.len() - 1
                }
            };
            if batches[at].is_full() {
                let next = batches[at].next();
                full.push(std::mem::replace(&mut batches[at], next));
            }
            batches[at].push(tile, busy);
        }
        full.append(&mut batches);
        Ok((full, skipped))
    }
}

/// How many cells have each order.
type CellsByOrder = [u64; ORDER_MAX + 1];

fn count_orders(model: &TileModel, cells_by_order: &mut CellsByOrder) {
    for cell in &model.cells {
        cells_by_order[usize::from(cell.order).min(ORDER_MAX)] += 1;
    }
}
