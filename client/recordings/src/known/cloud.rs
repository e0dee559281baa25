//! Point clouds, `sensor_msgs/PointCloud2`.
//!
//! Invariant: every point of a cloud lies within its bytes.

use nalgebra::Isometry3;

use super::{Fields, KnownError, own_pose};
use crate::{
    definition::Primitive,
    message::{self, Value},
};

/// Maximum number of points of a cloud.
const POINTS_MAX: usize = 2_000_000;
/// Names of the field with the time of each point, as drivers write it: Ouster, Velodyne, Hesai and RoboSense, Livox,
/// Blickfeld, Aeva.
const TIME_NAMES: [&str; 6] = ["t", "time", "timestamp", "offset_time", "point_time_offset", "time_offset_ns"];
/// The points of a cloud lie within this time of each other and of the stamp, nanoseconds.
const CLOUD_NANOS_MAX: f64 = 1.001e9;
/// A time of 1973, nanoseconds: stamps before it are those of a simulation.
const REAL_STAMP_NANOS: f64 = 1e17;

/// The times of the points of a cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PointTimes {
    /// The cloud has none.
    Absent,
    /// The driver's numbers are no times near the stamp of the cloud.
    Wrong,
    /// Times: nanoseconds after the stamp are `number * factor - base`.
    Known {
        /// Nanoseconds of one unit of the field.
        factor: f64,
        /// The stamp in the count of the field, nanoseconds; 0 if the field counts from the stamp.
        base: f64,
    },
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Axis {
    offset: usize,
    primitive: Primitive,
}

/// A point cloud.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud<'a> {
    axes: [Axis; 3],
    time: Option<Axis>,
    point_step: usize,
    row_step: usize,
    width: usize,
    height: usize,
    is_big_endian: bool,
    pose: Isometry3<f64>,
    bytes: &'a [u8],
}

impl<'a> Cloud<'a> {
    /// Reads a message.
    ///
    /// # Errors
    /// A field is missing, the cloud has no x, y and z of type float32 or float64, or its lengths do not fit together.
    pub fn read(message: &Value<'a>) -> Result<Self, KnownError> {
        if message.field("point_stride").is_some() {
            return Self::read_foxglove(message);
        }
        let fields = Fields { type_name: "sensor_msgs/PointCloud2", message };
        let (width, height) = (fields.size(&["width"])?, fields.size(&["height"])?);
        let (point_step, row_step) = (fields.size(&["point_step"])?, fields.size(&["row_step"])?);
        let is_big_endian = fields.number(&["is_bigendian"])? != 0.0;
        let bytes = fields.numbers(&["data"])?.bytes;
        let axes = [axis(&fields, "x")?, axis(&fields, "y")?, axis(&fields, "z")?];
        let time = TIME_NAMES.iter().find_map(|name| time_field(&fields, name)).filter(|time| time.ends_by(point_step));
        let wrong = || {
            KnownError::Values(format!(
                "a cloud of {width} x {height} points of {point_step} bytes in rows of {row_step} bytes does not go \
                 with {} bytes of data",
                bytes.len()
            ))
        };
        // Some drivers leave the length of a row of a flat cloud at 0.
        let row_step =
            if height <= 1 { row_step.max(width.checked_mul(point_step).ok_or_else(wrong)?) } else { row_step };
        let needed = match (width, height) {
            (0, _) | (_, 0) => Some(0),
            (width, height) => {
                (height - 1).checked_mul(row_step).and_then(|rows| rows.checked_add(width.checked_mul(point_step)?))
            }
        };
        let is_row_long = width.checked_mul(point_step).is_some_and(|row| row <= row_step);
        let axes_end = axes.iter().map(|axis| axis.offset + axis.primitive.bytes().unwrap_or(8)).max().unwrap_or(0);
        let is_empty = width == 0 || height == 0;
        if !is_empty && width.checked_mul(height).is_none_or(|count| count > POINTS_MAX) {
            let text = format!("a cloud of {width} x {height} points; at most {POINTS_MAX} are read");
            return Err(KnownError::Values(text));
        }
        if !is_empty && (!is_row_long || point_step < axes_end || needed.is_none_or(|needed| needed > bytes.len())) {
            return Err(wrong());
        }
        let pose = Isometry3::identity();
        Ok(Self { pose, axes, time, point_step, row_step, width, height, is_big_endian, bytes })
    }

