//! Scans of a grid: tiles, point clouds, ranges.
//!
//! Invariant: a scan is sent as given; the daemon checks whether it is valid for the map.

pub use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use tidemap_grid::{
    index::{CellBox, TileIndex},
    mask::TileMasks,
};
use tidemap_proto::{
    convert::grid::pose_to_wire,
    v1::{self, scan::Content},
};

/// Maximum number of bytes of a scan on the wire in addition to its points, masks and flips.
const FRAME_BYTES: usize = 256;

/// Points in the sensor's frame, ray-cast by the daemon.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// Pose of the sensor: the transform map_from_sensor.
    pub pose: Isometry3<f64>,
    /// Frame of the pose; empty: the frame of the map.
    pub frame_id: String,
    /// x, y, z of each point, metres.
    pub xyz_m: Vec<f32>,
    /// Minimum range; nearer points are ignored.
    pub min_range_m: f32,
    /// Maximum range; farther points only show that the way is free up to it; 0: the limit of the daemon.
    pub max_range_m: f32,
}

/// A scan of a planar range finder, ray-cast by the daemon.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RangeScan {
    /// Pose of the sensor: the transform map_from_sensor.
    pub pose: Isometry3<f64>,
    /// Frame of the pose; empty: the frame of the map.
    pub frame_id: String,
    /// Angle of the first ray from the sensor's x axis.
    pub angle_min_rad: f32,
    /// Angle between rays, counter-clockwise.
    pub angle_increment_rad: f32,
    /// Ranges; infinity, and `max_range_m` or more: the beam has no return; NaN: no reading.
    pub ranges_m: Vec<f32>,
    /// Minimum range; nearer readings are ignored.
    pub min_range_m: f32,
    /// Range of the sensor, above 0.
    pub max_range_m: f32,
    /// Beams without a return show that the way is free up to this range; 0: they show nothing.
    pub free_range_m: f32,
    /// Farther readings only show that the way is free up to this range; 0: all readings count.
    pub trusted_range_m: f32,
}

/// A scan.
#[derive(Clone, Debug, PartialEq)]
pub enum Scan {
    /// The tiles that were seen, none twice. Only the difference to the previous scan of the producer is sent.
    Tiles(Vec<(TileIndex, TileMasks)>),
    /// A map: tiles, and the cells that it shows, known and unknown ones, whose size the daemon remembers.
    Map {
        /// The tiles with known cells, none twice.
        tiles: Vec<(TileIndex, TileMasks)>,
        /// The size of the map.
        shown: CellBox,
    },
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
            free_range_m: scan.free_range_m,
            trusted_range_m: scan.trusted_range_m,
        }
    }
}

/// Maximum number of bytes of a scan on the wire, and approximately in memory.
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
