//! Ray casting: determines the free and occupied cells of a grid from the readings of a range sensor.
//!
//! Cells along a ray are free, the cell of its end is occupied, cells beyond stay unchanged. Where rays of one scan
//! disagree on a cell, occupied wins. A beam without a return frees nothing, unless its sensor is known to mean that
//! the way is free: dark, shiny and distant surfaces return nothing either.
//!
//! A ray that grazes a wall passes cells of the wall just before its end. So the last [`GRAZING_CELLS`] cells of a ray
//! free no cell that shares a face with a cell in which another ray of the scan ends.
//!
//! Invariant: rays are traversed exactly (Amanatides and Woo 1987), cell by cell, and the number of steps is known
//! before the first step. The cost of a scan is bounded by its [`CastLimits`]; [`CastError`] reports an excess.

use nalgebra::{Isometry3, Vector3};

use crate::{
    index::TileIndex,
    mask::{Mask, TileMasks},
    scan::{HEIGHT_BAND_M, ScanSource},
    spec::GridSpec,
};

mod clip;
#[cfg(test)]
mod tests;
mod walk;

use walk::Walk;

/// Readings in the sensor's frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Rays {
    /// End points of rays: x, y, z of each end point, in metres. A point that is not finite is ignored.
    Points(Vec<f32>),
    /// Ranges in the sensor's x-y plane.
    Planar {
        /// Angle of the first ray from the x axis, radians.
        angle_min_rad: f64,
        /// Angle from one ray to the next, radians.
        angle_increment_rad: f64,
        /// Ranges in metres. NaN: no reading.
        ranges_m: Vec<f32>,
        /// The range of the sensor: a beam with this range or more, or with infinity, has no return.
        sensor_range_m: f32,
        /// Beams without a return free the cells up to this range; 0: they free nothing.
        free_range_m: f32,
    },
}

/// One scan of a range sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Readings {
    /// The transform map_from_sensor, in metres; finite.
    pub pose: Isometry3<f64>,
    /// Nearer readings are ignored; at least 0.
    pub min_range_m: f32,
    /// Farther readings only free the cells up to this range. `None`: no limit.
    pub max_range_m: Option<f32>,
    /// The rays.
    pub rays: Rays,
}

impl Readings {
    /// The source of the readings for a grid.
    #[must_use]
    pub fn source(&self, spec: &GridSpec) -> ScanSource {
        let above_m = if spec.is_flat { self.pose.translation.z - spec.origin_m[2] } else { 0.0 };
        // Heights beyond the range count as the last band.
        ScanSource::Rays { height: (above_m / HEIGHT_BAND_M).round() as i8 }
    }
}

/// The length, in cells, of the end of a ray that frees no cell beside the ends of other rays.
pub const GRAZING_CELLS: f64 = 8.0;

/// Limits of a cast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CastLimits {
    /// Cells of one ray, within the grid's extent.
    pub ray_cells: u64,
    /// Cells of all rays; a cell that several rays pass counts for each.
    pub cells: u64,
    /// Tiles that the rays pass.
    pub tiles: usize,
}

/// Why a scan exceeds the limits of a cast.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CastError {
    /// A ray is too long.
    #[error("ray {ray} passes {cells} cells, and one ray may pass {max}: send a max_range_m")]
    RayTooLong {
        /// The number of the ray, from 0.
        ray: usize,
        /// The number of cells that the ray passes.
        cells: u64,
        /// The maximum.
        max: u64,
    },
    /// The rays are too long all together.
    #[error("the rays pass more than the {max} cells that those of one scan may: send fewer points or a max_range_m")]
    TooManyCells {
        /// The maximum.
        max: u64,
    },
    /// The rays pass too many tiles.
    #[error("the rays pass more than the {max} tiles that one scan may show: send a max_range_m")]
    TooManyTiles {
        /// The maximum.
        max: usize,
    },
}

/// Casts readings into the grid. Returns the tiles that the rays pass, ascending, with their masks; the result is empty
/// if no reading is valid or all lie outside the extent. A flat grid ignores heights.
///
/// # Errors
/// [`CastError`] where a limit is exceeded.
pub fn cast(
    spec: &GridSpec,
    readings: &Readings,
    limits: CastLimits,
) -> Result<Vec<(TileIndex, TileMasks)>, CastError> {
    let mut walk = Walk::new(spec, readings.pose.translation.vector.into(), limits);
    let rotation = readings.pose.rotation.to_rotation_matrix();
    let turn = |point: [f64; 3]| <[f64; 3]>::from(rotation * Vector3::from(point));
    let min = f64::from(readings.min_range_m);
    let max = readings.max_range_m.map_or(f64::INFINITY, f64::from);
    match &readings.rays {
        Rays::Points(xyz) => {
            for (ray, point) in xyz.as_chunks::<3>().0.iter().enumerate() {
                let point = point.map(f64::from);
                let range = point.iter().map(|along| along * along).sum::<f64>().sqrt();
                // The reading is not finite or too near.
                if !(range >= min && range < f64::INFINITY) {
                    continue;
                }
                let is_hit = range <= max;
                let point = if is_hit { point } else { point.map(|along| along * (max / range)) };
                walk.ray(ray, turn(point), is_hit)?;
            }
        }
        Rays::Planar { angle_min_rad, angle_increment_rad, ranges_m, sensor_range_m, free_range_m } => {
            for (ray, &range) in ranges_m.iter().enumerate() {
                let range = f64::from(range);
                if range.is_nan() || range < min {
                    continue;
                }
                let has_return = range < f64::from(*sensor_range_m);
                let range = if has_return { range } else { f64::from(*free_range_m) };
                if !has_return && range <= 0.0 {
                    continue;
                }
                let (is_hit, range) = (has_return && range <= max, range.min(max));
                let (sin, cos) = libm::sincos(angle_min_rad + ray as f64 * angle_increment_rad);
                walk.ray(ray, turn([range * cos, range * sin, 0.0]), is_hit)?;
            }
        }
    }
    Ok(walk.into_tiles())
}

/// The cells of one tile that rays have passed so far.
#[derive(Clone, Copy, Debug, Default)]
struct Tile {
    index: TileIndex,
    free: Mask,
    /// Cells that rays passed shortly before their ends.
    grazed: Mask,
    /// The last cells that rays passed before the cells of their ends.
    last: Mask,
    occupied: Mask,
}

/// The parts of a ray that ends in a cell.
#[derive(Clone, Copy, Debug)]
enum RayPart {
    Way,
    Grazing,
    Last,
}

impl Tile {
    /// The mask of the cells that this part of rays has passed.
    fn passed(&mut self, part: RayPart) -> &mut [u64; 8] {
        match part {
            RayPart::Way => &mut self.free.0,
            RayPart::Grazing => &mut self.grazed.0,
            RayPart::Last => &mut self.last.0,
        }
    }
}
