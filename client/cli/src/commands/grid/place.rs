//! Poses and regions on the command line, in metres.
//!
//! Invariant: all numbers are finite, minima are below maxima, quaternions have length 1; an error names the value.

use std::str::FromStr;

use tidemap_client::{
    maps::{CellBox, CellIndex, GridSpec, Map},
    observe::scan::{Isometry3, Quaternion, Translation3, UnitQuaternion},
};

use crate::commands::usage;

/// Tolerance of a quaternion's length.
const QUATERNION_TOLERANCE: f64 = 1e-3;

/// A pose: `X,Y,Z,QX,QY,QZ,QW`, or `X,Y,Z` without rotation.
pub(crate) fn pose(text: &str) -> Result<Isometry3<f64>, String> {
    let right = "a pose is X,Y,Z,QX,QY,QZ,QW: metres and a unit quaternion; or X,Y,Z without rotation";
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse::<f64>()).collect();
    let numbers = numbers.ok().filter(|numbers| numbers.iter().all(|number| number.is_finite()));
    match numbers.as_deref() {
        Some(&[x, y, z]) => Ok(Isometry3::translation(x, y, z)),
        Some(&[x, y, z, qx, qy, qz, qw]) => {
            let quaternion = Quaternion::new(qw, qx, qy, qz);
            let length = quaternion.norm();
            if (length - 1.0).abs() > QUATERNION_TOLERANCE {
                return Err(format!("the quaternion {qx},{qy},{qz},{qw} has length {length:.4}: it has to be 1"));
            }
            // The rotation is sent as it was given.
            let rotation = UnitQuaternion::new_unchecked(quaternion);
            Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
        }
        _ => Err(format!("{text:?}: {right}")),
    }
}

/// An interval along one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AxisRange {
    from_m: f64,
    to_m: f64,
}

impl AxisRange {
    /// `from_m` has to be below `to_m`.
    pub(crate) fn new(from_m: f64, to_m: f64) -> Self {
        Self { from_m, to_m }
    }
}

impl FromStr for AxisRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let right =
            || format!("{text:?}: an interval is MIN:MAX in metres, the first below the second, such as 0.5:1.8");
        let (from, to) = text.split_once(':').ok_or_else(right)?;
        match (from.trim().parse::<f64>(), to.trim().parse::<f64>()) {
            (Ok(from_m), Ok(to_m)) if from_m < to_m && from_m.is_finite() && to_m.is_finite() => {
                Ok(Self { from_m, to_m })
            }
            _ => Err(right()),
        }
    }
}

/// A rectangle of the plane: `X0:X1,Y0:Y1`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rectangle {
    x: AxisRange,
    y: AxisRange,
}

impl FromStr for Rectangle {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (x, y) = text
            .split_once(',')
            .ok_or_else(|| format!("{text:?}: a region is X0:X1,Y0:Y1 in metres, such as -5:5,0:8"))?;
        Ok(Self { x: x.parse()?, y: y.parse()? })
    }
}

/// The lower bound of a cell along an axis, metres: without the rounding error of the sum, so that -15.2 stays -15.2.
pub(crate) fn corner_m(origin_m: f64, cell: i32, resolution_m: f64) -> f64 {
    const NANOMETRES: f64 = 1e9;
    let sum = origin_m + f64::from(cell) * resolution_m;
    let short = (sum * NANOMETRES).round() / NANOMETRES;
    let error = f64::EPSILON * (origin_m.abs() + (f64::from(cell) * resolution_m).abs());
    // Adding zero turns -0 into 0.
    (if (short - sum).abs() <= error { short } else { sum }) + 0.0
}

