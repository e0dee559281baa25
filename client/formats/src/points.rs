//! The points of a scan, in the frame of the sensor or the map, as PCD and PLY files contain them.
//!
//! Invariant: every stored point is finite; points with a coordinate that is not finite are counted and left out.

use nalgebra::Isometry3;

/// The points of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointFile {
    /// The points, in metres.
    pub points: Vec<[f32; 3]>,
    /// Number of points with a coordinate that is not a finite number: mostly rays without return.
    pub not_finite: u64,
    /// Pose of the sensor in the frame of the map, in metres; none if the file does not contain it.
    pub pose: Option<Isometry3<f64>>,
}

impl PointFile {
    /// An empty file with capacity for a number of points that the caller has checked against the file's length.
    pub(crate) fn with_capacity(points: u64, pose: Option<Isometry3<f64>>) -> Self {
        Self { points: Vec::with_capacity(usize::try_from(points).unwrap_or(0)), not_finite: 0, pose }
    }

    /// Adds a point.
    #[allow(clippy::cast_possible_truncation, reason = "coordinates beyond f32 become infinite and are left out")]
    pub(crate) fn push(&mut self, point: [f64; 3]) {
        let point = point.map(|coordinate| coordinate as f32);
        if point.iter().all(|coordinate| coordinate.is_finite()) {
            self.points.push(point);
        } else {
            self.not_finite += 1;
        }
    }
}
