//! The header of a PCD file: lines with one entry each, up to DATA.
//!
//! Invariant: the header has x, y and z with one value each; a point takes 3 to [`POINT_BYTES_MAX`] bytes, and the
//! number of points is within the limit. The data may still be missing.

use std::collections::HashMap;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use crate::{
    POINTS_MAX,
    error::{FilePlace, FormatError, shown_start},
    scalar::Scalar,
    text::{Line, Lines},
};

/// Maximum length of a point with all its fields.
const POINT_BYTES_MAX: usize = 1 << 20;

const AXES: [&str; 3] = ["x", "y", "z"];

const KEYS: [&str; 10] =
    ["VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"];

/// The header of a file.
pub(super) struct PcdHeader<'a> {
    fields: Vec<Field<'a>>,
    /// Number of points.
    pub points: u64,
    /// The sensor's pose.
    pub pose: Option<Isometry3<f64>>,
    /// The encoding of the points.
    pub data: Data,
}

/// The encoding of points.
#[derive(Clone, Copy, Debug)]
pub(super) enum Data {
    /// Text, a line for each point.
    Ascii,
    /// Point after point.
    Binary,
    /// Field after field, compressed.
    Compressed,
}

struct Field<'a> {
    name: &'a str,
    /// The coordinate that it is.
    axis: Option<usize>,
    scalar: Scalar,
    count: usize,
}

/// The layout of a point.
pub(super) struct PointLayout {
    /// Length of a point in the file, in bytes.
    pub bytes: usize,
    /// The number of values of the field.
    pub values: usize,
    /// The types of x, y and z.
    pub scalar: [Scalar; 3],
    /// The bytes before each of x, y and z.
    pub byte: [usize; 3],
    /// The values before each of x, y and z.
    pub value: [usize; 3],
}

impl PcdHeader<'_> {
    /// The layout of a point, with or without padding fields.
    pub(super) fn row(&self, padding: bool) -> PointLayout {
        let mut row = PointLayout { bytes: 0, values: 0, scalar: [Scalar::F32; 3], byte: [0; 3], value: [0; 3] };
        for field in self.fields.iter().filter(|field| padding || field.name != "_") {
            if let Some(axis) = field.axis {
                (row.scalar[axis], row.byte[axis], row.value[axis]) = (field.scalar, row.bytes, row.values);
            }
            row.bytes += field.scalar.bytes() * field.count;
            row.values += field.count;
        }
        row
    }
}

/// Reads the lines of the header, including DATA.
pub(super) fn read<'a>(bytes: &'a [u8], lines: &mut Lines<'a>) -> Result<PcdHeader<'a>, FormatError> {
    if !(bytes.starts_with(b"#") || bytes.starts_with(b"VERSION")) {
        return Err(FormatError::value(
            FilePlace::Byte(0),
            "the start of the file",
            shown_start(bytes),
            "\"# .PCD v0.7\" or \"VERSION 0.7\", as in a PCD file",
        ));
    }
    let mut entries: HashMap<&str, Line<'a>> = HashMap::new();
    while !entries.contains_key("DATA") {
        let line = lines.next_line()?.ok_or_else(|| missing("DATA", lines.number()))?;
        let Some(key) = line.words().next().filter(|key| !key.starts_with('#')) else { continue };
        if !KEYS.contains(&key) {
            return Err(line.wrong("the first word", key, format!("one of {}", KEYS.join(", "))));
        }
        if entries.insert(key, line).is_some() {
            return Err(line.wrong("the entry", key, "there once"));
        }
    }
    let end = lines.number();
    let entry = |key| entries.get(key).copied().ok_or_else(|| missing(key, end));
    version(entry("VERSION")?)?;
    let fields = fields(entry("FIELDS")?, entry("SIZE")?, entry("TYPE")?, entries.get("COUNT").copied())?;
    let points = points(entry("WIDTH")?, entry("HEIGHT")?, entries.get("POINTS").copied())?;
    let pose = entries.get("VIEWPOINT").map_or(Ok(None), |&line| pose(line))?;
    let line = entry("DATA")?;
    let data = match line.words().nth(1) {
        Some("ascii") => Data::Ascii,
        Some("binary") => Data::Binary,
        Some("binary_compressed") => Data::Compressed,
        other => return Err(line.wrong("DATA", other.unwrap_or(""), "ascii, binary or binary_compressed")),
    };
    Ok(PcdHeader { fields, points, pose, data })
}

fn missing(key: &str, line: u64) -> FormatError {
    FormatError::missing(FilePlace::Line(line), key, "the header of a PCD file has it, before DATA or as DATA")
}

fn version(line: Line<'_>) -> Result<(), FormatError> {
    match line.words().nth(1) {
        Some("0.7" | ".7" | "0.6" | ".6" | "0.5" | ".5") => Ok(()),
        other => Err(line.wrong("VERSION", other.unwrap_or(""), "0.5, 0.6 or 0.7")),
    }
}

