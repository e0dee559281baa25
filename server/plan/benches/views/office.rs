//! A synthetic office of 20 x 12.8 x 2.5 m: rooms along a corridor, furniture, and cells with a daily rhythm.
//!
//! Invariant: the office is the same each time.

use tidemap_grid::index::CellIndex;
use tidemap_plan::{predicted::PredictedTimes, view::Sensor, view::Viewpoint};

/// Cells along x, y, z.
pub(crate) const SIZE: [i32; 3] = [200, 128, 25];
/// Quarters of an hour of a day.
pub(crate) const TIMES: usize = 96;

/// The office.
pub(crate) struct Office {
    /// Lowest and highest corner of each piece of furniture, and whether it changes over the day.
    things: Vec<([i32; 3], [i32; 3], bool)>,
}

fn random(seed: &mut u64, below: u64) -> i32 {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    ((*seed >> 33) % below) as i32
}

impl Office {
    pub(crate) fn new() -> Office {
        let mut seed = 1;
        let mut things = Vec::new();
        for number in 0..90 {
            let (x, y) = (3 + random(&mut seed, 190), 3 + random(&mut seed, 118));
            if (57..71).contains(&y) {
                continue;
            }
            // Every third object is a person, or a chair that is moved.
            let (side, height) = if number % 3 == 0 { (4, 17) } else { (6 + random(&mut seed, 8), 8) };
            things.push(([x, y, 0], [x + side, y + side / 2 + 2, height], number % 3 == 0));
        }
        Office { things }
    }

    fn wall(cell: CellIndex) -> bool {
        let CellIndex { x, y, z } = cell;
        let is_outer = x == 0 || y == 0 || x == SIZE[0] - 1 || y == SIZE[1] - 1 || z == 0 || z == SIZE[2] - 1;
        // The corridor's walls with a door to each room, and walls between the rooms.
        let is_door = (18..28).contains(&(x % 40)) && z < 21;
        let is_side = (y == 57 || y == 71) && !is_door;
        is_outer || is_side || (x % 40 == 0 && !(57..=71).contains(&y))
    }

    /// Probability of a cell being occupied at a time; `None` if it was never observed.
    pub(crate) fn probability(&self, cell: CellIndex, time: usize) -> Option<f32> {
        if Office::wall(cell) {
            return Some(1.0);
        }
        let CellIndex { x, y, z } = cell;
        let at = [x, y, z];
        let is_in = |low: &[i32; 3], high: &[i32; 3]| (0..3).all(|axis| (low[axis]..high[axis]).contains(&at[axis]));
        let hour = time as f32 / 4.0;
        for (number, (low, high, comes)) in self.things.iter().enumerate() {
            if is_in(low, high) {
                let shift = number as f32 % 7.0;
                let p = 0.45 + 0.4 * ((hour - 14.0 + shift) / 24.0 * std::f32::consts::TAU).cos();
                return Some(if *comes { p } else { 1.0 });
            }
        }
        // Clutter: one cell in fifty changes a little.
        let place = (x as u64 * 7919 + y as u64 * 104_729 + z as u64 * 1_299_709).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        match place >> 57 {
            0 | 1 if z < 18 => Some(0.15 + 0.1 * (hour / 24.0 * std::f32::consts::TAU).sin()),
            2 => None,
            _ => Some(0.0),
        }
    }

    /// The given number of places that are free all day.
    pub(crate) fn viewpoints(&self, count: usize, day: &PredictedTimes, sensor: &Sensor) -> Vec<Viewpoint> {
        let grids: Vec<_> = [0, 32, 48, 64].iter().filter_map(|&time| day.at(time)).collect();
        let mut seed = 7;
        let mut viewpoints = Vec::new();
        while viewpoints.len() < count {
            let x_m = f64::from(random(&mut seed, 2000)) * 0.01;
            let y_m = f64::from(random(&mut seed, 1280)) * 0.01;
            let at = Viewpoint { x_m, y_m, ..Viewpoint::default() };
            let Ok(cell) = at.cell(sensor, day.lattice()) else { continue };
            if grids.iter().all(|grid| grid.probability(cell).is_none_or(|p| p <= 0.5)) {
                viewpoints.push(at);
            }
        }
        viewpoints
    }
}
