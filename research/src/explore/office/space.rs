//! The office as a grid: its cells, and the truth at a time.
//!
//! Invariant: cells are numbered as in [`ExploredOffice::occupied`].

use std::{f64::consts::TAU, sync::Arc};

use tidemap_grid::{
    index::{CellBox, CellIndex},
    spec::{Evidence, GridSpec, Retention},
};
use tidemap_map::{name::MapName, spec::MapSpec};
use tidemap_model::{Periodicities, Zone};
use tidemap_plan::{
    predicted::{CELLS_MAX, Lattice, PredictedGrid},
    tour::TourQuestion,
    view::{Fan, Scene, Sensor},
};
use tidemap_sim::ExploredOffice;

use super::OfficeError;

/// Nanoseconds of a day.
pub(super) const DAY_NANOS: i64 = 86_400_000_000_000;
/// Midnight before the first day, which is a Monday: 2025-03-03 UTC.
pub(super) const START_NANOS: i64 = 20_150 * DAY_NANOS;
/// Harmonics of a day (RA-L 2016, section III.B.1).
const HARMONICS: u32 = 24;

/// The office as a grid.
pub(super) struct Space<'a> {
    office: &'a ExploredOffice,
    lattice: Arc<Lattice>,
    spec: Arc<MapSpec>,
    /// The parameters of every tour.
    pub question: TourQuestion,
    /// The rays of the sensor.
    pub fan: Fan,
}

/// The true state of the office at a time.
pub(super) struct Truth {
    cells: Vec<bool>,
    /// The truth as a certain prediction.
    pub grid: PredictedGrid,
    /// The truth as a scene for the sensor.
    pub scene: Scene,
}

impl Truth {
    /// Whether the cell with this number is occupied.
    pub(super) fn is_occupied(&self, cell: usize) -> bool {
        self.cells[cell]
    }
}

impl<'a> Space<'a> {
    /// An office as a grid, for tours with this number of goals.
    pub(super) fn new(office: &'a ExploredOffice, goals: usize) -> Result<Self, OfficeError> {
        let [x, y, z] = office.size().map(|cells| cells as i32);
        let extent = CellBox { min: CellIndex::default(), max: CellIndex { x, y, z } };
        let grid =
            GridSpec { extent: Some(extent), evidence: Evidence::Readings, ..GridSpec::new(ExploredOffice::CELL_M) };
        let lattice = Arc::new(Lattice::new(&grid, extent, CELLS_MAX)?);
        let spec = Arc::new(MapSpec {
            zone: Zone::named("UTC").map_err(OfficeError::setting)?,
            periodicities: Periodicities::harmonics(DAY_NANOS, HARMONICS).map_err(OfficeError::setting)?,
            created_nanos: START_NANOS,
            retention: Retention::None,
            grid: Some(grid),
            ..MapSpec::new(MapName::new("office").map_err(OfficeError::setting)?)
        });
        // 360° x 90° within 4 m; two minutes at each goal, the drive included (RA-L, sections III.E and H).
        let sensor = Sensor { horizontal_fov_rad: TAU, ..Sensor::default() };
        let question = TourQuestion { start_m: office.charger_m(), goals, sensor, ..TourQuestion::default() };
        let fan = Fan::new(&question.sensor, &lattice, 0.0).map_err(OfficeError::setting)?;
        Ok(Self { office, lattice, spec, question, fan })
    }

    /// The specification of the explorers' maps.
    pub(super) fn spec(&self) -> &Arc<MapSpec> {
        &self.spec
    }

    /// The lattice of the cells.
    pub(super) fn lattice(&self) -> &Arc<Lattice> {
        &self.lattice
    }

    /// Number of cells.
    pub(super) fn cells(&self) -> usize {
        self.office.size().iter().product()
    }

    /// The number of a cell of the office.
    pub(super) fn number(&self, cell: CellIndex) -> usize {
        let [width, depth, _] = self.office.size();
        (cell.z as usize * depth + cell.y as usize) * width + cell.x as usize
    }

    /// The cell with a number.
    pub(super) fn cell(&self, number: usize) -> CellIndex {
        let [width, depth, _] = self.office.size();
        CellIndex { x: (number % width) as i32, y: (number / width % depth) as i32, z: (number / width / depth) as i32 }
    }

    /// The truth at a time, nanoseconds UTC.
    pub(super) fn truth(&self, utc_nanos: i64) -> Result<Truth, OfficeError> {
        let cells = self.occupied(utc_nanos);
        let occupied = |cell| Some(f32::from(u8::from(cells[self.number(cell)])));
        let grid = PredictedGrid::from_fn(Arc::clone(&self.lattice), occupied);
        let scene = Scene::new(&grid, &self.question.scene).map_err(OfficeError::setting)?;
        Ok(Truth { cells, grid, scene })
    }

    /// Whether each cell is occupied at a time, nanoseconds UTC, by number.
    pub(super) fn occupied(&self, utc_nanos: i64) -> Vec<bool> {
        self.office.occupied((utc_nanos - START_NANOS) / 1_000_000_000)
    }
}
