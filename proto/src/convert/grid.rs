//! Grids: their specification, boxes of cells, poses and retention.
//!
//! Invariant: a specification from [`grid_from_wire`] has passed `GridSpec::check`.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use tidemap_grid::{
    index::{CellBox, CellIndex},
    spec::{Evidence, GridSpec, InvalidGrid, Retention, SensorNoise},
    view::GridView,
};

use super::{
    InvalidField,
    time::{duration, nanos_from_duration},
};
use crate::v1;

/// Default frame of a grid.
pub const DEFAULT_FRAME: &str = "map";
/// Tolerance of the length of a quaternion.
const QUATERNION_TOLERANCE: f64 = 1e-3;

/// A grid's specification.
///
/// # Errors
/// The invalid field.
pub fn grid_from_wire(wire: v1::Grid) -> Result<GridSpec, InvalidField> {
    let frame_id = if wire.frame_id.is_empty() { DEFAULT_FRAME.to_owned() } else { wire.frame_id };
    let sensor = wire.sensor.map_or_else(SensorNoise::default, |sensor| SensorNoise {
        hit: sensor.hit,
        false_alarm: sensor.false_alarm,
        prior: if sensor.prior == 0.0 { 0.5 } else { sensor.prior },
    });
    let spec = GridSpec {
        frame_id,
        is_flat: wire.flat,
        resolution_m: wire.resolution_m,
        origin_m: [wire.origin_x_m, wire.origin_y_m, wire.origin_z_m],
        extent: wire.extent.as_ref().map(cell_box_from_wire),
        sensor,
        retention: retention_from_wire("grid.retention", wire.retention, Retention::None)?,
        half_life_nanos: wire
            .half_life
            .map(|half_life| nanos_from_duration("grid.half_life", half_life))
            .transpose()?,
        evidence: Evidence::default(),
    };
    spec.check().map_err(|error| {
        let field = match error {
            InvalidGrid::Frame(_) => "grid.frame_id",
            InvalidGrid::Resolution(_) => "grid.resolution_m",
            InvalidGrid::Origin(_) => "grid.origin",
            InvalidGrid::Extent(..) => "grid.extent",
            InvalidGrid::Sensor(_) => "grid.sensor",
            InvalidGrid::Retention(_) => "grid.retention",
            InvalidGrid::HalfLife(_) => "grid.half_life",
        };
        InvalidField::new(field, error)
    })?;
    Ok(spec)
}

/// A grid's specification for the wire.
#[must_use]
pub fn grid_to_wire(spec: &GridSpec) -> v1::Grid {
    let SensorNoise { hit, false_alarm, prior } = spec.sensor;
    v1::Grid {
        frame_id: spec.frame_id.clone(),
        flat: spec.is_flat,
        resolution_m: spec.resolution_m,
        origin_x_m: spec.origin_m[0],
        origin_y_m: spec.origin_m[1],
        origin_z_m: spec.origin_m[2],
        extent: spec.extent.as_ref().map(cell_box_to_wire),
        sensor: Some(v1::SensorNoise { hit, false_alarm, prior }),
        retention: Some(retention_to_wire(spec.retention)),
        half_life: spec.half_life_nanos.map(duration),
    }
}

/// Counters of a grid, for the wire.
#[must_use]
pub fn grid_summary_to_wire(grid: &GridView) -> v1::GridSummary {
    let (bounds, region) = (grid.bounds(), grid.region());
    v1::GridSummary {
        tiles: grid.tiles() as u64,
        scans: grid.scans(),
        pending_scans: grid.pending_scans(),
        cell_observations: grid.cell_observations(),
        bounds: (!bounds.is_empty()).then(|| cell_box_to_wire(&bounds)),
        ahead_scans: grid.scans_ahead(),
        region: (!region.is_empty()).then(|| cell_box_to_wire(&region)),
    }
}

/// A box of cells.
#[must_use]
pub fn cell_box_from_wire(wire: &v1::CellBox) -> CellBox {
    CellBox {
        min: CellIndex { x: wire.min_x, y: wire.min_y, z: wire.min_z },
        max: CellIndex { x: wire.max_x, y: wire.max_y, z: wire.max_z },
    }
}