    /// Reads a cloud of Foxglove, which is one row of points.
    fn read_foxglove(message: &Value<'a>) -> Result<Self, KnownError> {
        let fields = Fields { type_name: "foxglove.PointCloud", message };
        let point_step = fields.size(&["point_stride"])?;
        let bytes = fields.numbers(&["data"])?.bytes;
        let axes = [axis(&fields, "x")?, axis(&fields, "y")?, axis(&fields, "z")?];
        let time = TIME_NAMES.iter().find_map(|name| time_field(&fields, name)).filter(|time| time.ends_by(point_step));
        let width = bytes.len().checked_div(point_step).unwrap_or(0);
        if width > POINTS_MAX || width > 0 && !axes.iter().all(|axis| axis.ends_by(point_step)) {
            return Err(KnownError::Values(format!(
                "a cloud of {width} points of {point_step} bytes; at most {POINTS_MAX} are read"
            )));
        }
        let row_step = width.saturating_mul(point_step);
        let pose = own_pose(&fields)?;
        Ok(Self { axes, time, point_step, row_step, width, height: 1, is_big_endian: false, pose, bytes })
    }

    /// Pose of the sensor within the frame of the message.
    pub fn pose(&self) -> &Isometry3<f64> {
        &self.pose
    }

    /// Number of points, those without valid coordinates included.
    pub fn len(&self) -> usize {
        self.width.saturating_mul(self.height)
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The points in the frame of the sensor, metres; not all are measured, see [`Cloud::is_return`].
    pub fn points(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        self.starts().map(|start| self.axes.map(|axis| self.number(start + axis.offset, axis.primitive)))
    }

    /// The points with the numbers of their times, which [`Cloud::times`] explains; 0 if the cloud has none.
    pub fn timed_points(&self) -> impl Iterator<Item = ([f64; 3], f64)> + '_ {
        self.starts().map(|start| {
            let time = self.time.map_or(0.0, |time| self.number(start + time.offset, time.primitive));
            (self.axes.map(|axis| self.number(start + axis.offset, axis.primitive)), time)
        })
    }

    /// Where each point begins among the bytes.
    fn starts(&self) -> impl Iterator<Item = usize> + '_ {
        let rows = if self.is_empty() { 0 } else { self.height };
        (0..rows).flat_map(move |row| (0..self.width).map(move |column| row * self.row_step + column * self.point_step))
    }

    /// The meaning of the times of the points, and the first and last of them in nanoseconds after the stamp. Drivers
    /// count seconds or nanoseconds, from the stamp or from 1970.
    pub fn times(&self, stamp_nanos: i64) -> (PointTimes, [f64; 2]) {
        let Some(time) = self.time else { return (PointTimes::Absent, [0.0; 2]) };
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (point, number) in self.timed_points() {
            if Self::is_return(&point) {
                // `min` and `max` would pass over NaN.
                low = if number < low || number.is_nan() { number } else { low };
                high = if number > high || number.is_nan() { number } else { high };
            }
        }
        if low == f64::INFINITY {
            return (PointTimes::Absent, [0.0; 2]);
        }
        let stamp = stamp_nanos as f64;
        let is_float = matches!(time.primitive, Primitive::Float32 | Primitive::Float64);
        let seconds = (1e9, 0.0);
        let nanos = (1.0, 0.0);
        // Near 0 everything is near the stamp.
        let units: &[f64] = if stamp > REAL_STAMP_NANOS { &[1e9, 1e6, 1e3, 1.0] } else { &[1e9] };
        let since_1970 = units.iter().map(|factor| (*factor, stamp));
        let candidates = is_float.then_some(seconds).into_iter().chain(since_1970);
        // Numbers that all lie far from 0 count from another time than the stamp.
        let from_stamp = (low.abs() <= high - low || high <= 1e9 && !is_float).then_some(nanos);
        for (factor, base) in candidates.chain(from_stamp) {
            let span = [low, high].map(|number| number * factor - base);
            if span.iter().all(|nanos| nanos.abs() <= CLOUD_NANOS_MAX) && span[1] - span[0] <= CLOUD_NANOS_MAX {
                return (PointTimes::Known { factor, base }, span);
            }
        }
        (PointTimes::Wrong, [0.0; 2])
    }

    /// Whether a point is one where a beam has ended. Drivers fill the places of beams without a return with NaN or
    /// infinity, or with zeros, which is the place of the sensor itself.
    pub fn is_return(point: &[f64; 3]) -> bool {
        point.iter().all(|along| along.is_finite()) && point.iter().any(|along| *along != 0.0)
    }

    /// A number of the cloud.
    fn number(&self, start: usize, primitive: Primitive) -> f64 {
        let bytes = self.bytes.get(start..).unwrap_or_default();
        // The axes come first: a cloud has many of them.
        if primitive == Primitive::Float32 {
            let read = if self.is_big_endian { f32::from_be_bytes } else { f32::from_le_bytes };
            return bytes.first_chunk().map_or(f64::NAN, |bytes| f64::from(read(*bytes)));
        }
        let size = primitive.bytes().unwrap_or(1);
        let value = bytes.get(..size).map(|bytes| message::number(primitive, bytes, self.is_big_endian));
        value.and_then(|value| value.number()).unwrap_or(f64::NAN)
    }
}

