//! Flows of people: the number of people detected in each cell of a raster, their direction, and the time.
//!
//! The method is from S. Molina, G. Cielniak, T. Krajník and T. Duckett, "Modelling and Predicting Rhythmic Flow
//! Patterns in Dynamic Environments", TAROS 2018 (thesis, section 4.2): each cell counts its detections in bins of
//! directions, and each bin has a periodic rate. The rates are those of the Poisson-spectral model
//! ([`super::poisson`]); the detections of all directions of a cell choose one order together, in the same way as the
//! labels of a categorical state.
//!
//! The whole time between the first and the last detection counts as watched: no detection means nobody.
//!
//! Invariant: rates are positive and finite. A cell without detections has the rate of its prior.

use std::{collections::BTreeMap, f64::consts::TAU, ops::RangeInclusive};

use super::{CannotTrain, Moment};
use crate::{Periodicities, PhasorTable, StopSignal};

mod cell;
mod intervals;
mod raster;

use cell::{CellCounts, CellRates, HeldOutDays};
use intervals::FlowIntervals;
pub use raster::FlowRaster;

#[cfg(test)]
mod tests;

/// Number of directions that detections may be sorted into.
pub const FLOW_DIRECTIONS: RangeInclusive<usize> = 4..=36;
/// Maximum number of cells of a raster times their directions.
pub const FLOW_BINS_MAX: usize = 200_000;
/// The intervals that detections are counted in by default: ten minutes, in nanoseconds.
pub const FLOW_INTERVAL_NANOS: i64 = 600 * 1_000_000_000;
/// The maximum number of intervals: a longer record has longer intervals.
const INTERVALS_MAX: i64 = 20_000;
/// With fewer days no days are held out, and the order is 0.
const DAYS_MIN: usize = 4;

/// A moving person, detected at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowDetection {
    /// The moment of the detection.
    pub moment: Moment,
    /// The place, x and y in metres.
    pub place_m: [f64; 2],
    /// The direction of movement in radians, counter-clockwise from the x axis.
    pub direction_rad: f64,
}

/// The options of learning flows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowOptions {
    /// The cells; at most [`FLOW_BINS_MAX`] times their directions.
    pub raster: FlowRaster,
    /// Number of directions, in [`FLOW_DIRECTIONS`]. The first is the x axis, the others follow counter-clockwise.
    pub directions: usize,
    /// Length of the intervals in which detections are counted, in nanoseconds, a second to a day.
    pub interval_nanos: i64,
    /// The greatest order; 0 learns means without time.
    pub order_max: usize,
    /// Half-life of the weight of detections, in seconds; `None`: all have equal weight.
    pub half_life_secs: Option<f64>,
}

impl FlowOptions {
    /// The default options: eight directions and intervals of [`FLOW_INTERVAL_NANOS`].
    pub fn new(raster: FlowRaster) -> FlowOptions {
        let (directions, interval_nanos) = (8, FLOW_INTERVAL_NANOS);
        FlowOptions { raster, directions, interval_nanos, order_max: crate::ORDER_MAX, half_life_secs: None }
    }

    fn check(&self) -> Result<(), CannotTrain> {
        let refused = |parameter, found, expected| Err(CannotTrain::Parameter { parameter, found, expected });
        if !FLOW_DIRECTIONS.contains(&self.directions) {
            return refused("directions", self.directions as f64, "4 to 36");
        }
        let bins = self.raster.cells().saturating_mul(self.directions);
        if bins == 0 || bins > FLOW_BINS_MAX {
            return refused("cells times directions", bins as f64, "1 to 200000");
        }
        if !(1_000_000_000..=86_400_000_000_000).contains(&self.interval_nanos) {
            return refused("interval in seconds", self.interval_nanos as f64 / 1e9, "1 s to a day");
        }
        Ok(())
    }

    /// The bin of a direction in radians: the nearest, counted from 0.
    pub fn direction(&self, direction_rad: f64) -> usize {
        let turns = direction_rad / TAU;
        ((turns - turns.floor()) * self.directions as f64).round() as usize % self.directions
    }
}

/// The flows of a raster over time.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowModel {
    options: FlowOptions,
    periodicities: Periodicities,
    /// Cells with detections, ascending by index.
    cells: Vec<CellRates>,
    /// The rate of a direction of a cell without detections.
    prior: f64,
    interval_nanos: i64,
    detections: u64,
}

/// The expected flow in one cell.
#[derive(Clone, Debug, PartialEq)]
pub struct CellFlow {
    /// Index of the cell in the raster.
    pub cell: usize,
    /// Expected detections per second, by direction; above 0.
    pub per_sec: Vec<f64>,
}

