//! Driving distances of a robot around probable obstacles.
//!
//! The predicted grid is seen from above: a column is an obstacle where any of its cells at the robot's height is
//! probably occupied, unknown where none of them was ever observed, and free otherwise. The robot is a disc; its centre
//! keeps its radius from the cells of obstacles. Unknown columns are not entered unless the options allow it, and need
//! no clearance. Driving goes from centre to centre of columns, in eight directions, and does not cut corners.
//!
//! Invariant: distances are symmetric, and the same request gives the same result, bit by bit.

use std::{cmp::Reverse, collections::BinaryHeap, sync::Arc};

use tidemap_grid::index::CellIndex;
use tidemap_map::no_go::NoGoAreas;
use tidemap_model::StopSignal;

use crate::predicted::{Lattice, PredictedGrid};

#[cfg(test)]
pub(crate) mod tests;

/// The largest radius of a robot, in cells.
const RADIUS_CELLS_MAX: f64 = 200.0;
/// Number of columns between two checks of the stop signal.
const COLUMNS_PER_CHECK: usize = 4096;

/// The options of driving.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TravelOptions {
    /// Lower end of the heights of obstacles, metres in the map's frame. Without effect in a flat grid. Default 0.2,
    /// above the cells of the floor.
    pub z_min_m: f64,
    /// Upper end of the heights of obstacles, metres, above the lower end. Default 1.8.
    pub z_max_m: f64,
    /// Radius of the robot, metres, at least 0. Default 0.3.
    pub radius_m: f64,
    /// Cells with a higher probability are obstacles; the threshold is in [0, 1]. Default 0.5.
    pub threshold: f64,
    /// Whether unknown columns can be driven over. Default: no.
    pub unknown_is_passable: bool,
}

impl Default for TravelOptions {
    fn default() -> TravelOptions {
        TravelOptions { z_min_m: 0.2, z_max_m: 1.8, radius_m: 0.3, threshold: 0.5, unknown_is_passable: false }
    }
}

/// The reason why the options of driving are invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum InvalidTravel {
    /// The heights are not a range.
    #[error("heights {min_m} to {max_m} m: both must be finite, and the second above the first")]
    Heights { min_m: f64, max_m: f64 },
    /// No cell of the region lies at these heights.
    #[error("no cell of the region lies at heights from {min_m} to {max_m} m")]
    NoCell { min_m: f64, max_m: f64 },
    /// The radius is out of range.
    #[error("radius {radius_m} m: it must be between 0 and {max_m} m on this grid")]
    Radius { radius_m: f64, max_m: f64 },
    /// The threshold is not a probability.
    #[error("threshold {0}: it must be between 0 and 1")]
    Threshold(f64),
}

/// The columns on which a robot can drive.
#[derive(Clone, Debug)]
pub struct TravelGrid {
    lattice: Arc<Lattice>,
    size: [usize; 2],
    passable: Vec<bool>,
}

/// A column, seen from above: its index along x and along y, from the region's lowest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Column {
    /// Index along x.
    pub x: usize,
    /// Index along y.
    pub y: usize,
}

/// Distances from one column to all others.
#[derive(Clone, Debug)]
pub struct Distances {
    width: usize,
    metres: Vec<f64>,
}

impl Distances {
    /// Distance to a column, metres; `None` if it is unreachable.
    pub fn to(&self, column: Column) -> Option<f64> {
        let known = self.metres.get(column.y * self.width + column.x).copied();
        known.filter(|metres| column.x < self.width && metres.is_finite())
    }
}

impl TravelGrid {
    /// The passable columns of a predicted grid.
    ///
    /// # Errors
    /// [`InvalidTravel`] with the invalid value and the valid range.
    pub fn new(grid: &PredictedGrid, options: &TravelOptions) -> Result<TravelGrid, InvalidTravel> {
        TravelGrid::until(grid, options, StopSignal::NEVER)
    }

