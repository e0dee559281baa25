//! The update of a grid: it scores each day's scans, chooses orders, continues the sums and trains the models again.
//!
//! Tiles that were seen by the same scans of a day are processed together: they share the phasors of those scans and
//! their running sums, in chunks that stay in cache. A cell then costs one row of sums per change of its value and, if
//! it has a spectrum to be scored, one prediction per scan block: consecutive scans so close in time that no candidate
//! period can distinguish them (`update/looks.rs`).
//!
//! Invariant: each cell's model is equal to the result of `StateModel::update` of tidemap-model for the cell's
//! readings, or bins, to 1e-9, and the errors of its orders to 1e-3.

use std::{
    collections::{HashMap, hash_map::Entry},
    sync::Arc,
};

use rayon::prelude::*;
use tidemap_model::ORDER_MAX;

use crate::{
    bins::bins_of,
    day::GridDay,
    fold::CHUNK_SCANS_MAX,
    generation::Generation,
    index::TileId,
    outcome::{CellsByOrder, GridOutcome, TileOutcome},
    pace::Pace,
    spec::Evidence,
    standing::Standing,
    tile::{ModelSlot, SumsSlot, TileData, TileModel, TileSums, TileUnavailable},
};

mod batch;
mod looks;
mod observed;
mod pattern;
pub mod rules;
mod shared_sums;
mod succession;
mod tile_day;

use batch::{Batch, ProgressMeter};
use pattern::Pattern;
use rules::{Rules, UpdateLimits};
use tile_day::BusyTile;

/// The update of a grid, ready to run.
#[derive(Debug)]
pub struct GridWork {
    pub(crate) rules: Rules,
    pub(crate) generation: Arc<Generation>,
    pub(crate) sums: Vec<SumsSlot>,
    pub(crate) days: Vec<GridDay>,
    pub(crate) tiles: usize,
}

/// The result of an update of a grid.
#[derive(Debug)]
pub struct GridResult {
    /// The models of all tiles.
    pub generation: Generation,
    /// The sums of all tiles.
    pub sums: Vec<SumsSlot>,
    /// The numbers of the update: observations, errors, orders.
    pub outcome: GridOutcome,
    /// The scans that were learned, by local day, ascending.
    pub days: Vec<GridDay>,
}

impl GridWork {
    /// Does the work in pieces of other sizes. The results do not depend on the sizes, except for rounding.
    #[must_use]
    pub fn with_limits(mut self, limits: UpdateLimits) -> GridWork {
        let chunk_scans = limits.chunk_scans.clamp(1, CHUNK_SCANS_MAX);
        self.rules.limits = UpdateLimits { chunk_scans, ..limits };
        self
    }

    /// The scans to learn, by local day, ascending.
    pub fn days(&self) -> &[GridDay] {
        &self.days
    }

    /// Number of tiles with scans to learn.
    pub fn busy_tiles(&self) -> u64 {
        let mut is_busy = vec![false; self.tiles];
        for (tile, _) in self.days.iter().flat_map(GridDay::tiles) {
            if let Some(is_busy) = is_busy.get_mut(tile.0 as usize) {
                *is_busy = true;
            }
        }
        is_busy.into_iter().filter(|is_busy| *is_busy).count() as u64
    }

    /// Number of scans to learn.
    pub fn scans(&self) -> u64 {
        self.days.iter().map(|day| day.scans.len() as u64).sum()
    }

    /// Runs the update on the threads of the current rayon pool. `pace` counts tiles; each tile is done in equal parts
    /// on each of its days.
    ///
    /// # Errors
    /// [`TileUnavailable`] where a tile cannot be read back from the disk; nothing has been learned then.
    pub fn run(mut self, pace: &dyn Pace) -> Result<GridResult, TileUnavailable> {
        let mut sums = std::mem::take(&mut self.sums);
        sums.resize_with(self.tiles, SumsSlot::default);
        let mut models = self.generation.models.clone();
        models.resize_with(self.tiles, ModelSlot::default);
        let mut outcome = GridOutcome::default();
        let mut tiles = Tiles { rules: &self.rules, models: &models, sums: &mut sums, busy: HashMap::new() };
        let meter = ProgressMeter::new(pace, self.busy_tiles(), &self.days);
        for day in &self.days {
            outcome.scans += day.scans.len() as u64;
            meter.add(tiles.take(day, &mut outcome.cells_by_order_before)?);
            let binned = (self.rules.evidence == Evidence::Bins).then(|| tiles.bins(day));
            let day = binned.as_ref().unwrap_or(day);
            let batches = tiles.batches(day);
            let done: Vec<_> = batches.into_par_iter().map(|batch| batch.run(&self.rules, day, &meter)).collect();
            tiles.busy.extend(done.into_iter().flatten().map(|tile| (tile.id, tile)));
        }
        let mut busy: Vec<BusyTile> = tiles.busy.into_values().collect();
        // Sums of errors are added in an order that does not depend on the batches.
        busy.sort_unstable_by_key(|tile| tile.id);
        outcome.tiles = busy.len() as u64;
        for BusyTile { id, mut data, outcome: of_tile } in busy {
            data.shrink();
            outcome.cells.add(&of_tile);
            count_orders(&data.model, &mut outcome.cells_by_order);
            outcome.changed_cells += data.model.cells.len() as u64;
            models[id.0 as usize] = ModelSlot::Resident(Arc::new(data.model));
            sums[id.0 as usize] = SumsSlot::Resident(Arc::new(data.sums));
        }
        Ok(GridResult { generation: Generation { models }, sums, outcome, days: self.days })
    }
}

