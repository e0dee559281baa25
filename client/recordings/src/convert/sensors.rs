//! Scans and clouds in their places, each beam at its own time.
//!
//! Invariant: a beam without a return hits nothing. A scan or cloud is placed whole, or not at all.

use nalgebra::Isometry3;

use super::{Converter, Made, NotMade, PlacedCloud, PlacedScan, merged, motion::Motion};
use crate::{
    convert::CellSize,
    known::{Beam, Cloud, LaserScan, PointTimes},
    message::Value,
    plan::FrameChoice,
};

/// The beams of a scan are taken within this time, nanoseconds: a second, and what rounding adds to it.
const SCAN_NANOS_MAX: f64 = 1.001e9;

impl Converter {
    /// The pose of a sensor that has this pose within its frame, as [`Converter::pose`] gives it. Points that a program
    /// has put into a frame that does not move come from elsewhere.
    fn sensor_pose(&self, frame: &str, own: &Isometry3<f64>, stamp_nanos: i64) -> Result<Isometry3<f64>, NotMade> {
        let has_own = *own != Isometry3::identity();
        if !has_own && self.plan.choice == FrameChoice::Usual && self.plan.frame.as_deref() == Some(frame) {
            return Err(NotMade::NoSensor(frame.to_owned()));
        }
        let pose = self.pose(frame, stamp_nanos)?;
        Ok(if has_own { pose * own } else { pose })
    }

    /// Whether the beams of a sensor may have different poses.
    fn may_move(&self, frame: &str) -> bool {
        let within = self.plan.frame.as_deref();
        !self.options.at_header && within.is_some_and(|within| self.surveyed.frames.may_move(frame, within))
    }

    /// The motion of a sensor between two times after a stamp, in nanoseconds; absent if it stands still.
    fn motion(
        &self,
        (frame, own): (&str, &Isometry3<f64>),
        stamp: i64,
        span: [f64; 2],
        reach_m: f64,
    ) -> Result<Option<Motion>, NotMade> {
        Motion::between(stamp, span, reach_m, |nanos| self.sensor_pose(frame, own, nanos))
    }

    pub(super) fn scan(&mut self, index: usize, message: &Value<'_>, frame: &str, stamp: i64) -> Result<Made, NotMade> {
        let scan = LaserScan::read(message)?;
        let pose = self.sensor_pose(frame, &scan.pose, stamp)?;
        let beams = self.beams.entry(index).or_default();
        let ranges_m: Vec<f32> =
            scan.ranges_m().map(|range| taken_range(range, beams.count(scan.beam(range)))).collect();
        if ranges_m.iter().all(|range| range.is_nan()) {
            return Err(NotMade::Nothing("no beam of the scan has a reading"));
        }
        let increment_nanos = scan.time_increment_secs * 1e9;
        if increment_nanos != 0.0 && self.may_move(frame) {
            // NaN is not within the limit either.
            if (increment_nanos * scan.rays() as f64).abs() <= SCAN_NANOS_MAX {
                let hits = hits(&scan, &ranges_m);
                if let Some(cloud) = self.moved_scan(frame, stamp, increment_nanos, hits)? {
                    return Ok(Made::Cloud(cloud));
                }
            } else {
                self.beams.entry(index).or_default().wrong_times += 1;
            }
        }
        let LaserScan { angle_min_rad, angle_increment_rad, range_min_m, range_max_m, .. } = scan;
        Ok(Made::Scan(PlacedScan { pose, angle_min_rad, angle_increment_rad, range_min_m, range_max_m, ranges_m }))
    }

