//! A region of a grid at many times.
//!
//! Invariant: a cell is stored as changing only if its probability differs between two of the times.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use rayon::prelude::*;
use tidemap_grid::{
    index::{CellIndex, TILE_CELLS, TileId, TileIndex},
    view::GridView,
};
use tidemap_map::view::MapView;
use tidemap_model::{InstantPhasors, StopSignal, selector::ModelKind};

use super::{Lattice, PredictError, PredictOptions};

/// A region of a grid at one time.
#[derive(Clone, Debug)]
pub struct PredictedGrid {
    lattice: Arc<Lattice>,
    /// The probabilities by place in the lattice; NaN where unknown, and on the border.
    probabilities: Vec<f32>,
}

impl PredictedGrid {
    /// Predicts a map's grid at a time in nanoseconds UTC. Takes 4 bytes a cell.
    ///
    /// # Errors
    /// [`PredictError`], before the work begins if the region is too large; [`PredictError::Stop`].
    pub fn new(
        view: &MapView,
        utc_nanos: i64,
        options: &PredictOptions,
        stop: StopSignal<'_>,
    ) -> Result<PredictedGrid, PredictError> {
        Ok(PredictedTimes::new(view, &[utc_nanos], options, stop)?.into_first())
    }

    /// A grid from other predictions: `probability` gives each cell's probability of being occupied, clipped to [0, 1];
    /// `None` and NaN: unknown.
    pub fn from_fn(lattice: Arc<Lattice>, mut probability: impl FnMut(CellIndex) -> Option<f32>) -> PredictedGrid {
        let mut probabilities = vec![f32::NAN; lattice.held()];
        for place in lattice.rows().flatten() {
            let value = lattice.cell(place).and_then(&mut probability);
            probabilities[place] = value.map_or(f32::NAN, |value| value.clamp(0.0, 1.0));
        }
        PredictedGrid { lattice, probabilities }
    }

    /// The lattice of the cells.
    #[must_use]
    pub fn lattice(&self) -> &Arc<Lattice> {
        &self.lattice
    }

    /// Probability that a cell is occupied; `None` if it was never observed or lies outside the region.
    #[must_use]
    pub fn probability(&self, cell: CellIndex) -> Option<f32> {
        let probability = self.probabilities[self.lattice.place(cell)?];
        (!probability.is_nan()).then_some(probability)
    }

    /// Probabilities of all observed cells of the region.
    pub fn known(&self) -> impl Iterator<Item = f32> {
        self.probabilities.iter().copied().filter(|probability| !probability.is_nan())
    }

    /// Probabilities by place in the lattice; NaN where unknown, and on the border.
    pub(crate) fn probabilities(&self) -> &[f32] {
        &self.probabilities
    }
}

/// A region of a grid at many times.
#[derive(Clone, Debug)]
pub struct PredictedTimes {
    lattice: Arc<Lattice>,
    times: usize,
    /// The probabilities at the first time, by place in the lattice; NaN where unknown, and on the border.
    first: Vec<f32>,
    /// Places of the changing cells, ascending.
    varying: Vec<u32>,
    /// Probabilities of the changing cells: all times of the first cell, then of the next.
    values: Vec<f32>,
}

/// The predictions of a tile.
struct TileTimes {
    index: TileIndex,
    first: Box<[f32; TILE_CELLS]>,
    varying: Vec<(u16, Vec<f32>)>,
}

impl PredictedTimes {
    /// Predicts a map's grid at times in nanoseconds UTC. Takes 4 bytes a cell, and 4 bytes a time for each changing
    /// cell.
    ///
    /// # Errors
    /// [`PredictError`]; if the region is too large, before the work begins; [`PredictError::Stop`].
    pub fn new(
        view: &MapView,
        utc_nanos: &[i64],
        options: &PredictOptions,
        stop: StopSignal<'_>,
    ) -> Result<PredictedTimes, PredictError> {
        let grid = view.grid().ok_or(PredictError::NoGrid)?;
        if utc_nanos.is_empty() {
            return Err(PredictError::NoTime);
        }
        let of_interest = grid.spec().extent.unwrap_or_else(|| grid.bounds());
        let region = options.region.map_or(of_interest, |region| region.intersection(&of_interest));
        let lattice = Arc::new(Lattice::new(grid.spec(), region, options.max_cells)?);
        let phasors = |moment| InstantPhasors::new(&view.spec().periodicities, moment);
        let moments: Vec<(i64, InstantPhasors)> =
            view.moments(utc_nanos).iter().map(|moment| (moment.utc_nanos, phasors(moment.civil_nanos()))).collect();
        let tiles = grid.tiles_in(&lattice.region());
        let values = AtomicU64::new(0);
        let tiles: Vec<TileTimes> = tiles
            .par_iter()
            .map(|&tile| {
                let tile = tile_times(grid, tile, &moments, &lattice, (options, stop))?;
                let added = tile.varying.len() as u64 * moments.len() as u64;
                if values.fetch_add(added, Ordering::Relaxed) + added > options.max_values {
                    return Err(PredictError::TooManyValues { times: moments.len(), max: options.max_values });
                }
                Ok(tile)
            })
            .collect::<Result<_, PredictError>>()?;
        let mut first = vec![f32::NAN; lattice.held()];
        let mut varying = Vec::new();
        for tile in tiles {
            stop.check()?;
            for (place, &probability) in (0..).zip(tile.first.iter()) {
                if let (Some(place), false) = (lattice.place(tile.index.cell(place)), probability.is_nan()) {
                    first[place] = probability;
                }
            }
            varying.extend(tile.varying.into_iter().filter_map(|(place, values)| {
                let place = lattice.place(tile.index.cell(place))?;
                Some((place as u32, values))
            }));
        }
        Ok(PredictedTimes::of_parts(lattice, utc_nanos.len(), first, varying))
    }