impl CellFlow {
    /// Expected detections per second in all directions.
    pub fn total_per_sec(&self) -> f64 {
        self.per_sec.iter().sum()
    }

    /// The probability of each direction of a detection.
    pub fn shares(&self) -> Vec<f64> {
        let total = self.total_per_sec();
        self.per_sec.iter().map(|rate| rate / total).collect()
    }
}

impl FlowModel {
    /// Trains on detections, ascending by time; those outside of the raster do not count. The last quarter of the days
    /// chooses the order of each cell: the lowest whose Poisson log-likelihood, summed over directions, is within
    /// 3 nats of the highest. With fewer than four days it is 0.
    ///
    /// # Errors
    /// [`CannotTrain`] if an option is out of range, a number is not finite, nothing lies in the raster, or the
    /// training is stopped.
    pub fn train(
        detections: &[FlowDetection],
        periodicities: &Periodicities,
        options: &FlowOptions,
        stop: StopSignal<'_>,
    ) -> Result<FlowModel, CannotTrain> {
        options.check()?;
        let (Some(first), Some(last)) = (detections.first(), detections.last()) else {
            return Err(CannotTrain::NoReadings);
        };
        let (first, last) = (first.moment.civil_nanos(), last.moment.civil_nanos());
        let intervals = FlowIntervals::between(first, last, options);
        let counted = counted(detections, &intervals, options)?;
        let all = intervals.all(periodicities);
        let days = intervals.days();
        let held = (days.len() >= DAYS_MIN && options.order_max > 0)
            .then(|| HeldOutDays::of(&intervals, days[days.len() - days.len() / 4], periodicities));
        let mut cells = Vec::with_capacity(counted.cells.len());
        for (cell, counts) in counted.cells {
            stop.check()?;
            let order = held.as_ref().map_or(0, |held| held.best_order(&counts, &intervals, options));
            let rates = counts.rates(&all, &intervals, periodicities, order);
            cells.push(CellRates { cell, order, rates });
        }
        let prior = cell::prior_mean(options.directions, all.weight);
        let (periodicities, interval_nanos) = (periodicities.clone(), intervals.length_nanos());
        Ok(FlowModel { options: *options, periodicities, cells, prior, interval_nanos, detections: counted.detections })
    }

    /// The options that the model was trained with.
    pub fn options(&self) -> &FlowOptions {
        &self.options
    }

    /// Number of detections that the model was trained on.
    pub fn detections(&self) -> u64 {
        self.detections
    }

    /// Number of cells with detections.
    pub fn cells(&self) -> usize {
        self.cells.len()
    }

    /// The order of each cell with detections, by its index.
    pub fn orders(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.cells.iter().map(|cell| (cell.cell, cell.order))
    }

    /// Expected detections per second in one direction of a cell in which nobody was detected.
    pub fn unseen_per_sec(&self) -> f64 {
        self.prior / self.interval_secs()
    }

    /// The expected flow at a moment in each cell with detections, ascending by index.
    pub fn at(&self, at: Moment) -> Vec<CellFlow> {
        let phasors = PhasorTable::new(&self.periodicities, &[at.civil_nanos()]);
        let secs = self.interval_secs();
        let of_cell = |cell: &CellRates| CellFlow {
            cell: cell.cell,
            per_sec: cell.rates.iter().map(|rate| rate.at(&phasors, 0) / secs).collect(),
        };
        self.cells.iter().map(of_cell).collect()
    }

    fn interval_secs(&self) -> f64 {
        self.interval_nanos as f64 / 1e9
    }
}

struct CountedFlow {
    cells: BTreeMap<usize, CellCounts>,
    detections: u64,
}

/// The detections of each cell by direction and interval.
fn counted(
    detections: &[FlowDetection],
    intervals: &FlowIntervals,
    options: &FlowOptions,
) -> Result<CountedFlow, CannotTrain> {
    let mut found = CountedFlow { cells: BTreeMap::new(), detections: 0 };
    for detection in detections {
        let numbers = detection.place_m.into_iter().chain([detection.direction_rad]);
        if let Some(value) = numbers.into_iter().find(|number| !number.is_finite()) {
            return Err(CannotTrain::Parameter {
                parameter: "a coordinate or direction",
                found: value,
                expected: "a finite number",
            });
        }
        let Some(cell) = options.raster.cell(detection.place_m) else { continue };
        let interval = intervals.index(detection.moment.civil_nanos());
        let counts = found.cells.entry(cell).or_insert_with(|| CellCounts::new(options.directions));
        counts.add(options.direction(detection.direction_rad), interval);
        found.detections += 1;
    }
    if found.detections == 0 { Err(CannotTrain::NoReadings) } else { Ok(found) }
}
