//! The true state of each cell of the hall, and how often it was seen.
//!
//! Invariant: computed from the plan and the exact ends of beams, never from measured ranges or reported poses.

use super::{
    plan::{HallPlan, HallThing},
    robot::HallScan,
};

/// Length of a cell's edge.
const CELL_M: f64 = 0.1;
/// The lowest cell along both axes.
const LOWEST: i32 = -5;
const WIDTH: i32 = 312;
const HEIGHT: i32 = 212;
/// Distance between two places of a beam at which its cells are noted.
const STEP_M: f64 = 0.08;
/// The last part of a beam, within the errors of its thing's border.
const END_M: f64 = 0.15;

/// A cell of the hall, 0.1 m wide, with its lower corner at 0.1 m times its index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HallCell {
    /// x and y.
    pub index: [i32; 2],
    /// The thing in the cell, at any height. The table's cells are free without the table.
    pub thing: Option<HallThing>,
    /// The number of exact beams that ended in the cell.
    pub ends: u32,
    /// Whether an exact beam passed the cell.
    pub is_passed: bool,
    /// Distance of its middle from the nearest thing, the table included.
    pub distance_m: f64,
}

/// The cells of the hall.
#[derive(Clone, Debug)]
pub struct HallTruth {
    cells: Vec<HallCell>,
}

impl HallTruth {
    pub(super) fn new(plan: &HallPlan) -> Self {
        let indices = (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| [x + LOWEST, y + LOWEST]));
        let cell = |index: [i32; 2]| {
            let middle = index.map(|along| (f64::from(along) + 0.5) * CELL_M);
            let things = || plan.still.iter().copied().chain([(HallThing::Table, plan.table)]);
            let mut inside = things().filter(|(_, solid)| solid.overlaps(middle, CELL_M / 2.0));
            let distance_m = things().map(|(_, solid)| solid.distance_m(middle)).fold(f64::INFINITY, f64::min);
            HallCell { index, thing: inside.next().map(|(thing, _)| thing), ends: 0, is_passed: false, distance_m }
        };
        Self { cells: indices.map(cell).collect() }
    }

    /// All cells, x fastest.
    pub fn cells(&self) -> &[HallCell] {
        &self.cells
    }

    /// The cell at a place; `None` far outside.
    pub fn cell_at(&self, place_m: [f64; 2]) -> Option<&HallCell> {
        self.number(place_m).map(|number| &self.cells[number])
    }

    fn number(&self, place_m: [f64; 2]) -> Option<usize> {
        let [x, y] = place_m.map(|along| (along / CELL_M).floor() as i32 - LOWEST);
        ((0..WIDTH).contains(&x) && (0..HEIGHT).contains(&y)).then_some((x + y * WIDTH) as usize)
    }

    /// Notes the cells that a scan shows.
    pub fn note(&mut self, scan: &HallScan) {
        let from = scan.true_pose.place_m;
        for end in scan.ends.iter().flatten() {
            if let Some(number) = self.number(*end) {
                self.cells[number].ends += 1;
            }
            let along = [0, 1].map(|axis| end[axis] - from[axis]);
            let range_m = (along[0] * along[0] + along[1] * along[1]).sqrt();
            for step in 0..((range_m - END_M).max(0.0) / STEP_M) as u32 {
                let share = f64::from(step) * STEP_M / range_m;
                if let Some(number) = self.number([0, 1].map(|axis| from[axis] + share * along[axis])) {
                    self.cells[number].is_passed = true;
                }
            }
        }
    }
}