/// The cells that overlap a region; all cells of `all` along axes without limits.
pub(crate) fn cells(
    grid: &GridSpec,
    all: &CellBox,
    rectangle: Option<Rectangle>,
    height: Option<AxisRange>,
) -> CellBox {
    let (mut min, mut max): ([i32; 3], [i32; 3]) = (all.min.into(), all.max.into());
    let along = [rectangle.map(|rectangle| rectangle.x), rectangle.map(|rectangle| rectangle.y), height];
    for (axis, stretch) in along.into_iter().enumerate() {
        let Some(AxisRange { from_m, to_m }) = stretch else { continue };
        // A boundary next to a cell's edge is meant as that edge; the last digit is rounding.
        let index = |metres: f64| (metres - grid.origin_m[axis]) / grid.resolution_m;
        let snapped = |index: f64| if (index - index.round()).abs() < 1e-6 { index.round() } else { index };
        // Values beyond i32 saturate, and are then outside of any grid.
        min[axis] = snapped(index(from_m)).floor() as i32;
        max[axis] = snapped(index(to_m)).ceil() as i32;
    }
    CellBox { min: min.into(), max: max.into() }
}

/// The cells of a map in a rectangle and between two heights, within the observed region.
pub(crate) fn region_of(map: &Map, rectangle: Option<Rectangle>, height: Option<AxisRange>) -> anyhow::Result<CellBox> {
    let Some(grid) = &map.grid else {
        return Err(usage(format!("--region: map {:?} has no grid", map.name)));
    };
    if grid.is_flat && height.is_some() {
        return Err(usage(format!("--z: the grid of map {:?} is flat, it has one layer", map.name)));
    }
    let Some(bounds) = map.grid_summary.as_ref().and_then(|summary| summary.bounds.as_ref()) else {
        return Err(usage(format!("--region: no scan of map {:?} was observed yet", map.name)));
    };
    let region = cells(grid, bounds, rectangle, height);
    if !grid.is_flat {
        return Ok(region);
    }
    Ok(CellBox { min: CellIndex { z: 0, ..region.min }, max: CellIndex { z: 1, ..region.max } })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_a_place_and_a_turn() {
        assert_eq!(pose("1,-2.5,3"), Ok(Isometry3::translation(1.0, -2.5, 3.0)));
        assert_eq!(pose("0,0,0,0,0,1,0").map(|pose| pose.rotation.coords.into()), Ok([0.0, 0.0, 1.0, 0.0]));
        assert!(pose("0,0,0,0,0,1,1").is_err_and(|error| error.contains("length 1.4142")));
        for text in ["", "1,2", "1,2,3,4", "1,2,inf", "a,b,c"] {
            assert!(pose(text).is_err_and(|error| error.contains("X,Y,Z")), "{text}");
        }
    }

    #[test]
    fn corners_are_as_short_as_they_were_written() {
        for (origin, cell, resolution, corner) in [
            (0.0, -304, 0.05, "-15.2"),
            (0.0, -152, 0.1, "-15.2"),
            (-15.2, 0, 0.05, "-15.2"),
            (-51.224998, 0, 0.05, "-51.224998"),
            (0.0, 0, 0.05, "0"),
            (458_000.0, 3, 0.1, "458000.3"),
            (5_548_000.7, -7, 0.1, "5548000"),
            (0.0, 3, 0.050000000745058, "0.15000000223517398"),
        ] {
            assert_eq!(corner_m(origin, cell, resolution).to_string(), corner);
        }
    }

    #[test]
    fn a_region_in_metres_is_made_of_whole_cells() -> Result<(), String> {
        let grid = GridSpec { origin_m: [-1.0, 0.0, 0.0], ..GridSpec::new(0.1) };
        let all = CellBox { min: [-8, -8, 0].into(), max: [16, 16, 24].into() };
        assert_eq!(cells(&grid, &all, None, None), all);
        let region = cells(&grid, &all, Some("-1:-0.75,0.3:0.7".parse()?), None);
        assert_eq!(region, CellBox { min: [0, 3, 0].into(), max: [3, 7, 24].into() });
        let region = cells(&grid, &all, None, Some("0.25:1.05".parse()?));
        assert_eq!((region.min.z, region.max.z), (2, 11));
        for wrong in ["1:0", "1", "a:b", "0:inf"] {
            assert!(wrong.parse::<AxisRange>().is_err(), "{wrong}");
        }
        assert!("0:1".parse::<Rectangle>().is_err());
        Ok(())
    }
}
