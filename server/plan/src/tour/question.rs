//! The request of a tour, and its candidates.
//!
//! Invariant: a request that [`TourQuestion::check`] accepts can be planned.

use tidemap_grid::index::CellIndex;
use tidemap_map::reachability::Reachability;
use tidemap_model::EarlyStop;

use crate::{
    predicted::PredictedGrid,
    travel::{Column, Distances, InvalidTravel, TravelGrid, TravelOptions},
    view::{InvalidSensor, InvalidThreshold, Scene, SceneOptions, Sensor},
};

/// A viewpoint candidate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TourCandidate {
    pub column: Column,
    pub cell: CellIndex,
    pub at_m: [f64; 2],
    /// Probability of reaching the candidate, above 0.
    pub reachability: f64,
}

/// Maximum number of goals of a tour.
pub const GOALS_MAX: usize = 100;

/// Maximum number of points of the candidates' grid, free or not.
const CANDIDATES_MAX: usize = 100_000;

/// Maximum distance from the start to the nearest free place for the robot's centre, metres: chargers stand at walls.
pub const START_TOLERANCE_M: f64 = 0.5;

/// The end of a tour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TourEnd {
    /// The tour ends at the start, for example at a charger.
    #[default]
    Start,
    /// The tour ends at its last goal.
    LastGoal,
}

/// The request of a tour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TourQuestion {
    /// Position at which the robot starts, x and y in the map's frame, metres.
    pub start_m: [f64; 2],
    /// Number of goals, 1 to [`GOALS_MAX`]. Default 6 (RA-L, section III.E).
    pub goals: usize,
    /// Distance of neighbouring candidates along x and y, metres, at least one cell. Default 1.
    pub spacing_m: f64,
    /// The sensor at each goal.
    pub sensor: Sensor,
    /// The direction of the sensor's view, radians; without effect for an all-around sensor.
    pub yaw_rad: f64,
    /// The options of views.
    pub scene: SceneOptions,
    /// The options of driving.
    pub travel: TravelOptions,
    /// The end of the tour.
    pub end: TourEnd,
    /// Speed of the robot, metres a second, above 0. Default 0.5.
    pub speed_m_per_s: f64,
    /// Duration of the observation at each goal, seconds, at least 0. Default 60.
    pub observation_secs: f64,
    /// Time limit of the tour, seconds, at least 0; goals that do not fit are omitted. `None`: no limit.
    pub budget_secs: Option<f64>,
}

impl Default for TourQuestion {
    fn default() -> TourQuestion {
        TourQuestion {
            start_m: [0.0; 2],
            goals: 6,
            spacing_m: 1.0,
            sensor: Sensor::default(),
            yaw_rad: 0.0,
            scene: SceneOptions::default(),
            travel: TravelOptions::default(),
            end: TourEnd::default(),
            speed_m_per_s: 0.5,
            observation_secs: 60.0,
            budget_secs: None,
        }
    }
}

