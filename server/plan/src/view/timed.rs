//! A region of a grid at many times, with views at all of them in one pass.
//!
//! Each branch of the tree of rays carries the set of times at which it is open, as bits; only a cell that is occupied
//! at some of the times changes it. Cells visible at all times are summed once if they never change, and time by time
//! if they do; cells behind changing obstacles are summed for the times at which they are visible.
//!
//! Invariant: the result for a time equals, up to rounding, the view of the scene of that time alone.

use std::sync::Arc;

use tidemap_grid::index::CellIndex;
use tidemap_model::StopSignal;

use super::{
    Fan, NODES_PER_CHECK, SceneError, SceneOptions, Sensor, ViewError, Viewpoint,
    scene::{OPAQUE, OUTSIDE},
};
use crate::predicted::{Lattice, PredictedTimes};

/// A cell that changes between the times.
const VARIES: u8 = 4;
/// A changing cell that is occupied at some times only.
const FLIPS: u8 = 8;
/// A cell that is visible at all times.
const WHOLE: u8 = 16;
/// A cell that is visible at some times.
const PARTLY: u8 = 32;
/// Times of one pass.
const CHUNK: usize = u128::BITS as usize;

/// A region of a grid at many times, prepared for views.
#[derive(Clone, Debug)]
pub struct TimedScene {
    lattice: Arc<Lattice>,
    times: usize,
    flags: Vec<u8>,
    /// Information of the cells that do not change.
    bits: Vec<f64>,
    /// Numbers of the changing cells, by place; empty without any.
    numbers: Vec<u32>,
    /// Information of the changing cells: all times of the first cell, then of the next.
    rows: Vec<f64>,
    /// Times at which the changing cells are occupied, in the same order, one set per chunk of times.
    occupied: Vec<u128>,
}

impl TimedScene {
    /// Prepares predictions for views. Takes 9 bytes a cell; with changing cells 13, and 8 bytes a time for each of
    /// them.
    ///
    /// # Errors
    /// [`SceneError`]
    pub fn new(grid: &PredictedTimes, options: &SceneOptions, stop: StopSignal<'_>) -> Result<TimedScene, SceneError> {
        options.check()?;
        let lattice = Arc::clone(grid.lattice());
        let (mut flags, bits) = options.judge(&lattice, grid.first(), stop);
        stop.check()?;
        let mut numbers = if grid.varying() > 0 { vec![0; lattice.held()] } else { Vec::new() };
        let mut rows = Vec::with_capacity(grid.varying() * grid.times());
        let mut occupied = Vec::with_capacity(grid.varying() * grid.times().div_ceil(CHUNK));
        for (number, (place, probabilities)) in (0..).zip(grid.rows()) {
            stop.check()?;
            numbers[place] = number;
            rows.extend(probabilities.iter().map(|&p| options.certainty.bits(f64::from(p))));
            let mut stops = 0;
            for chunk in probabilities.chunks(CHUNK) {
                let times = chunk.iter().rev().fold(0, |times, &p| times << 1 | u128::from(options.stops(p)));
                stops += times.count_ones() as usize;
                occupied.push(times);
            }
            flags[place] = match stops {
                0 => VARIES,
                all if all == grid.times() => VARIES | OPAQUE,
                _ => VARIES | FLIPS,
            };
        }
        Ok(TimedScene { lattice, times: grid.times(), flags, bits, numbers, rows, occupied })
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

    /// The cell of a viewpoint.
    ///
    /// # Errors
    /// [`ViewError`]; [`ViewError::Occupied`] if the cell is occupied at all times.
    pub fn stand(&self, sensor: &Sensor, at: &Viewpoint) -> Result<CellIndex, ViewError> {
        let cell = at.cell(sensor, &self.lattice)?;
        if self.lattice.place(cell).is_none_or(|place| self.flags[place] & OPAQUE != 0) {
            return Err(ViewError::Occupied { x_m: at.x_m, y_m: at.y_m, cell });
        }
        Ok(cell)
    }

    /// Times of a chunk at which a changing cell is occupied.
    fn occupied(&self, place: usize, chunk: usize) -> u128 {
        self.occupied[self.numbers[place] as usize * self.times.div_ceil(CHUNK) + chunk]
    }
}

/// A cell that is visible at some of the times.
#[derive(Clone, Copy, Debug)]
struct PartialCell {
    place: usize,
    times: u128,
}

/// Evaluates views of scenes of many times one after the other; holds the memory of one view.
#[derive(Clone, Debug)]
pub struct TimedViewScorer {
    /// For each cell of the fan the number of the last view that saw it, times 256, and its flags; [`WHOLE`] if it is
    /// visible at all times.
    marks: Vec<u16>,
    view: u16,
    /// Index in `partly` of a cell visible at some times.
    slots: Vec<u32>,
    partly: Vec<PartialCell>,
    /// Ends of branches that are open at some times, and the times after them.
    branches: Vec<(usize, u128)>,
}

impl TimedViewScorer {
    /// Memory for the rays of a fan.
    #[must_use]
    pub fn new(fan: &Fan) -> TimedViewScorer {
        let (marks, slots) = (vec![0; fan.cells()], vec![0; fan.cells()]);
        TimedViewScorer { marks, view: 0, slots, partly: Vec::new(), branches: Vec::new() }
    }

