//! A scan: points in the frame of the sensor or the map, as PCD and PLY files have them.
//!
//! Invariant: every point kept is finite; a point of which any coordinate is not finite is counted and left out.

/// The points of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointFile {
    /// The points, in metres.
    pub points: Vec<[f32; 3]>,
    /// How many points were left out because a coordinate is not a finite number: rays without return, mostly.
    pub not_finite: u64,
    /// Where the sensor was; none where the file does not say.
    pub pose: Option<Pose>,
}

/// A place and a direction in the frame of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Where, in metres.
    pub position_m: [f64; 3],
    /// The turn, as a unit quaternion, its scalar part last.
    pub quaternion_xyzw: [f64; 4],
}

impl PointFile {
    /// Room for so many points, which the caller has held against the file's length.
    pub fn with_room(points: u64, pose: Option<Pose>) -> Self {
        Self { points: Vec::with_capacity(usize::try_from(points).unwrap_or(0)), not_finite: 0, pose }
    }

    /// Takes a point.
    #[allow(clippy::cast_possible_truncation, reason = "what does not fit becomes infinite and is left out")]
    pub fn push(&mut self, point: [f64; 3]) {
        let point = point.map(|coordinate| coordinate as f32);
        if point.iter().all(|coordinate| coordinate.is_finite()) {
            self.points.push(point);
        } else {
            self.not_finite += 1;
        }
    }
}