    /// Does the same as [`TravelGrid::new`]; if the signal was set, the result must not be used.
    pub(crate) fn until(
        grid: &PredictedGrid,
        options: &TravelOptions,
        stop: StopSignal<'_>,
    ) -> Result<TravelGrid, InvalidTravel> {
        let lattice = grid.lattice();
        let (min_m, max_m) = (options.z_min_m, options.z_max_m);
        if !(min_m.is_finite() && max_m.is_finite() && min_m < max_m) {
            return Err(InvalidTravel::Heights { min_m, max_m });
        }
        let radius_max_m = RADIUS_CELLS_MAX * lattice.resolution_m();
        if !(0.0..=radius_max_m).contains(&options.radius_m) {
            return Err(InvalidTravel::Radius { radius_m: options.radius_m, max_m: radius_max_m });
        }
        if !(0.0..=1.0).contains(&options.threshold) {
            return Err(InvalidTravel::Threshold(options.threshold));
        }
        let (region, [width, depth, _]) = (lattice.region(), lattice.size());
        // Cells that overlap the heights by more than rounding.
        let reaches = |z: i32| {
            let centre_m = lattice.centre_m(CellIndex { z, ..region.min })[2];
            let half_m = lattice.resolution_m() * (0.5 - 1e-9);
            centre_m + half_m > min_m && centre_m - half_m < max_m
        };
        let layers: Vec<i32> = (region.min.z..region.max.z).filter(|&z| lattice.is_flat() || reaches(z)).collect();
        if layers.is_empty() {
            return Err(InvalidTravel::NoCell { min_m, max_m });
        }
        let mut known = vec![options.unknown_is_passable; width * depth];
        let mut blocked = vec![false; width * depth];
        for z in layers.into_iter().take_while(|_| !stop.is_set()) {
            for (y, row) in (region.min.y..region.max.y).enumerate() {
                let Some(start) = lattice.place(CellIndex { x: region.min.x, y: row, z }) else { continue };
                let row = &grid.probabilities()[start..start + width];
                for (column, probability) in (y * width..).zip(row) {
                    known[column] |= !probability.is_nan();
                    blocked[column] |= f64::from(*probability) > options.threshold;
                }
            }
        }
        let mut travel = TravelGrid { lattice: Arc::clone(lattice), size: [width, depth], passable: known };
        travel.keep_away(&blocked, options.radius_m / lattice.resolution_m(), stop);
        Ok(travel)
    }

    /// Closes the columns whose squares touch an area, and the columns nearer to them than the radius of the robot, as
    /// for obstacles.
    pub(crate) fn close(&mut self, no_go: &NoGoAreas, radius_m: f64, stop: StopSignal<'_>) {
        let [width, depth] = self.size;
        let half_m = self.lattice.resolution_m() / 2.0;
        let mut blocked = vec![false; width * depth];
        for column in (0..depth).take_while(|_| !stop.is_set()).flat_map(|y| (0..width).map(move |x| Column { x, y })) {
            let [x, y] = self.centre_m(column);
            let corner = |side_x: f64, side_y: f64| [x + side_x * half_m, y + side_y * half_m];
            let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
            let mut sides = corners.iter().zip(corners.iter().cycle().skip(1));
            let is_closed = no_go.has([x, y]) || sides.any(|(one, other)| no_go.touches(*one, *other));
            blocked[column.y * width + column.x] = is_closed;
        }
        self.keep_away(&blocked, radius_m / self.lattice.resolution_m(), stop);
    }

