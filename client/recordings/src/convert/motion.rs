//! The motion of a sensor while it scans.
//!
//! Invariant: the number of poses that are looked up is bounded, whatever the number of beams. Between two of them a
//! point moves along a line.

use nalgebra::Isometry3;

use super::NotMade;

/// A sensor that moves no point further than this stands still, metres.
const STILL_M: f64 = 0.005;
/// Poses are looked up until a point between two of them is off by no more than this, metres, or they are as close in
/// time as this, nanoseconds.
const EXACT_M: f64 = 0.001;
const STEP_NANOS_MIN: f64 = 1e6;
/// The first number of steps.
const STEPS: usize = 4;

/// A rotation, row by row, each row with its part of the translation.
type PoseRows = [[f64; 4]; 3];

/// The poses of a sensor over a short time.
#[derive(Debug)]
pub(super) struct Motion {
    /// The pose in the middle of that time.
    pose: Isometry3<f64>,
    first_nanos: f64,
    steps_per_nano: f64,
    /// The poses, as seen from that in the middle, evenly in time.
    poses: Vec<PoseRows>,
}

impl Motion {
    /// Looks up the poses between two times, given in nanoseconds after a stamp. `reach_m`: the distance of the
    /// farthest point from the sensor. Absent if the sensor stands still.
    ///
    /// # Errors
    /// The first error of the lookup.
    pub(super) fn between(
        stamp_nanos: i64,
        [first_nanos, last_nanos]: [f64; 2],
        reach_m: f64,
        pose_at: impl Fn(i64) -> Result<Isometry3<f64>, NotMade>,
    ) -> Result<Option<Self>, NotMade> {
        let length_nanos = last_nanos - first_nanos;
        let pose_of = |step: usize, steps: usize| {
            let elapsed = first_nanos + length_nanos * step as f64 / steps as f64;
            pose_at(stamp_nanos.saturating_add(elapsed.round() as i64))
        };
        let mut steps = STEPS;
        let pose = pose_of(STEPS / 2, STEPS)?;
        let inverse = pose.inverse();
        let row_of = |step: usize, steps: usize| pose_of(step, steps).map(|pose| rows(&(inverse * pose)));
        let mut poses = (0..=steps).map(|step| row_of(step, steps)).collect::<Result<Vec<PoseRows>, _>>()?;
        loop {
            let between =
                (0..steps).map(|step| row_of(2 * step + 1, 2 * steps)).collect::<Result<Vec<PoseRows>, _>>()?;
            let off = |((before, after), between): ((&PoseRows, &PoseRows), &PoseRows)| {
                distance(&mixed(before, after, 0.5), between, reach_m)
            };
            let off_m = poses.iter().zip(poses.iter().skip(1)).zip(&between).map(off).fold(0.0, f64::max);
            let last = poses.last().copied();
            poses = poses.iter().zip(&between).flat_map(|(at, between)| [*at, *between]).chain(last).collect();
            steps *= 2;
            if off_m <= EXACT_M || length_nanos / steps as f64 <= STEP_NANOS_MIN {
                break;
            }
        }
        let first = poses.first().copied().unwrap_or_default();
        if poses.iter().all(|pose| distance(pose, &first, reach_m) <= STILL_M) {
            return Ok(None);
        }
        Ok(Some(Self { pose, first_nanos, steps_per_nano: steps as f64 / length_nanos, poses }))
    }

    /// The pose in which [`Motion::moved`] gives points.
    pub(super) fn pose(&self) -> Isometry3<f64> {
        self.pose
    }

    /// A point that the sensor saw at a time, as the sensor would have seen it from the pose in the middle.
    pub(super) fn moved(&self, point: [f64; 3], nanos: f64) -> [f64; 3] {
        let at = ((nanos - self.first_nanos) * self.steps_per_nano).clamp(0.0, (self.poses.len() - 1) as f64);
        let step = (at as usize).min(self.poses.len().saturating_sub(2));
        let (Some(before), Some(after)) = (self.poses.get(step), self.poses.get(step + 1)) else { return point };
        let [x, y, z] = point;
        mixed(before, after, at - step as f64).map(|[a, b, c, d]| a * x + b * y + c * z + d)
    }
}

fn rows(pose: &Isometry3<f64>) -> PoseRows {
    let (turn, shift) = (pose.rotation.to_rotation_matrix(), pose.translation.vector);
    [0, 1, 2].map(|row| [turn[(row, 0)], turn[(row, 1)], turn[(row, 2)], shift[row]])
}

fn mixed(before: &PoseRows, after: &PoseRows, share: f64) -> PoseRows {
    let mut mixed = *before;
    for (row, after) in mixed.iter_mut().zip(after) {
        for (number, after) in row.iter_mut().zip(after) {
            *number += (after - *number) * share;
        }
    }
    mixed
}

/// How far two poses put a point apart that is as far as this from the sensor, at most, metres.
fn distance(one: &PoseRows, other: &PoseRows, reach_m: f64) -> f64 {
    let (mut turn, mut shift) = (0.0, 0.0);
    for (one, other) in one.iter().zip(other) {
        let [a, b, c, d] = [0, 1, 2, 3].map(|column| (one[column] - other[column]).powi(2));
        turn += a + b + c;
        shift += d;
    }
    turn.sqrt() * reach_m + shift.sqrt()
}
