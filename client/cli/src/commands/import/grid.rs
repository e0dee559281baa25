//! Converts scans, clouds and grids of an import to scans of the client library.
//!
//! Invariant: ranges and limits that the daemon would refuse are brought into its limits here.

use tidemap_client::{
    maps::GridSpec,
    observe::scan::{PointCloud, RangeScan, Scan},
};
use tidemap_formats::nav2::{self, GridCell, GridMode};
use tidemap_recordings::convert::{PlacedCloud, PlacedGrid, PlacedScan};

use crate::commands::grid::cell_masks::of_plane;

/// Ranges above this, in metres, only mean that the space up to it is free, unless options state otherwise.
const RANGE_MAX_M: f32 = 100.0;
/// Occupancy in percent from which a cell of a grid is occupied, and below which it is free: the thresholds of Nav2's
/// map saver. Cells between carry no information.
const OCCUPIED_PERCENT: i8 = 65;
const FREE_PERCENT: i8 = 25;

/// Limits that options give.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Ranges {
    pub(super) min_m: Option<f32>,
    pub(super) max_m: Option<f32>,
    /// Beams without a return free the cells up to this range; `None`: they free nothing.
    pub(super) free_m: Option<f32>,
}

pub(super) fn range(text: &str) -> Result<f32, String> {
    let right = || format!("{text:?} is not a range: use metres, above 0");
    text.parse::<f32>().ok().filter(|range| range.is_finite() && *range > 0.0).ok_or_else(right)
}

pub(super) fn ranges(scan: PlacedScan, limits: Ranges) -> Scan {
    let max_range_m = (scan.range_max_m as f32).min(RANGE_MAX_M);
    Scan::Ranges(RangeScan {
        pose: scan.pose,
        frame_id: String::new(),
        angle_min_rad: scan.angle_min_rad as f32,
        angle_increment_rad: scan.angle_increment_rad as f32,
        ranges_m: scan.ranges_m,
        min_range_m: (scan.range_min_m.max(0.0) as f32).max(limits.min_m.unwrap_or(0.0)).min(max_range_m),
        max_range_m,
        free_range_m: limits.free_m.unwrap_or(0.0),
        trusted_range_m: limits.max_m.unwrap_or(0.0),
    })
}

pub(super) fn cloud(cloud: PlacedCloud, limits: Ranges) -> Scan {
    Scan::Cloud(PointCloud {
        pose: cloud.pose,
        frame_id: String::new(),
        xyz_m: cloud.points_m.into_flattened(),
        min_range_m: limits.min_m.unwrap_or(0.0),
        max_range_m: limits.max_m.unwrap_or(RANGE_MAX_M),
    })
}

/// The cells of a grid, and the notices about them. A rotated grid cannot be taken: its cells are not aligned with the
/// cells of the map.
pub(super) fn cells(placed: &PlacedGrid, grid: &GridSpec) -> Result<(Scan, Option<String>), String> {
    let yaw = placed.origin.rotation.euler_angles().2;
    if yaw.abs() > 1e-3 {
        return Err(format!("the grid is turned by {yaw:.3} rad: its cells do not lie along those of the map"));
    }
    let cells = placed.percents.iter().map(|percent| match *percent {
        0..=FREE_PERCENT => GridCell::Free,
        OCCUPIED_PERCENT..=100 => GridCell::Occupied,
        _ => GridCell::Unknown,
    });
    let size = [placed.width, placed.height].map(|count| u32::try_from(count).unwrap_or(u32::MAX));
    let at = placed.origin.translation.vector;
    let map = nav2::Grid {
        resolution_m: placed.resolution_m,
        origin_m: [at.x, at.y],
        size_cells: size,
        cells: cells.collect(),
        free_205: 0,
    };
    let on = of_plane(&map, GridMode::Trinary, None, grid).map_err(|error| error.to_string())?;
    if on.tiles.is_empty() {
        return Err("the grid of the map has none of its known cells".to_owned());
    }
    let scan = match on.shown {
        Some(shown) => Scan::Map { tiles: on.tiles, shown },
        None => Scan::Tiles(on.tiles),
    };
    Ok((scan, on.notice))
}