/// All tiles while the update runs.
struct Tiles<'a> {
    rules: &'a Rules,
    /// The models before the update.
    models: &'a [ModelSlot],
    /// The sums before the update, which takes them out.
    sums: &'a mut [SumsSlot],
    /// The tiles that the update has changed.
    busy: HashMap<TileId, BusyTile>,
}

impl Tiles<'_> {
    /// Takes the tiles of a day to change them. Returns the number of tiles without work. Adds to `orders` the orders
    /// of cells of tiles that no earlier day of the update contained.
    fn take(&mut self, day: &GridDay, orders: &mut CellsByOrder) -> Result<usize, TileUnavailable> {
        let mut skipped = 0;
        for ((id, _), ranges) in day.tiles().zip(day.presence_by_tile()) {
            if ranges.is_empty() {
                skipped += 1;
                continue;
            }
            let Entry::Vacant(place) = self.busy.entry(id) else { continue };
            let index = id.0 as usize;
            let model = self.models.get(index).map_or_else(|| Ok(Arc::default()), ModelSlot::get)?;
            count_orders(&model, orders);
            let sums = self.sums.get_mut(index).map_or_else(|| Ok(TileSums::default()), SumsSlot::take)?;
            let data = TileData { model: Arc::unwrap_or_clone(model), sums };
            place.insert(BusyTile { id, data, outcome: TileOutcome::default() });
        }
        Ok(skipped)
    }

    /// The bins of a day whose tiles are taken.
    fn bins(&mut self, day: &GridDay) -> GridDay {
        let busy = &mut self.busy;
        let mut take = |(id, _)| busy.get_mut(&id).map(|tile| std::mem::take(&mut tile.data.sums.standing));
        let mut standing: Vec<Standing> = day.tiles().map(|tile| take(tile).unwrap_or_default()).collect();
        let binned = bins_of(day, &self.rules.sensors, &mut standing);
        for ((id, _), standing) in day.tiles().zip(standing) {
            if let Some(tile) = self.busy.get_mut(&id) {
                tile.data.sums.standing = standing;
            }
        }
        binned
    }

    /// Groups the tiles of a day that were seen by the same scans; the tiles are taken.
    fn batches(&mut self, day: &GridDay) -> Vec<Batch> {
        let mut by_ranges: HashMap<Vec<(u32, u32)>, usize> = HashMap::new();
        let mut batches: Vec<Batch> = Vec::new();
        let mut full = Vec::new();
        for ((id, _), ranges) in day.tiles().zip(day.presence_by_tile()) {
            if ranges.is_empty() {
                continue;
            }
            let Some(busy) = self.busy.remove(&id) else { continue };
            let at = match by_ranges.get(&ranges) {
                Some(&at) => at,
                None => {
                    batches.push(Batch::new(Arc::new(Pattern::new(ranges.clone())), self.rules));
                    by_ranges.insert(ranges, batches.len() - 1);
                    batches.len() - 1
                }
            };
            if batches[at].is_full() {
                let next = batches[at].next();
                full.push(std::mem::replace(&mut batches[at], next));
            }
            batches[at].push(busy);
        }
        full.append(&mut batches);
        full
    }
}

fn count_orders(model: &TileModel, cells_by_order: &mut CellsByOrder) {
    for cell in &model.cells {
        cells_by_order[usize::from(cell.order).min(ORDER_MAX)] += 1;
    }
}

#[cfg(test)]
mod tests;