    /// Closes the obstacles and the columns whose centre is nearer to an obstacle than the radius in cells.
    fn keep_away(&mut self, blocked: &[bool], radius: f64, stop: StopSignal<'_>) {
        let [width, depth] = self.size;
        let reach = (radius + 0.5).ceil() as isize;
        let gap = |away: isize| (away.unsigned_abs() as f64 - 0.5).max(0.0);
        let is_near = |x: isize, y: isize| (x, y) == (0, 0) || gap(x).hypot(gap(y)) < radius - 1e-9;
        // The half width of each row of the disc.
        let rows: Vec<(isize, isize)> =
            (-reach..=reach).filter_map(|y| Some((y, (0..=reach).rev().find(|&x| is_near(x, y))?))).collect();
        // An obstacle that is surrounded by obstacles adds nothing.
        let is_inner = |x: usize, y: usize| {
            x > 0
                && y > 0
                && x + 1 < width
                && y + 1 < depth
                && (y - 1..=y + 1)
                    .all(|y| blocked[y * width + x - 1..=y * width + x + 1].iter().all(|blocked| *blocked))
        };
        for (y, row) in blocked.chunks_exact(width).enumerate().take_while(|_| !stop.is_set()) {
            for x in (0..width).filter(|&x| row[x]) {
                self.passable[y * width + x] = false;
                if is_inner(x, y) {
                    continue;
                }
                for &(away, side) in &rows {
                    let Some(near) = y.checked_add_signed(away).filter(|&near| near < depth) else { continue };
                    let (from, to) = (x.saturating_sub(side as usize), (x + side as usize).min(width - 1));
                    self.passable[near * width + from..=near * width + to].fill(false);
                }
            }
        }
    }

    /// Number of columns along x and y.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// The column at a point of the map's frame, metres; `None` outside the region, and for numbers that are not
    /// finite.
    pub fn column_at(&self, x_m: f64, y_m: f64) -> Option<Column> {
        let lowest = self.lattice.region().min;
        let cell = self.lattice.cell_at([x_m, y_m, self.lattice.centre_m(lowest)[2]])?;
        Some(Column { x: cell.x.abs_diff(lowest.x) as usize, y: cell.y.abs_diff(lowest.y) as usize })
    }

    /// Centre of a column of the region in the map's frame, x and y in metres.
    pub(crate) fn centre_m(&self, column: Column) -> [f64; 2] {
        let lowest = self.lattice.region().min;
        let cell = CellIndex { x: lowest.x + column.x as i32, y: lowest.y + column.y as i32, z: lowest.z };
        let [x_m, y_m, _] = self.lattice.centre_m(cell);
        [x_m, y_m]
    }

    /// Whether the robot's centre can be in the column; `false` outside the region.
    pub(crate) fn is_passable(&self, column: Column) -> bool {
        let [width, depth] = self.size;
        column.x < width && column.y < depth && self.passable[column.y * width + column.x]
    }

    /// The passable column whose centre is nearest to a point of the map's frame, and its straight distance, metres;
    /// ties: the lowest y, then x. `None` if none is within `most_m`.
    pub fn nearest(&self, x_m: f64, y_m: f64, most_m: f64) -> Option<(Column, f64)> {
        let at = self.column_at(x_m, y_m)?;
        let reach =
            ((most_m / self.lattice.resolution_m()).ceil() + 1.0).min(self.size[0].max(self.size[1]) as f64) as usize;
        let mut best: Option<(Column, f64)> = None;
        for y in at.y.saturating_sub(reach)..(at.y + reach + 1).min(self.size[1]) {
            for x in at.x.saturating_sub(reach)..(at.x + reach + 1).min(self.size[0]) {
                let column = Column { x, y };
                let centre = self.centre_m(column);
                // The robot's own column has the distance 0.
                let away = if column == at { 0.0 } else { (centre[0] - x_m).hypot(centre[1] - y_m) };
                if away <= most_m && self.is_passable(column) && best.is_none_or(|(_, least)| away < least) {
                    best = Some((column, away));
                }
            }
        }
        best
    }

    /// Distances from a column to all others; none from a column that is not passable (Dijkstra 1959; steps of one
    /// cell's length along x and y, of √2 across).
    pub fn distances(&self, from: Column) -> Distances {
        self.distances_until(from, StopSignal::NEVER)
    }

