//! Flows of people: how well the numbers, the directions and the encounters of a simulated floor are predicted.
//!
//! Cameras detect the people of a [`StreamOffice`] for some weeks; two models learn them: the spectral one, and one
//! without time, which has the mean of each cell and its histogram of directions. On later days both are scored, and
//! robots cross the floor every half hour, from 7 to 19 o'clock, on routes by [`plan_routes`]: the shortest routes, and
//! routes that avoid the encounters that a model predicts.
//!
//! - `floor.rs`: the floor as cells and as a lattice of nodes; `trips.rs`: routes, and the people met on them;
//! - `report.rs`: results.csv.
//!
//! Invariant: models learn earlier days only, all robots make the same trips among the same people, and the same
//! protocol gives the same figures for any number of threads.

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;
use tidemap_model::{
    Periodicities, StopSignal,
    models::{CannotTrain, FlowDetection, FlowModel, FlowOptions, Moment},
};
use tidemap_plan::route::PlanRouteError;
use tidemap_sim::StreamOffice;

use crate::paired;

mod floor;
mod report;
mod trips;

#[cfg(test)]
mod tests;

use floor::Floor;
pub use report::{summary, write};
pub use trips::{Crossing, TripTotals};

/// Midnight before the first day, which is a Monday: 2025-01-06 UTC.
const START_NANOS: i64 = 20_094 * DAY_NANOS;
const DAY_NANOS: i64 = 86_400_000_000_000;
/// Numbers are predicted and counted in these intervals.
const INTERVAL_SECS: f64 = 600.0;
const INTERVALS_OF_DAY: usize = 144;

/// The protocol of a comparison of flows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FlowsProtocol {
    /// Number of floors with different walks, at least 1.
    pub seeds: u64,
    /// The first seed; the others follow.
    pub first_seed: u64,
    /// Weeks that models learn, at least 1.
    pub weeks: usize,
    /// Weeks after these on which they are tested, at least 1.
    pub tested: usize,
}

/// Why a comparison of flows fails.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum FlowsError {
    /// A model cannot be trained.
    Train(#[from] CannotTrain),
    /// A route cannot be planned.
    Route(#[from] PlanRouteError),
    /// The floor is inconsistent.
    #[error("{0}")]
    Setting(String),
}

/// A model of flows that is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ComparedFlow {
    /// The mean of each cell, and its histogram of directions.
    Timeless,
    /// Periodic rates.
    Spectral,
}

impl ComparedFlow {
    /// Both, the baseline first.
    pub const ALL: [ComparedFlow; 2] = [ComparedFlow::Timeless, ComparedFlow::Spectral];

    /// The name of the robot in results.
    pub fn name(self) -> &'static str {
        match self {
            ComparedFlow::Timeless => "timeless",
            ComparedFlow::Spectral => "spectral",
        }
    }
}

/// The errors of a model on the test days of all seeds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FlowScore {
    /// Mean squared error of the number of detections in a cell and ten minutes.
    pub squared_error: f64,
    /// Mean log-likelihood of the direction of a detection, in nats.
    pub direction_nats: f64,
    /// By seed and working day, the same.
    days: Vec<FlowDay>,
}

/// The errors of one test day.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct FlowDay {
    squared: f64,
    cells: f64,
    nats: f64,
    detections: f64,
}

/// The results.
#[derive(Clone, Debug)]
pub struct FlowComparison {
    /// By [`ComparedFlow::ALL`].
    pub scores: Vec<FlowScore>,
    /// Two-sided p-value of the difference in squared errors, by day; none with too few days.
    pub count_p_value: Option<f64>,
    /// Two-sided p-value of the difference in log-likelihood, by day.
    pub direction_p_value: Option<f64>,
    /// By [`Crossing::ALL`].
    pub trips: Vec<TripTotals>,
}

/// Runs the comparison; `progress` receives the numbers of finished and of all seeds.
///
/// # Errors
/// [`FlowsError`].
pub fn run(protocol: &FlowsProtocol, progress: &(impl Fn(u64, u64) + Sync)) -> Result<FlowComparison, FlowsError> {
    let done = AtomicU64::new(0);
    let of_seed = |seed: u64| {
        let outcome = run_seed(seed, protocol)?;
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, protocol.seeds);
        Ok(outcome)
    };
    let seeds: Vec<u64> = (protocol.first_seed..protocol.first_seed.saturating_add(protocol.seeds)).collect();
    let outcomes: Vec<SeedOutcome> = seeds.into_par_iter().map(of_seed).collect::<Result<_, FlowsError>>()?;
    let scores: Vec<FlowScore> = (0..ComparedFlow::ALL.len())
        .map(|model| FlowScore::over(outcomes.iter().flat_map(|outcome| outcome.days[model].clone()).collect()))
        .collect();
    let mut trips = vec![TripTotals::default(); Crossing::ALL.len()];
    for outcome in &outcomes {
        trips.iter_mut().zip(&outcome.trips).for_each(|(sum, trips)| sum.add(trips));
    }
    let differ = |error_of: fn(&FlowDay) -> f64| {
        let differences: Vec<f64> =
            scores[0].days.iter().zip(&scores[1].days).map(|(one, other)| error_of(other) - error_of(one)).collect();
        paired::p_value(&differences)
    };
    let count_p_value = differ(|day| day.squared / day.cells);
    let direction_p_value = differ(|day| day.nats / day.detections.max(1.0));
    Ok(FlowComparison { scores, count_p_value, direction_p_value, trips })
}

