//! Scans of a grid as callers give them: tiles, point clouds, ranges.
//!
//! Invariant: a scan is sent as it was given; whether it makes sense on the map is the daemon's to say.

pub use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use tidemap_map::grid::{index::TileIndex, mask::TileMasks};
use tidemap_proto::convert::grid::pose_to_wire;
use tidemap_proto::v1::{self, scan::Content};

/// Bytes that a scan takes on the wire beside its points, masks and flips, at most.
const FRAME_BYTES: usize = 256;

/// Points in the sensor's frame, ray-cast by the daemon.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// Where the sensor was.
    pub pose: Isometry3<f64>,
    /// The frame that the pose leads to; empty: the map's.
    pub frame_id: String,
    /// x, y, z of each point.
    pub xyz_m: Vec<f32>,
    /// Nearer points are left out.
    pub min_range_m: f32,
    /// Farther points only say that the way is free up to this range; 0: no limit but the daemon's.
    pub max_range_m: f32,
}

/// A scan of a planar range finder, ray-cast by the daemon.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RangeScan {
    /// Where the sensor was.
    pub pose: Isometry3<f64>,
    /// The frame that the pose leads to; empty: the map's.
    pub frame_id: String,
    /// Angle of the first ray from the sensor's x axis.
    pub angle_min_rad: f32,
    /// Angle between rays, counter-clockwise.
    pub angle_increment_rad: f32,
    /// Ranges; infinity: nothing up to `max_range_m`; NaN: no reading.
    pub ranges_m: Vec<f32>,
    /// Nearer readings are left out.
    pub min_range_m: f32,
    /// Farther readings only say that the way is free up to this range; above 0.
    pub max_range_m: f32,
}

/// A scan.
#[derive(Clone, Debug, PartialEq)]
pub enum Scan {
    /// The tiles that were seen, none twice. What differs from the producer's scan before is sent.
    Tiles(Vec<(TileIndex, TileMasks)>),
    /// A point cloud.
    Cloud(PointCloud),
    /// A planar range scan.
    Ranges(RangeScan),
}

impl From<PointCloud> for v1::PointCloud {
    fn from(cloud: PointCloud) -> Self {
        Self {
            pose: Some(pose_to_wire(&cloud.pose)),
            frame_id: cloud.frame_id,
            xyz_m: cloud.xyz_m,
            min_range_m: cloud.min_range_m,
            max_range_m: cloud.max_range_m,
        }
    }
}

impl From<RangeScan> for v1::RangeScan {
    fn from(scan: RangeScan) -> Self {
        Self {
            pose: Some(pose_to_wire(&scan.pose)),
            frame_id: scan.frame_id,
            angle_min_rad: scan.angle_min_rad,
            angle_increment_rad: scan.angle_increment_rad,
            ranges_m: scan.ranges_m,
            min_range_m: scan.min_range_m,
            max_range_m: scan.max_range_m,
        }
    }
}

/// Most bytes that a scan takes on the wire, and about as many in memory.
pub(super) fn wire_bytes(content: &Content) -> usize {
    // A packed number takes 5 bytes at most, a float 4.
    FRAME_BYTES
        + match content {
            Content::Tiles(scan) => {
                let numbers =
                    scan.seen.len() + scan.masked.len() + scan.observed_flips.len() + scan.occupied_flips.len();
                numbers * 5 + scan.observed.len() + scan.occupied.len()
            }
            Content::Cloud(cloud) => cloud.xyz_m.len() * 4 + cloud.frame_id.len(),
            Content::Ranges(ranges) => ranges.ranges_m.len() * 4 + ranges.frame_id.len(),
        }
}