    /// Does the same as [`TravelGrid::distances`]; if the signal was set, the result must not be used.
    pub(crate) fn distances_until(&self, from: Column, stop: StopSignal<'_>) -> Distances {
        let [width, _] = self.size;
        let mut lengths = vec![f64::INFINITY; self.passable.len()];
        // Lengths are not negative, so their bits have the same order.
        let mut queue = BinaryHeap::new();
        if self.is_passable(from) {
            let start = from.y * width + from.x;
            lengths[start] = 0.0;
            queue.push(Reverse((0_u64, start)));
        }
        let mut visited = 0_usize;
        while let Some(Reverse((bits, at))) = queue.pop() {
            visited += 1;
            if visited.is_multiple_of(COLUMNS_PER_CHECK) && stop.is_set() {
                break;
            }
            let length = f64::from_bits(bits);
            if length > lengths[at] {
                continue;
            }
            let [west, east, south, north] = self.sides(at);
            let mut step = |to: usize, by: f64| {
                let longer = length + by;
                if self.passable[to] && longer < lengths[to] {
                    lengths[to] = longer;
                    queue.push(Reverse((longer.to_bits(), to)));
                }
            };
            for side in [west, east, south, north].into_iter().flatten() {
                step(side, 1.0);
            }
            for along in [west, east].into_iter().flatten().filter(|&to| self.passable[to]) {
                for (across, back) in [(south, false), (north, true)] {
                    if across.is_some_and(|to| self.passable[to]) {
                        step(if back { along + width } else { along - width }, std::f64::consts::SQRT_2);
                    }
                }
            }
        }
        let metres = lengths.into_iter().map(|length| length * self.lattice.resolution_m()).collect();
        Distances { width, metres }
    }

    /// A shortest way from a column to the origin of the distances, both included; ties: the lowest y, then x. Empty if
    /// there is none.
    pub(crate) fn way(&self, from: Column, to: &Distances) -> Vec<Column> {
        let mut way = Vec::new();
        let mut next = to.to(from).map(|_| from);
        while let Some(at) = next {
            way.push(at);
            // Each step is nearer, so the way ends.
            let nearer = self.steps(at).into_iter().filter(|(column, _)| to.to(*column) < to.to(at));
            let length = |(column, by): &(Column, f64)| to.to(*column).unwrap_or(f64::INFINITY) + by;
            next = nearer.min_by(|one, other| length(one).total_cmp(&length(other))).map(|(column, _)| column);
        }
        way
    }

    /// The columns that the robot can reach from a column in one step, by y, then x, and the lengths of the steps in
    /// metres. It does not cut corners.
    fn steps(&self, Column { x, y }: Column) -> Vec<(Column, f64)> {
        let side_m = self.lattice.resolution_m();
        let mut steps = Vec::with_capacity(8);
        for to_y in y.saturating_sub(1)..=y + 1 {
            for to_x in x.saturating_sub(1)..=x + 1 {
                let is_across = to_x != x && to_y != y;
                let corners = [Column { x: to_x, y }, Column { x, y: to_y }, Column { x: to_x, y: to_y }];
                if (to_x, to_y) != (x, y) && corners.into_iter().all(|column| self.is_passable(column)) {
                    let length_m = if is_across { std::f64::consts::SQRT_2 * side_m } else { side_m };
                    steps.push((Column { x: to_x, y: to_y }, length_m));
                }
            }
        }
        steps
    }

    /// The neighbours of a column: towards lower and higher x, lower and higher y.
    fn sides(&self, at: usize) -> [Option<usize>; 4] {
        let [width, depth] = self.size;
        let (x, y) = (at % width, at / width);
        [
            (x > 0).then(|| at - 1),
            (x + 1 < width).then(|| at + 1),
            (y > 0).then(|| at - width),
            (y + 1 < depth).then(|| at + width),
        ]
    }
}