impl FlowScore {
    fn over(days: Vec<FlowDay>) -> FlowScore {
        let sum = |part: fn(&FlowDay) -> f64| days.iter().map(part).sum::<f64>();
        let squared_error = sum(|day| day.squared) / sum(|day| day.cells).max(1.0);
        let direction_nats = sum(|day| day.nats) / sum(|day| day.detections).max(1.0);
        FlowScore { squared_error, direction_nats, days }
    }
}

/// The outcome of one seed.
struct SeedOutcome {
    /// By model, then by working day.
    days: Vec<Vec<FlowDay>>,
    trips: Vec<TripTotals>,
}

fn run_seed(seed: u64, protocol: &FlowsProtocol) -> Result<SeedOutcome, FlowsError> {
    let office = StreamOffice::new(seed);
    let floor = Floor::new()?;
    let learned = protocol.weeks as i64 * 7;
    let detections: Vec<FlowDetection> = (0..learned).flat_map(|day| detections(&office, day)).collect();
    let train = |order_max: usize| {
        let options = FlowOptions { order_max, ..FlowOptions::new(floor.raster()) };
        FlowModel::train(&detections, &Periodicities::default(), &options, StopSignal::NEVER)
    };
    let models = [train(0)?, train(tidemap_model::ORDER_MAX)?];
    let tested: Vec<i64> =
        (learned..learned + protocol.tested as i64 * 7).filter(|day| !office.walks(*day).is_empty()).collect();
    let days =
        models.iter().map(|model| tested.iter().map(|&day| score(model, &office, &floor, day)).collect()).collect();
    let mut trips = Vec::with_capacity(Crossing::ALL.len());
    for crossing in Crossing::ALL {
        let model = crossing.model().map(|model| &models[usize::from(model == ComparedFlow::Spectral)]);
        let mut totals = TripTotals::default();
        for &day in &tested {
            totals.add(&trips::of_day(model, &office, &floor, day)?);
        }
        trips.push(totals);
    }
    Ok(SeedOutcome { days, trips })
}

fn moment(day: i64, secs: f64) -> Moment {
    Moment { utc_nanos: START_NANOS + day * DAY_NANOS + (secs * 1e9) as i64, offset_secs: 0 }
}

fn detections(office: &StreamOffice, day: i64) -> Vec<FlowDetection> {
    let detected = office.detections(day).into_iter();
    detected
        .map(|seen| FlowDetection {
            moment: moment(day, seen.secs),
            place_m: seen.place_m,
            direction_rad: seen.direction_rad,
        })
        .collect()
}

/// The errors of a model on a day.
fn score(model: &FlowModel, office: &StreamOffice, floor: &Floor, day: i64) -> FlowDay {
    let options = model.options();
    let (raster, directions) = (options.raster, options.directions);
    let mut counts = vec![vec![0.0; raster.cells()]; INTERVALS_OF_DAY];
    let mut seen: Vec<Vec<(usize, usize)>> = vec![Vec::new(); INTERVALS_OF_DAY];
    for detection in office.detections(day) {
        let Some(cell) = raster.cell(detection.place_m) else { continue };
        let interval = ((detection.secs / INTERVAL_SECS) as usize).min(INTERVALS_OF_DAY - 1);
        counts[interval][cell] += 1.0;
        seen[interval].push((cell, options.direction(detection.direction_rad)));
    }
    let mut found = FlowDay::default();
    let nobody = model.unseen_per_sec() * directions as f64 * INTERVAL_SECS;
    for (interval, counts) in counts.iter().enumerate() {
        let mut expected = vec![nobody; raster.cells()];
        let mut shares = vec![Vec::new(); raster.cells()];
        for flow in model.at(moment(day, (interval as f64 + 0.5) * INTERVAL_SECS)) {
            expected[flow.cell] = flow.total_per_sec() * INTERVAL_SECS;
            shares[flow.cell] = flow.shares();
        }
        for cell in floor.open_cells() {
            found.squared += (expected[cell] - counts[cell]).powi(2);
            found.cells += 1.0;
        }
        for &(cell, direction) in &seen[interval] {
            let share = shares[cell].get(direction).copied().unwrap_or(1.0 / directions as f64);
            found.nats += share.ln();
            found.detections += 1.0;
        }
    }
    found
}
