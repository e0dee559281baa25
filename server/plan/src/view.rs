//! Views: the cells visible from a place, and their expected information (RA-L, section III.C).
//!
//! The viewpoint counts as the centre of its cell. Rays leave it in fixed directions ([`Fan`]): rows of equal
//! elevation, and equal azimuths in each row, so that neighbouring rays are at most one cell apart at full range. A ray
//! passes from cell to cell through faces, as long as it enters them within its range; at an exact edge it crosses
//! along x first, then y, then z. It ends in the first cell that is probably occupied (probability above the
//! threshold), which is visible, and at the end of the region. Unknown cells count as 0.5. In a flat grid rays lie in
//! the plane. The information is the sum over the visible cells, each once.
//!
//! Invariant: the same request gives the same result, bit by bit, for any number of threads.

use tidemap_grid::index::CellIndex;

use crate::predicted::Lattice;

mod fan;
mod group;
mod many;
mod scene;
mod timed;

#[cfg(test)]
mod tests;

pub use fan::Fan;
pub(crate) use group::{GROUP_MAX, GroupScorer};
pub use many::{TooMuchWork, ViewLimits, view_many};
pub use scene::{InvalidThreshold, Scene, SceneError, SceneOptions, ViewGain, ViewScorer};
pub use timed::{TimedScene, TimedViewScorer};

/// Maximum number of cells along all rays of a sensor, counted per ray.
pub const RAY_CELLS_MAX: f64 = 3e7;
/// Number of nodes of a tree of rays between two checks of the stop signal.
const NODES_PER_CHECK: usize = 1 << 14;
/// The longest range in cells.
pub(crate) const RANGE_CELLS_MAX: f64 = 4096.0;

/// The field of view of a robot's sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Range, metres, above 0.
    pub range_m: f64,
    /// Width of the field of view, radians, above 0; 2π and more means all around, for any yaw.
    pub horizontal_fov_rad: f64,
    /// Height of the field of view, half of it above the horizon, radians, in (0, π]. Without effect in a flat grid.
    pub vertical_fov_rad: f64,
    /// Default z of the sensor in the map's frame, metres, if the viewpoint has none. Without effect in a flat grid.
    pub height_m: f64,
}

impl Default for Sensor {
    /// A sweep of 360° x 90° with a radius of 4 m (RA-L, section III.H), 1.7 m above the map's origin.
    fn default() -> Sensor {
        Sensor {
            range_m: 4.0,
            horizontal_fov_rad: std::f64::consts::TAU,
            vertical_fov_rad: std::f64::consts::FRAC_PI_2,
            height_m: 1.7,
        }
    }
}

/// The reason why a sensor is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum InvalidSensor {
    /// The range is out of range.
    #[error("range {range_m} m: it must be above 0 and at most {max_m} m on this grid")]
    Range { range_m: f64, max_m: f64 },
    /// The field of view is too narrow, or not a number.
    #[error("horizontal field of view {0} rad: it must be above 0; 2π is all around")]
    HorizontalFov(f64),
    /// The field of view is too low, too high, or not a number.
    #[error("vertical field of view {0} rad: it must be above 0 and at most π")]
    VerticalFov(f64),
    /// The height is not a number.
    #[error("sensor height {0} m: it must be finite")]
    Height(f64),
    /// The rays would pass too many cells.
    #[error(
        "the rays of this sensor pass {cells:.0} cells, at most {max:.0} are allowed: shorten its range \
         or narrow its view"
    )]
    TooFine { cells: f64, max: f64 },
}

impl Sensor {
    /// Checks every field for a grid with cells of this size.
    ///
    /// # Errors
    /// [`InvalidSensor`] with the invalid value and the valid range.
    pub fn check(&self, lattice: &Lattice) -> Result<(), InvalidSensor> {
        let max_m = RANGE_CELLS_MAX * lattice.resolution_m();
        if !(self.range_m > 0.0 && self.range_m <= max_m) {
            return Err(InvalidSensor::Range { range_m: self.range_m, max_m });
        }
        if self.horizontal_fov_rad.is_nan() || self.horizontal_fov_rad <= 0.0 {
            return Err(InvalidSensor::HorizontalFov(self.horizontal_fov_rad));
        }
        if !(self.vertical_fov_rad > 0.0 && self.vertical_fov_rad <= std::f64::consts::PI) {
            return Err(InvalidSensor::VerticalFov(self.vertical_fov_rad));
        }
        if !self.height_m.is_finite() {
            return Err(InvalidSensor::Height(self.height_m));
        }
        Ok(())
    }

    /// Whether the field of view is all around.
    #[must_use]
    pub(crate) fn is_all_around(&self) -> bool {
        self.horizontal_fov_rad >= std::f64::consts::TAU
    }
}

/// A viewpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Viewpoint {
    /// The x coordinate in the map's frame, metres.
    pub x_m: f64,
    /// The y coordinate in the map's frame, metres.
    pub y_m: f64,
    /// The z coordinate in the map's frame, metres; `None`: the sensor's height. Without effect in a flat grid.
    pub z_m: Option<f64>,
    /// The direction of the middle of the field of view, from the map's x axis to its y axis, radians. Without effect
    /// for an all-around sensor.
    pub yaw_rad: f64,
}

/// The reason why a viewpoint is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum ViewError {
    /// A coordinate or the yaw is not a number.
    #[error(
        "viewpoint ({}, {}, {:?}) m with yaw {} rad: its numbers must be finite",
        .0.x_m, .0.y_m, .0.z_m, .0.yaw_rad
    )]
    NotFinite(Viewpoint),
    /// The place lies outside the predicted region.
    #[error("viewpoint ({x_m}, {y_m}, {z_m}) m lies outside the region of interest")]
    Outside { x_m: f64, y_m: f64, z_m: f64 },
    /// The place is probably occupied.
    #[error(
        "viewpoint ({x_m}, {y_m}) m lies in cell ({}, {}, {}), which is probably occupied",
        .cell.x, .cell.y, .cell.z
    )]
    Occupied { x_m: f64, y_m: f64, cell: CellIndex },
}

impl Viewpoint {
    /// The cell that contains the viewpoint.
    ///
    /// # Errors
    /// [`ViewError::NotFinite`] and [`ViewError::Outside`]
    pub fn cell(&self, sensor: &Sensor, lattice: &Lattice) -> Result<CellIndex, ViewError> {
        let z_m = self.z_m.unwrap_or(sensor.height_m);
        if ![self.x_m, self.y_m, z_m, self.yaw_rad].iter().all(|number| number.is_finite()) {
            return Err(ViewError::NotFinite(*self));
        }
        let outside = ViewError::Outside { x_m: self.x_m, y_m: self.y_m, z_m };
        lattice.cell_at([self.x_m, self.y_m, z_m]).ok_or(outside)
    }
}