    /// Expected information in bits of the view from the centre of a cell of the region at each of the times; `None` at
    /// times at which that cell is probably occupied, outside the region, and for rays of a region of another size.
    #[must_use]
    pub fn view(&mut self, scene: &TimedScene, fan: &Fan, from: CellIndex) -> Vec<Option<f64>> {
        self.view_until(scene, fan, from, StopSignal::NEVER)
    }

    /// Does the same as [`TimedViewScorer::view`]; if the signal was set, the result must not be used.
    pub(super) fn view_until(
        &mut self,
        scene: &TimedScene,
        fan: &Fan,
        from: CellIndex,
        stop: StopSignal<'_>,
    ) -> Vec<Option<f64>> {
        let mut bits_by_time = Vec::with_capacity(scene.times);
        let Some(start) = scene.lattice.place(from).filter(|_| fan.fits(&scene.lattice)) else {
            bits_by_time.resize(scene.times, None);
            return bits_by_time;
        };
        for chunk in 0..scene.times.div_ceil(CHUNK) {
            let count = CHUNK.min(scene.times - chunk * CHUNK);
            let all = u128::MAX >> (CHUNK - count);
            let flags = scene.flags[start];
            let free = match flags & (FLIPS | OPAQUE) {
                0 => all,
                FLIPS => all & !scene.occupied(start, chunk),
                _ => 0,
            };
            let mut bits = [0.0; CHUNK];
            if free != 0 {
                self.pass((scene, fan, stop), start, (chunk, free), &mut bits[..count]);
            }
            bits_by_time.extend((0..count).map(|time| (free >> time & 1 == 1).then_some(bits[time])));
        }
        bits_by_time
    }

    /// One pass, from a place that is free at these times of a chunk.
    fn pass(
        &mut self,
        (scene, fan, stop): (&TimedScene, &Fan, StopSignal<'_>),
        start: usize,
        (chunk, free): (usize, u128),
        bits: &mut [f64],
    ) {
        self.begin(fan);
        let view = self.view << 8;
        let row = |place: usize| {
            let from = scene.numbers[place] as usize * scene.times + chunk * CHUNK;
            &scene.rows[from..from + bits.len()]
        };
        let mut fixed = 0.0;
        let mut varying = vec![0.0; bits.len()];
        let (mut at, mut end, mut times) = (0, usize::MAX, free);
        let mut passed = 0_usize;
        while let Some(&cell) = fan.nodes.get(at) {
            passed += 1;
            if passed.is_multiple_of(NODES_PER_CHECK) && stop.is_set() {
                break;
            }
            while at == end {
                (end, times) = self.branches.pop().unwrap_or((usize::MAX, free));
            }
            let cell = cell as usize;
            let place = || start.wrapping_add_signed(fan.offsets[cell] as isize);
            let mark = self.marks[cell];
            let mut flags = if mark & 0xff00 == view { mark as u8 } else { scene.flags[place()] };
            if flags & (WHOLE | OUTSIDE) == 0 {
                if times == free {
                    if flags & PARTLY != 0 {
                        self.partly[self.slots[cell] as usize].times = 0;
                    }
                    flags |= WHOLE;
                    if flags & VARIES == 0 {
                        fixed += scene.bits[place()];
                    } else {
                        varying.iter_mut().zip(row(place())).for_each(|(sum, bits)| *sum += bits);
                    }
                } else if flags & PARTLY != 0 {
                    self.partly[self.slots[cell] as usize].times |= times;
                } else {
                    flags |= PARTLY;
                    self.slots[cell] = self.partly.len() as u32;
                    self.partly.push(PartialCell { place: place(), times });
                }
                self.marks[cell] = view | u16::from(flags);
            }
            let open = match flags & (FLIPS | OPAQUE) {
                0 => times,
                FLIPS => times & !scene.occupied(place(), chunk),
                _ => 0,
            };
            if open == times {
                at += 1;
                continue;
            }
            let skip = fan.skips[at] as usize;
            if open == 0 {
                at = skip;
            } else {
                at += 1;
                self.branches.push((end, times));
                (end, times) = (skip, open);
            }
        }
        self.branches.clear();
        self.add_partly(scene, row, &mut varying);
        bits.iter_mut().zip(varying).for_each(|(bits, varying)| *bits = fixed + varying);
    }

    /// Adds the cells that are seen at some of the times only; `row` returns the information of a cell at each time.
    fn add_partly<'r>(&self, scene: &TimedScene, row: impl Fn(usize) -> &'r [f64], varying: &mut [f64]) {
        for &PartialCell { place, times } in &self.partly {
            let (row, is_fixed) =
                if scene.flags[place] & VARIES == 0 { (None, scene.bits[place]) } else { (Some(row(place)), 0.0) };
            let mut rest = times;
            while rest != 0 {
                let time = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                varying[time] += row.map_or(is_fixed, |row| row[time]);
            }
        }
    }

    fn begin(&mut self, fan: &Fan) {
        if self.marks.len() < fan.cells() {
            self.marks.resize(fan.cells(), 0);
            self.slots.resize(fan.cells(), 0);
        }
        self.view += 1;
        if self.view == 256 {
            self.marks.fill(0);
            self.view = 1;
        }
        self.partly.clear();
        self.branches.clear();
    }
}