/// The reason why the request of a tour is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum TourError {
    /// A number is out of range.
    #[error("{what} {value}: it must be {right}")]
    Number { what: &'static str, value: f64, right: &'static str },
    /// The start lies outside the predicted region.
    #[error("start ({x_m}, {y_m}) m lies outside the region of interest, or the sensor at {z_m} m does")]
    Outside { x_m: f64, y_m: f64, z_m: f64 },
    /// The grid of candidates is too fine for its region.
    #[error(
        "a spacing of {spacing_m} m gives {candidates:.0} candidates, at most {CANDIDATES_MAX} are allowed: use a wider \
         spacing or a smaller region"
    )]
    TooManyCandidates { spacing_m: f64, candidates: f64 },
    /// The sensor is invalid.
    #[error(transparent)]
    Sensor(#[from] InvalidSensor),
    /// The rays are for another sensor, yaw or size of region.
    #[error("the rays were made for another sensor, another yaw or a region of another size: create them again")]
    OtherFan,
    /// The options of driving are invalid.
    #[error(transparent)]
    Travel(#[from] InvalidTravel),
    /// The threshold is invalid.
    #[error(transparent)]
    Threshold(#[from] InvalidThreshold),
    /// The work received the signal to stop.
    #[error(transparent)]
    Stop(#[from] EarlyStop),
}

impl TourQuestion {
    pub(super) fn check(&self, grid: &PredictedGrid) -> Result<(), TourError> {
        let lattice = grid.lattice();
        let number = |what, value, is_right, right| {
            if is_right { Ok(()) } else { Err(TourError::Number { what, value, right }) }
        };
        let is_length = |metres: f64| metres >= 0.0 && metres.is_finite();
        let right = "a finite number, at least 0";
        let goals = self.goals as f64;
        number("goals", goals, (1..=GOALS_MAX).contains(&self.goals), "between 1 and 100")?;
        let is_wide = self.spacing_m.is_finite() && self.spacing_m >= lattice.resolution_m();
        number("spacing in metres", self.spacing_m, is_wide, "finite, and at least the length of a cell")?;
        number("yaw in radians", self.yaw_rad, self.yaw_rad.is_finite(), "finite")?;
        let speed = self.speed_m_per_s;
        number("speed in metres a second", speed, speed.is_finite() && speed >= 1e-6, "finite, and at least 0.000001")?;
        number("seconds at each goal", self.observation_secs, is_length(self.observation_secs), right)?;
        if let Some(budget) = self.budget_secs {
            number("seconds for the tour", budget, is_length(budget), right)?;
        }
        self.sensor.check(lattice)?;
        let ([x_m, y_m], z_m) = (self.start_m, self.sensor.height_m);
        if lattice.cell_at([x_m, y_m, z_m]).is_none() {
            return Err(TourError::Outside { x_m, y_m, z_m });
        }
        let [columns, rows] = self.points(grid);
        let candidates = columns * rows;
        if candidates > CANDIDATES_MAX as f64 {
            return Err(TourError::TooManyCandidates { spacing_m: self.spacing_m, candidates });
        }
        Ok(())
    }

    /// Number of points of the candidates' grid along x and y: the remainder is split between both sides; at least one
    /// point.
    fn points(&self, grid: &PredictedGrid) -> [f64; 2] {
        let lattice = grid.lattice();
        let [width, depth, _] = lattice.size();
        [width, depth].map(|cells| (cells as f64 * lattice.resolution_m() / self.spacing_m + 1e-9).floor().max(1.0))
    }

    /// The reachable candidates, by y, then x.
    pub(super) fn candidates(
        &self,
        scene: &Scene,
        travel: &TravelGrid,
        from_start: &Distances,
        grid: &PredictedGrid,
        reachability: &Reachability,
    ) -> Vec<TourCandidate> {
        let lattice = scene.lattice();
        let [columns, rows] = self.points(grid);
        let spacing = self.spacing_m / lattice.resolution_m();
        let along = |number: usize, points: f64, size: usize| {
            let at = (size as f64 - points * spacing) / 2.0 + (number as f64 + 0.5) * spacing;
            (at.max(0.0) as usize).min(size - 1)
        };
        let [width, depth] = travel.size();
        let height = |[x_m, y_m]: [f64; 2]| lattice.cell_at([x_m, y_m, self.sensor.height_m]);
        let at = |column: usize, row: usize| {
            let column = Column { x: along(column, columns, width), y: along(row, rows, depth) };
            from_start.to(column)?;
            let at_m = travel.centre_m(column);
            let cell: CellIndex = height(at_m).filter(|&cell| !scene.is_occupied(cell))?;
            let reachability = reachability.rate(at_m[0], at_m[1]).rate;
            (reachability > 0.0).then_some(TourCandidate { column, cell, at_m, reachability })
        };
        let columns = columns as usize;
        (0..rows as usize).flat_map(|row| (0..columns).filter_map(move |column| at(column, row))).collect()
    }
}
