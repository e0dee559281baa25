//! Point clouds in the polygon file format, PLY, as text or binary in either byte order; and a writer of maps.
//!
//! The reader takes x, y and z of the element `vertex`, of any type, and skips other properties and elements, including
//! lists. In a text file each element has its own line.
//!
//! Invariant: a file gives exactly the number of points, finite and not, that its header announces, or an error; all
//! other announced elements are complete.

mod header;
#[cfg(test)]
mod tests;
mod write;

use super::{
    error::{FilePlace, FormatError},
    points::PointFile,
    scalar::{Endian, Scalar},
    text::{Line, Lines},
};
use header::{Element, Encoding, PropertyKind};

pub use write::write;

/// Reads a PLY file.
pub fn read(bytes: &[u8]) -> Result<PointFile, FormatError> {
    let mut lines = Lines::new(bytes);
    let header = header::read(bytes, &mut lines)?;
    let mut file = PointFile::default();
    match header.encoding {
        Encoding::Ascii => {
            let last = header.elements.iter().rposition(|element| element.count > 0);
            for (index, element) in header.elements.iter().enumerate() {
                ascii(element, Some(index) == last, &mut lines, &mut file)?;
            }
            if let Some(line) = lines.next_full()? {
                return Err(line.wrong("the line", line.text, "absent: all elements of the header are there already"));
            }
        }
        Encoding::Binary(endian) => {
            let mut data = Binary { bytes: lines.rest(), at: lines.at(), endian };
            for element in &header.elements {
                binary(element, &mut data, &mut file)?;
            }
            if !data.bytes.trim_ascii().is_empty() {
                return Err(FormatError::trailing(data.at, data.bytes.len() as u64, "the last element"));
            }
        }
    }
    Ok(file)
}

/// Checks that the file is long enough for an element, and reserves memory if it contains the points.
fn room_for(element: &Element, min_bytes: u64, at: u64, room: u64, file: &mut PointFile) -> Result<(), FormatError> {
    let needs = element.count.saturating_mul(min_bytes);
    if needs > room {
        let what = format!("element {} of {} at {min_bytes} bytes or more", element.name, element.count);
        return Err(FormatError::cut_off(at, what, needs, room));
    }
    if element.points.is_some() {
        *file = PointFile::with_capacity(element.count, None);
    }
    Ok(())
}

fn ascii(element: &Element, is_last: bool, lines: &mut Lines<'_>, file: &mut PointFile) -> Result<(), FormatError> {
    // Each value takes at least a character and a space or line end; the last line end may be missing.
    room_for(element, 2 * element.properties.len() as u64, lines.at(), lines.rest().len() as u64 + 1, file)?;
    for taken in 0..element.count {
        let is_last = is_last && taken + 1 == element.count;
        let line = lines.next_data(is_last)?.ok_or_else(|| {
            FormatError::lines_cut_off(lines.number(), format!("element {}", element.name), element.count, taken)
        })?;
        let point = ascii_row(element, line)?;
        if element.points.is_some() {
            file.push(point);
        }
    }
    Ok(())
}

fn ascii_row(element: &Element, line: Line<'_>) -> Result<[f64; 3], FormatError> {
    let mut words = line.words();
    let mut point = [0.0; 3];
    for (index, property) in element.properties.iter().enumerate() {
        match property.kind {
            PropertyKind::Scalar(_) => {
                let word = words.next();
                if let Some(axis) = element.axis(index) {
                    point[axis] = line.parse(property.name, word, "a number")?;
                } else if word.is_none() {
                    return Err(FormatError::missing(line.place(), property.name, "the header announces it"));
                }
            }
            PropertyKind::List { .. } => {
                let length: u64 = line.parse(property.name, words.next(), "the length of a list")?;
                for taken in 0..length {
                    if words.next().is_none() {
                        let right = format!("{length}, as it begins");
                        return Err(FormatError::value(line.place(), format!("list {}", property.name), taken, right));
                    }
                }
            }
        }
    }
    match words.next() {
        None => Ok(point),
        Some(word) => Err(line.wrong(
            "the line's end",
            word,
            format!("after {} properties, as the header announces", element.properties.len()),
        )),
    }
}

/// Binary data that was not read yet.
struct Binary<'a> {
    bytes: &'a [u8],
    at: u64,
    endian: Endian,
}

impl<'a> Binary<'a> {
    fn take(&mut self, length: u64, what: &str) -> Result<&'a [u8], FormatError> {
        let taken = usize::try_from(length).ok().and_then(|length| self.bytes.split_at_checked(length));
        let (taken, rest) =
            taken.ok_or_else(|| FormatError::cut_off(self.at, what, length, self.bytes.len() as u64))?;
        self.bytes = rest;
        self.at += length;
        Ok(taken)
    }

    fn length(&mut self, count: Scalar, what: &str) -> Result<u64, FormatError> {
        let at = self.at;
        let length = count.read(self.take(count.bytes() as u64, what)?, 0, self.endian);
        if length < 0.0 {
            return Err(FormatError::value(
                FilePlace::Byte(at),
                format!("the length of list {what}"),
                length,
                "at least 0",
            ));
        }
        // A non-negative integer; values beyond u64 saturate, and are then too long for any file.
        Ok(length as u64)
    }
}

fn binary(element: &Element, data: &mut Binary<'_>, file: &mut PointFile) -> Result<(), FormatError> {
    let min_bytes = element.properties.iter().map(|property| match property.kind {
        PropertyKind::Scalar(scalar) | PropertyKind::List { count: scalar, .. } => scalar.bytes() as u64,
    });
    room_for(element, min_bytes.sum(), data.at, data.bytes.len() as u64, file)?;
    for _ in 0..element.count {
        let mut point = [0.0; 3];
        for (index, property) in element.properties.iter().enumerate() {
            match property.kind {
                PropertyKind::Scalar(scalar) => {
                    let bytes = data.take(scalar.bytes() as u64, property.name)?;
                    if let Some(axis) = element.axis(index) {
                        point[axis] = scalar.read(bytes, 0, data.endian);
                    }
                }
                PropertyKind::List { count, item } => {
                    let length = data.length(count, property.name)?;
                    data.take(length.saturating_mul(item.bytes() as u64), property.name)?;
                }
            }
        }
        if element.points.is_some() {
            file.push(point);
        }
    }
    Ok(())
}