/// A box of cells for the wire.
#[must_use]
pub fn cell_box_to_wire(cells: &CellBox) -> v1::CellBox {
    let CellBox { min, max } = cells;
    v1::CellBox { min_x: min.x, min_y: min.y, min_z: min.z, max_x: max.x, max_y: max.y, max_z: max.z }
}

/// A retention, or `default` if absent.
///
/// # Errors
/// A duration that is not positive.
pub fn retention_from_wire(
    field: &str,
    wire: Option<v1::Retention>,
    default: Retention,
) -> Result<Retention, InvalidField> {
    match wire.and_then(|retention| retention.keep) {
        None => Ok(default),
        Some(v1::retention::Keep::None(_)) => Ok(Retention::None),
        Some(v1::retention::Keep::Forever(_)) => Ok(Retention::Forever),
        Some(v1::retention::Keep::Duration(duration)) => {
            let nanos = nanos_from_duration(field, duration)?;
            if nanos < 1 {
                return Err(InvalidField::new(field, format!("{nanos} ns: it must be at least 1 ns")));
            }
            Ok(Retention::Duration(nanos))
        }
    }
}

/// A retention for the wire.
#[must_use]
pub fn retention_to_wire(retention: Retention) -> v1::Retention {
    let keep = match retention {
        Retention::None => v1::retention::Keep::None(true),
        Retention::Duration(nanos) => v1::retention::Keep::Duration(duration(nanos)),
        Retention::Forever => v1::retention::Keep::Forever(true),
    };
    v1::Retention { keep: Some(keep) }
}

/// A pose for the wire. The wire leaves out a minus zero as it does a zero, so it is a zero here already: both sides
/// then compute the same checksum.
#[must_use]
pub fn pose_to_wire(pose: &Isometry3<f64>) -> v1::Pose {
    let ([x_m, y_m, z_m], [qx, qy, qz, qw]): ([f64; 3], [f64; 4]) =
        (pose.translation.vector.into(), pose.rotation.coords.into());
    let [x_m, y_m, z_m, qx, qy, qz, qw] = [x_m, y_m, z_m, qx, qy, qz, qw].map(|number| number + 0.0);
    v1::Pose { x_m, y_m, z_m, qx, qy, qz, qw }
}

/// A pose. If absent, the sensor is at the origin of the map, not rotated.
///
/// # Errors
/// A number that is not finite, or a quaternion whose length is not 1.
pub fn pose_from_wire(field: &str, wire: Option<v1::Pose>) -> Result<Isometry3<f64>, InvalidField> {
    let v1::Pose { x_m, y_m, z_m, qx, qy, qz, qw } = wire.unwrap_or_default();
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    if let Some(wrong) = [x_m, y_m, z_m, qx, qy, qz, qw].iter().find(|number| !number.is_finite()) {
        return Err(InvalidField::new(field, format!("{wrong} is not a finite number")));
    }
    let length = quaternion.norm();
    let rotation = if quaternion == Quaternion::default() {
        UnitQuaternion::identity()
    } else if (length - 1.0).abs() <= QUATERNION_TOLERANCE {
        UnitQuaternion::from_quaternion(quaternion)
    } else {
        let text = format!("the quaternion {:?} has length {length:.4}: it must be 1 within 0.001", [qx, qy, qz, qw]);
        return Err(InvalidField::new(field, text));
    };
    Ok(Isometry3::from_parts(Translation3::new(x_m, y_m, z_m), rotation))
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;

    #[test]
    fn a_pose_with_minus_zeros_is_the_same_on_both_sides() {
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(1.0, -0.0, 0.0, -0.0));
        let sent = pose_to_wire(&Isometry3::from_parts([-0.0, 2.0, -0.0].into(), rotation));
        let received = v1::Pose::decode(sent.encode_to_vec().as_slice()).expect("what was encoded");
        let bits =
            |pose: &v1::Pose| [pose.x_m, pose.y_m, pose.z_m, pose.qx, pose.qy, pose.qz, pose.qw].map(f64::to_bits);
        assert_eq!(bits(&sent), bits(&received));
    }
}
