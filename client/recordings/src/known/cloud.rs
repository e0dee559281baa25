//! Point clouds, `sensor_msgs/PointCloud2`.
//!
//! Invariant: every point of a cloud lies within its bytes.

use super::{Fields, KnownError};
use crate::{definition::Primitive, message::Value};

/// Maximum number of points of a cloud.
const POINTS_MAX: usize = 2_000_000;
/// Number types of `sensor_msgs/PointField`.
const FLOAT32: usize = 7;
const FLOAT64: usize = 8;

#[derive(Clone, Copy, Debug, PartialEq)]
struct Axis {
    offset: usize,
    primitive: Primitive,
}

/// A point cloud.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud<'a> {
    axes: [Axis; 3],
    point_step: usize,
    row_step: usize,
    width: usize,
    height: usize,
    is_big_endian: bool,
    bytes: &'a [u8],
}

impl<'a> Cloud<'a> {
    /// Reads a message.
    ///
    /// # Errors
    /// A field is missing, the cloud has no x, y and z of type float32 or float64, or its lengths do not fit together.
    pub fn read(message: &Value<'a>) -> Result<Self, KnownError> {
        let fields = Fields { type_name: "sensor_msgs/PointCloud2", message };
        let (width, height) = (fields.size(&["width"])?, fields.size(&["height"])?);
        let (point_step, row_step) = (fields.size(&["point_step"])?, fields.size(&["row_step"])?);
        let is_big_endian = fields.number(&["is_bigendian"])? != 0.0;
        let bytes = fields.numbers(&["data"])?.bytes;
        let axes = [axis(&fields, "x")?, axis(&fields, "y")?, axis(&fields, "z")?];
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
        Ok(Self { axes, point_step, row_step, width, height, is_big_endian, bytes })
    }

    /// Number of points, those without valid coordinates included.
    pub fn len(&self) -> usize {
        self.width.saturating_mul(self.height)
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The points in the frame of the sensor, metres; coordinates may be NaN.
    pub fn points(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        let rows = if self.is_empty() { 0 } else { self.height };
        (0..rows).flat_map(move |row| {
            (0..self.width).map(move |column| {
                let start = row * self.row_step + column * self.point_step;
                self.axes.map(|axis| self.number(start + axis.offset, axis.primitive))
            })
        })
    }

    /// A number of the cloud; an axis has one of these two types.
    fn number(&self, start: usize, primitive: Primitive) -> f64 {
        let bytes = self.bytes.get(start..).unwrap_or_default();
        if primitive == Primitive::Float32 {
            let read = if self.is_big_endian { f32::from_be_bytes } else { f32::from_le_bytes };
            return bytes.first_chunk().map_or(f64::NAN, |bytes| f64::from(read(*bytes)));
        }
        let read = if self.is_big_endian { f64::from_be_bytes } else { f64::from_le_bytes };
        bytes.first_chunk().map_or(f64::NAN, |bytes| read(*bytes))
    }
}

fn axis(fields: &Fields<'_, '_>, name: &str) -> Result<Axis, KnownError> {
    let list = fields.value(&["fields"])?.list().ok_or_else(|| fields.missing(&["fields"]))?;
    let is_named =
        |field: &&Value<'_>| matches!(field.field("name"), Some(Value::Text(text)) if *text == name.as_bytes());
    let Some(found) = list.iter().find(is_named) else {
        let names: Vec<String> = list.iter().filter_map(|field| field.field("name")?.text()).collect();
        return Err(KnownError::Values(format!("the cloud has no {name}; it has {}", names.join(", "))));
    };
    let field = Fields { type_name: "sensor_msgs/PointField", message: found };
    let primitive = match field.size(&["datatype"])? {
        FLOAT32 => Primitive::Float32,
        FLOAT64 => Primitive::Float64,
        other => {
            return Err(KnownError::Values(format!("{name} of the cloud has number type {other}; 7 and 8 are read")));
        }
    };
    let offset = field.size(&["offset"])?;
    if offset > 1 << 20 {
        return Err(KnownError::Values(format!("{name} of the cloud begins at byte {offset} of a point")));
    }
    Ok(Axis { offset, primitive })
}