    /// The points where the beams of a scan have ended, if the sensor moved meanwhile.
    fn moved_scan(
        &self,
        frame: &str,
        stamp: i64,
        increment_nanos: f64,
        hits: Vec<(usize, [f64; 3])>,
    ) -> Result<Option<PlacedCloud>, NotMade> {
        let (Some((first, _)), Some((last, _))) = (hits.first(), hits.last()) else { return Ok(None) };
        let span = [*first, *last].map(|ray| ray as f64 * increment_nanos);
        let span = if increment_nanos < 0.0 { [span[1], span[0]] } else { span };
        let reach_m = hits.iter().map(|(_, [x, y, _])| x * x + y * y).fold(0.0, f64::max).sqrt();
        let Some(motion) = self.motion((frame, &Isometry3::identity()), stamp, span, reach_m)? else { return Ok(None) };
        let points_m: Vec<[f32; 3]> = hits
            .into_iter()
            .map(|(ray, point)| motion.moved(point, ray as f64 * increment_nanos).map(|along| along as f32))
            .collect();
        Ok(Some(PlacedCloud { pose: motion.pose(), points_before: points_m.len(), points_m }))
    }

    pub(super) fn cloud(
        &mut self,
        index: usize,
        message: &Value<'_>,
        frame: &str,
        stamp: i64,
    ) -> Result<Made, NotMade> {
        let cloud = Cloud::read(message)?;
        let pose = self.sensor_pose(frame, cloud.pose(), stamp)?;
        let times = if self.may_move(frame) { cloud.times(stamp) } else { (PointTimes::Absent, [0.0; 2]) };
        let motion = match times {
            (PointTimes::Known { factor, base }, span) => {
                let squares = |[x, y, z]: [f64; 3]| x * x + y * y + z * z;
                let returns = cloud.points().filter(Cloud::is_return);
                let reach_m = returns.map(squares).fold(0.0, f64::max).sqrt();
                self.motion((frame, cloud.pose()), stamp, span, reach_m)?.map(|motion| (motion, factor, base))
            }
            _ => None,
        };
        let merge = self.options.merge;
        let beams = self.beams.entry(index).or_default();
        if times.0 == PointTimes::Wrong {
            beams.wrong_times += 1;
        }
        let mut is_return = |point: &[f64; 3]| {
            let is_return = Cloud::is_return(point);
            beams.count(if is_return { Beam::Hit } else { Beam::NoReading });
            is_return
        };
        let placed = match motion {
            Some((motion, factor, base)) => {
                let returns = cloud.timed_points().filter(|(point, _)| is_return(point));
                let moved = returns.map(|(point, number)| motion.moved(point, number * factor - base));
                placed(moved, cloud.len(), motion.pose(), merge)
            }
            None => placed(cloud.points().filter(is_return), cloud.len(), pose, merge),
        };
        if placed.points_m.is_empty() {
            return Err(NotMade::Nothing("no beam of the cloud has a return"));
        }
        Ok(Made::Cloud(placed))
    }
}

/// The rays of a scan that have ended somewhere, with their ends in the frame of the sensor.
fn hits(scan: &LaserScan<'_>, ranges_m: &[f32]) -> Vec<(usize, [f64; 3])> {
    let ranges = ranges_m.iter().enumerate().filter(|(_, range)| range.is_finite());
    ranges
        .map(|(ray, range)| {
            let (sin, cos) = libm::sincos(scan.angle_min_rad + ray as f64 * scan.angle_increment_rad);
            (ray, [f64::from(*range) * cos, f64::from(*range) * sin, 0.0])
        })
        .collect()
}

fn placed(
    points: impl Iterator<Item = [f64; 3]>,
    points_max: usize,
    pose: Isometry3<f64>,
    merge: Option<CellSize>,
) -> PlacedCloud {
    let (points_m, points_before) = match merge {
        Some(cell) => merged::points(points, points_max, &pose, cell),
        None => {
            let points: Vec<[f32; 3]> = points.map(|point| point.map(|along| along as f32)).collect();
            let count = points.len();
            (points, count)
        }
    };
    PlacedCloud { pose, points_m, points_before }
}

/// A range as the grid takes it: infinity is no return, and NaN no reading.
fn taken_range(range_m: f64, beam: Beam) -> f32 {
    match beam {
        Beam::Hit => range_m as f32,
        Beam::NoReturn => f32::INFINITY,
        Beam::NoReading => f32::NAN,
    }
}