fn fields<'a>(
    names: Line<'a>,
    sizes: Line<'a>,
    types: Line<'a>,
    counts: Option<Line<'a>>,
) -> Result<Vec<Field<'a>>, FormatError> {
    let number = names.words().count() - 1;
    for line in [Some(sizes), Some(types), counts].into_iter().flatten() {
        let found = line.words().count() - 1;
        if found != number {
            let right = format!("{number}, one for each of FIELDS");
            let what = format!("the number of values of {}", line.words().next().unwrap_or_default());
            return Err(FormatError::value(line.place(), what, found, right));
        }
    }
    let mut fields = Vec::with_capacity(number);
    let mut bytes = 0;
    let mut counted = counts.iter().flat_map(Line::words).skip(1);
    for ((name, size), kind) in names.words().zip(sizes.words()).zip(types.words()).skip(1) {
        let scalar = scalar(size, kind).ok_or_else(|| {
            let right = "F of 4 or 8 bytes, or I or U of 1, 2, 4 or 8 bytes";
            types.wrong(format!("the type of field {name:?}"), &format!("{kind} of {size} bytes"), right)
        })?;
        let count = match counts {
            None => 1,
            Some(line) => line.parse("COUNT", counted.next(), "a number from 1")?,
        };
        let axis = axis_of(name, names);
        if count == 0 || (axis.is_some() && count != 1) {
            let right = if axis.is_some() { "1 for x, y and z" } else { "at least 1" };
            return Err(FormatError::value(counts.unwrap_or(names).place(), "COUNT", count, right));
        }
        bytes = scalar.bytes().saturating_mul(count).saturating_add(bytes);
        if bytes > POINT_BYTES_MAX {
            let place = counts.unwrap_or(names).place();
            return Err(FormatError::too_many(place, "the length of a point", bytes as u64, POINT_BYTES_MAX as u64));
        }
        fields.push(Field { name, axis, scalar, count });
    }
    for (axis, name) in AXES.iter().enumerate() {
        match fields.iter().filter(|field| field.axis == Some(axis)).count() {
            1 => {}
            0 => {
                let has = names.words().skip(1).collect::<Vec<_>>().join(" ");
                let right = format!("points have the fields x, y and z, and this file has {has}");
                return Err(FormatError::missing(names.place(), format!("the field {name}"), right));
            }
            _ => return Err(names.wrong("a field's name", name, "there once")),
        }
    }
    Ok(fields)
}

/// The coordinate that a field is. Some writers use capital letters; these count where the small letter is absent.
fn axis_of(name: &str, names: Line<'_>) -> Option<usize> {
    let axis = AXES.iter().position(|axis| axis.eq_ignore_ascii_case(name))?;
    (name == AXES[axis] || !names.words().skip(1).any(|other| other == AXES[axis])).then_some(axis)
}

fn scalar(size: &str, kind: &str) -> Option<Scalar> {
    Some(match (kind, size) {
        ("F", "4") => Scalar::F32,
        ("F", "8") => Scalar::F64,
        ("I", "1") => Scalar::I8,
        ("I", "2") => Scalar::I16,
        ("I", "4") => Scalar::I32,
        ("I", "8") => Scalar::I64,
        ("U", "1") => Scalar::U8,
        ("U", "2") => Scalar::U16,
        ("U", "4") => Scalar::U32,
        ("U", "8") => Scalar::U64,
        _ => return None,
    })
}

fn points(width: Line<'_>, height: Line<'_>, points: Option<Line<'_>>) -> Result<u64, FormatError> {
    let number = |line: Line<'_>, what| line.parse::<u64>(what, line.words().nth(1), "a number from 0");
    let (columns, rows) = (number(width, "WIDTH")?, number(height, "HEIGHT")?);
    let product = columns.saturating_mul(rows);
    if let Some(line) = points {
        let points = number(line, "POINTS")?;
        if points != product {
            let right = format!("{product}, which is WIDTH times HEIGHT");
            return Err(FormatError::value(line.place(), "POINTS", points, right));
        }
    }
    if product > POINTS_MAX {
        return Err(FormatError::too_many(width.place(), "the number of points", product, POINTS_MAX));
    }
    Ok(product)
}

/// The sensor's pose; none for the default pose, which writers use if they have no pose.
fn pose(line: Line<'_>) -> Result<Option<Isometry3<f64>>, FormatError> {
    const RIGHT: &str = "seven finite numbers: tx ty tz qw qx qy qz";
    let mut numbers = [0.0_f64; 7];
    let mut words = line.words().skip(1);
    for number in &mut numbers {
        *number = line.parse("a number of VIEWPOINT", words.next(), RIGHT)?;
    }
    if words.next().is_some() || !numbers.iter().all(|number| number.is_finite()) {
        return Err(line.wrong("VIEWPOINT", line.text, RIGHT));
    }
    let [x, y, z, qw, qx, qy, qz] = numbers;
    if numbers == [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0] {
        return Ok(None);
    }
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    let norm = quaternion.norm();
    if !(0.99..=1.01).contains(&norm) {
        let right = "1: the last four numbers are a unit quaternion, qw qx qy qz";
        return Err(FormatError::value(line.place(), "the length of VIEWPOINT's quaternion", norm, right));
    }
    Ok(Some(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(quaternion))))
}
