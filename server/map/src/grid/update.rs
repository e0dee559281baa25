//! The update of a grid: each day's scans are scored, orders are chosen, sums are folded in, models refitted.
//!
//! The tiles that were seen by the same scans of a day are worked off together: they share the phasors of those scans and
//! their running sums, in chunks that stay in cache. A cell then costs one row of sums per change of its value, and a
//! prediction per observation where it has a spectrum to be scored.
//!
//! Invariant: each cell's model is what `StateModel::update` of tidemap-model gives for its readings, to 1e-9.

use std::{
    collections::HashMap,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use rayon::prelude::*;
use tidemap_model::{MAX_ORDER, OrderCriterion, Periodicities};

use super::{
    day::GridDay,
    generation::Generation,
    index::TileId,
    spec::SensorNoise,
    tile::{ModelSlot, SumsSlot, TileModel, TileSums, TileUnavailable},
};

mod observed;
mod pattern;
mod tile_day;

use pattern::Pattern;
pub(super) use pattern::{Chunk, fold_toggles};

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
    /// Values of a free and an occupied reading.
    pub(crate) levels: (f64, f64),
}

impl Rules {
    pub(crate) fn new(periodicities: &Periodicities, criterion: OrderCriterion, sensor: SensorNoise) -> Rules {
        Rules { periodicities: periodicities.clone(), criterion, levels: sensor.levels() }
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
    pub squared_errors: [f64; MAX_ORDER + 1],
    /// Sum of squared errors, each predicted with the order in force for its cell on its day.
    pub squared_error_in_force: f64,
    /// The same with the order that was chosen for its cell on that day.
    pub squared_error_chosen: f64,
    /// How many cells of these tiles had each order before; those without a spectrum are not counted.
    pub cells_by_order_before: [u64; MAX_ORDER + 1],
    /// How many cells have each order now.
    pub cells_by_order: [u64; MAX_ORDER + 1],
}

impl GridOutcome {
    pub(crate) fn add(&mut self, other: &GridOutcome) {
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

    /// Runs the update on the threads of the rayon pool that this is called in. `progress` counts tiles done on the last
    /// of their days.
    ///
    /// # Errors
    /// [`TileUnavailable`] where a tile cannot be read back from the disk; nothing has been learned then.
    pub(crate) fn run(mut self, progress: &AtomicU64) -> Result<GridResult, TileUnavailable> {
        let mut sums = std::mem::take(&mut self.sums);
        sums.resize_with(self.tiles, SumsSlot::default);
        let mut models = self.generation.models.clone();
        models.resize_with(self.tiles, ModelSlot::default);
        let mut working: HashMap<TileId, Working> = HashMap::new();
        let mut outcome = GridOutcome::default();
        let last_day = self.days.len().saturating_sub(1);
        for (number, day) in self.days.iter().enumerate() {
            outcome.scans += day.scans.len() as u64;
            let (patterns, before) = self.patterns(day, &models, &mut sums, &mut working)?;
            for (total, cells) in outcome.cells_by_order_before.iter_mut().zip(before) {
                *total += cells;
            }
            let done: Vec<(Vec<(TileId, Working)>, GridOutcome)> =
                patterns.into_par_iter().map(|pattern| pattern.run(&self.rules, day)).collect();
            for (tiles, of_pattern) in done {
                outcome.add(&of_pattern);
                if number == last_day {
                    progress.fetch_add(tiles.len() as u64, Ordering::Relaxed);
                }
                working.extend(tiles);
            }
        }
        outcome.tiles = working.len() as u64;
        for (tile, mut state) in working {
            state.shrink();
            let Working { model, sums: of_tile } = state;
            count_orders(&model, &mut outcome.cells_by_order);
            outcome.changed_cells += model.cells.len() as u64;
            models[tile.0 as usize] = ModelSlot::Resident(Arc::new(model));
            sums[tile.0 as usize] = SumsSlot::Resident(Arc::new(of_tile));
        }
        Ok(GridResult { generation: Generation { models }, sums, outcome, days: self.days })
    }

    /// The tiles of a day, those together that were seen by the same scans, and how many cells of those that no day of the
    /// update had before have each order.
    fn patterns(
        &self,
        day: &GridDay,
        models: &[ModelSlot],
        sums: &mut [SumsSlot],
        working: &mut HashMap<TileId, Working>,
    ) -> Result<(Vec<Pattern>, CellsByOrder), TileUnavailable> {
        let mut by_ranges: HashMap<Vec<(u32, u32)>, usize> = HashMap::new();
        let mut patterns: Vec<Pattern> = Vec::new();
        let mut cells_by_order = CellsByOrder::default();
        for ((tile, _), ranges) in day.tiles().zip(day.presence_by_tile()) {
            if ranges.is_empty() {
                continue;
            }
            let index = tile.0 as usize;
            let state = match working.remove(&tile) {
                Some(state) => state,
                None => {
                    let model = models.get(index).map_or_else(|| Ok(Arc::default()), ModelSlot::get)?;
                    count_orders(&model, &mut cells_by_order);
                    let sums = sums.get_mut(index).map_or_else(|| Ok(TileSums::default()), SumsSlot::take)?;
                    Working { model: Arc::unwrap_or_clone(model), sums }
                }
            };
            let pattern = match by_ranges.get(&ranges) {
                Some(&pattern) => pattern,
                None => {
                    by_ranges.insert(ranges.clone(), patterns.len());
                    patterns.push(Pattern::new(ranges));
                    patterns.len() - 1
                }
            };
            patterns[pattern].tiles.push((tile, state));
        }
        Ok((patterns, cells_by_order))
    }
}

/// How many cells have each order.
type CellsByOrder = [u64; MAX_ORDER + 1];

fn count_orders(model: &TileModel, cells_by_order: &mut CellsByOrder) {
    for cell in &model.cells {
        cells_by_order[usize::from(cell.order).min(MAX_ORDER)] += 1;
    }
}