impl Axis {
    /// Whether the field lies within the bytes of a point.
    fn ends_by(&self, point_step: usize) -> bool {
        self.offset.checked_add(self.primitive.bytes().unwrap_or(8)).is_some_and(|end| end <= point_step)
    }
}

/// The field with the times of the points, if it has this name and one number a point.
fn time_field(fields: &Fields<'_, '_>, name: &str) -> Option<Axis> {
    let field = named(fields.value(&["fields"]).ok()?.list()?, name)?;
    let field = Fields { type_name: "sensor_msgs/PointField", message: field };
    let primitive = number_type(&field).ok()??;
    let count = field.size(&["count"]).unwrap_or(1);
    (count <= 1).then_some(Axis { offset: field.size(&["offset"]).ok()?, primitive })
}

/// The type of the numbers of a field: ROS and Foxglove have different numbers for them.
fn number_type(field: &Fields<'_, '_>) -> Result<Option<Primitive>, KnownError> {
    use Primitive::{Float32, Float64, Int8, Int16, Int32, Uint8, Uint16, Uint32};
    let (number, types) = match field.message.field("datatype") {
        Some(_) => (field.size(&["datatype"])?, [Int8, Uint8, Int16, Uint16, Int32, Uint32, Float32, Float64]),
        None => (field.size(&["type"])?, [Uint8, Int8, Uint16, Int16, Uint32, Int32, Float32, Float64]),
    };
    Ok(number.checked_sub(1).and_then(|index| types.get(index)).copied())
}

fn named<'m, 'a>(list: &'m [Value<'a>], name: &str) -> Option<&'m Value<'a>> {
    list.iter().find(|field| matches!(field.field("name"), Some(Value::Text(text)) if *text == name.as_bytes()))
}

fn axis(fields: &Fields<'_, '_>, name: &str) -> Result<Axis, KnownError> {
    let list = fields.value(&["fields"])?.list().ok_or_else(|| fields.missing(&["fields"]))?;
    let Some(found) = named(list, name) else {
        let names: Vec<String> = list.iter().filter_map(|field| field.field("name")?.text()).collect();
        return Err(KnownError::Values(format!("the cloud has no {name}; it has {}", names.join(", "))));
    };
    let field = Fields { type_name: "sensor_msgs/PointField", message: found };
    let primitive = match number_type(&field)? {
        Some(primitive @ (Primitive::Float32 | Primitive::Float64)) => primitive,
        other => {
            let other = other.map_or("of an unknown type".to_owned(), |other| format!("of type {other:?}"));
            return Err(KnownError::Values(format!(
                "{name} of the cloud has numbers {other}; float32 and float64 are read"
            )));
        }
    };
    let offset = field.size(&["offset"])?;
    if offset > 1 << 20 {
        return Err(KnownError::Values(format!("{name} of the cloud begins at byte {offset} of a point")));
    }
    Ok(Axis { offset, primitive })
}
