//! Point clouds and planar scans: checks.
//!
//! Invariant: the returned readings have a pose with a unit quaternion in the frame of the map, valid ranges, and at
//! least one finite reading.

use nalgebra::Isometry3;
use tidemap_grid::{
    raycast::{Rays, Readings},
    spec::GridSpec,
};
use tidemap_map::ids::RefusalReason;

use super::ScanRefusal;
use crate::{convert::grid::pose_from_wire, v1};

/// Maximum length of a frame name in a message.
const FRAME_SHOWN: usize = 60;

/// Readings of a point cloud.
pub(super) fn cloud(spec: &GridSpec, cloud: v1::PointCloud) -> Result<Readings, ScanRefusal> {
    let v1::PointCloud { pose, frame_id, xyz_m, min_range_m, max_range_m } = cloud;
    let pose = posed(spec, &frame_id, pose)?;
    let (points, rest) = xyz_m.as_chunks::<3>();
    if !rest.is_empty() {
        let text = format!("xyz_m: {} entries are not x, y, z of each point", xyz_m.len());
        return Err(ScanRefusal::malformed(text));
    }
    let min_range_m = least(min_range_m)?;
    if !(0.0..f32::INFINITY).contains(&max_range_m) {
        return Err(ScanRefusal::malformed(format!("max_range_m {max_range_m}: it must be finite and at least 0")));
    }
    if !points.iter().any(|point| point.iter().all(|along| along.is_finite())) {
        return Err(empty(format!("none of the {} points is finite", points.len())));
    }
    let max_range_m = (max_range_m > 0.0).then_some(max_range_m);
    Ok(Readings { pose, min_range_m, max_range_m, rays: Rays::Points(xyz_m) })
}

/// Readings of a planar scan.
pub(super) fn ranges(spec: &GridSpec, scan: v1::RangeScan) -> Result<Readings, ScanRefusal> {
    let v1::RangeScan { pose, frame_id, angle_min_rad, angle_increment_rad, ranges_m, .. } = scan;
    let v1::RangeScan { min_range_m, max_range_m, free_range_m, trusted_range_m, .. } = scan;
    let pose = posed(spec, &frame_id, pose)?;
    for (field, angle) in [("angle_min_rad", angle_min_rad), ("angle_increment_rad", angle_increment_rad)] {
        if !angle.is_finite() {
            return Err(ScanRefusal::malformed(format!("{field} {angle} is not a finite number")));
        }
    }
    let min_range_m = least(min_range_m)?;
    if !(max_range_m > 0.0 && max_range_m.is_finite()) {
        return Err(ScanRefusal::malformed(format!("max_range_m {max_range_m}: it must be finite and above 0")));
    }
    for (field, range) in [("free_range_m", free_range_m), ("trusted_range_m", trusted_range_m)] {
        if !(0.0..f32::INFINITY).contains(&range) {
            return Err(ScanRefusal::malformed(format!("{field} {range}: it must be finite and at least 0")));
        }
    }
    if ranges_m.iter().all(|range| range.is_nan()) {
        return Err(empty(format!("none of the {} ranges is a number", ranges_m.len())));
    }
    let (angle_min_rad, angle_increment_rad) = (f64::from(angle_min_rad), f64::from(angle_increment_rad));
    let trusted_m = if trusted_range_m > 0.0 { trusted_range_m.min(max_range_m) } else { max_range_m };
    let (sensor_range_m, free_range_m) = (max_range_m, free_range_m.min(max_range_m));
    let rays = Rays::Planar { angle_min_rad, angle_increment_rad, ranges_m, sensor_range_m, free_range_m };
    Ok(Readings { pose, min_range_m, max_range_m: Some(trusted_m), rays })
}

fn posed(spec: &GridSpec, frame_id: &str, pose: Option<v1::Pose>) -> Result<Isometry3<f64>, ScanRefusal> {
    if !frame_id.is_empty() && frame_id != spec.frame_id {
        let frame_id: String = frame_id.chars().take(FRAME_SHOWN).collect();
        let own: String = spec.frame_id.chars().take(FRAME_SHOWN).collect();
        let detail = format!("the scan is in frame {frame_id:?}, and the map in {own:?}");
        return Err(ScanRefusal { reason: RefusalReason::Frame, detail });
    }
    pose_from_wire("pose", pose).map_err(|error| ScanRefusal::malformed(error.to_string()))
}

fn least(min_range_m: f32) -> Result<f32, ScanRefusal> {
    if (0.0..f32::INFINITY).contains(&min_range_m) {
        return Ok(min_range_m);
    }
    Err(ScanRefusal::malformed(format!("min_range_m {min_range_m}: it must be finite and at least 0")))
}

fn empty(detail: String) -> ScanRefusal {
    ScanRefusal { reason: RefusalReason::Empty, detail }
}