    /// A grid from other predictions at `times` times, at least 1: `probability` gives each cell's probability of being
    /// occupied at each time, clipped to [0, 1]; `None` and NaN at the first time: unknown.
    ///
    /// # Errors
    /// [`PredictError::NoTime`]
    pub fn from_fn(
        lattice: Arc<Lattice>,
        times: usize,
        mut probability: impl FnMut(CellIndex, usize) -> Option<f32>,
    ) -> Result<PredictedTimes, PredictError> {
        if times == 0 {
            return Err(PredictError::NoTime);
        }
        let mut first = vec![f32::NAN; lattice.held()];
        let mut varying = Vec::new();
        for place in lattice.rows().flatten() {
            let Some(cell) = lattice.cell(place) else { continue };
            let mut value_at =
                |time| probability(cell, time).filter(|value| !value.is_nan()).map(|value| value.clamp(0.0, 1.0));
            let Some(known) = value_at(0) else { continue };
            first[place] = known;
            let values: Vec<f32> =
                std::iter::once(known).chain((1..times).map(|time| value_at(time).unwrap_or(known))).collect();
            if values.iter().any(|value| *value != known) {
                varying.push((place as u32, values));
            }
        }
        Ok(PredictedTimes::of_parts(lattice, times, first, varying))
    }

    fn of_parts(
        lattice: Arc<Lattice>,
        times: usize,
        first: Vec<f32>,
        mut varying: Vec<(u32, Vec<f32>)>,
    ) -> PredictedTimes {
        varying.sort_unstable_by_key(|(place, _)| *place);
        let places = varying.iter().map(|(place, _)| *place).collect();
        let values = varying.into_iter().flat_map(|(_, values)| values).collect();
        PredictedTimes { lattice, times, first, varying: places, values }
    }

    /// The lattice of the cells.
    #[must_use]
    pub fn lattice(&self) -> &Arc<Lattice> {
        &self.lattice
    }

    /// Number of times, at least 1.
    #[must_use]
    pub fn times(&self) -> usize {
        self.times
    }

    /// Number of changing cells.
    #[must_use]
    pub fn varying(&self) -> usize {
        self.varying.len()
    }

    /// The grid at one of the times, by its number from 0; `None` beyond the last.
    #[must_use]
    pub fn at(&self, time: usize) -> Option<PredictedGrid> {
        if time >= self.times {
            return None;
        }
        let mut probabilities = self.first.clone();
        for (place, values) in self.rows() {
            probabilities[place] = values[time];
        }
        Some(PredictedGrid { lattice: Arc::clone(&self.lattice), probabilities })
    }

    pub(super) fn into_first(self) -> PredictedGrid {
        PredictedGrid { lattice: self.lattice, probabilities: self.first }
    }

    /// Probabilities at the first time, by place.
    pub(crate) fn first(&self) -> &[f32] {
        &self.first
    }

    /// Place and probabilities of each changing cell, ascending.
    pub(crate) fn rows(&self) -> impl Iterator<Item = (usize, &[f32])> {
        self.varying.iter().map(|&place| place as usize).zip(self.values.chunks_exact(self.times))
    }
}

fn tile_times(
    grid: &GridView,
    (index, id): (TileIndex, TileId),
    moments: &[(i64, InstantPhasors)],
    lattice: &Lattice,
    (options, stop): (&PredictOptions, StopSignal<'_>),
) -> Result<TileTimes, PredictError> {
    let mut first = Box::new([f32::NAN; TILE_CELLS]);
    let mut varying: Vec<(u16, Vec<f32>)> = Vec::new();
    let Some(((utc_nanos, phasors), later)) = moments.split_first() else {
        return Err(PredictError::NoTime);
    };
    stop.check()?;
    let tile = grid.predict_tile(id, *utc_nanos, phasors, options.selector)?;
    for cell in tile.known.cells() {
        first[usize::from(cell)] = tile.probabilities[usize::from(cell)];
    }
    let is_constant = match options.selector.kind {
        ModelKind::Latest => true,
        ModelKind::Mean => !options.selector.is_blended(),
        _ => !options.selector.is_blended() && tile.changed.is_empty(),
    };
    if is_constant || later.is_empty() {
        return Ok(TileTimes { index, first, varying });
    }
    let at = |(utc_nanos, phasors): &(i64, InstantPhasors)| {
        stop.check()?;
        Ok(grid.predict_tile(id, *utc_nanos, phasors, options.selector)?)
    };
    let later: Vec<_> = later.iter().map(at).collect::<Result<_, PredictError>>()?;
    for cell in tile.known.cells().filter(|&cell| lattice.region().contains(index.cell(cell))) {
        let known = first[usize::from(cell)];
        let values = later.iter().map(|tile| tile.probabilities[usize::from(cell)]);
        if values.clone().any(|value| value != known) {
            varying.push((cell, std::iter::once(known).chain(values).collect()));
        }
    }
    Ok(TileTimes { index, first, varying })
}
