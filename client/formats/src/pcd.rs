//! Point clouds of the Point Cloud Library: PCD files, versions 0.5 to 0.7, with text, binary or compressed data.
//!
//! The reader takes the fields x, y and z, of any type, and VIEWPOINT as the sensor's pose; it skips other fields.
//! Binary data is little-endian. Zeros after binary data are padding.
//!
//! Invariant: a file gives exactly the number of points, finite and not, that its header announces, or an error.

mod header;
mod lzf;
#[cfg(test)]
mod tests;

use nalgebra::Isometry3;

use super::{
    error::{FilePlace, FormatError},
    points::PointFile,
    scalar::Endian,
    text::Lines,
};
use header::{Data, PcdHeader};

/// Maximum length of unpacked data.
const UNPACKED_BYTES_MAX: u64 = 2 << 30;

/// Reads a PCD file.
pub fn read(bytes: &[u8]) -> Result<PointFile, FormatError> {
    let mut lines = Lines::new(bytes);
    let header = header::read(bytes, &mut lines)?;
    match header.data {
        Data::Ascii => ascii(&header, lines),
        Data::Binary => binary(&header, &lines),
        Data::Compressed => compressed(&header, &lines),
    }
}

/// The sensor's pose from a file or its first bytes; none if the header has none.
pub fn read_pose(bytes: &[u8]) -> Result<Option<Isometry3<f64>>, FormatError> {
    Ok(header::read(bytes, &mut Lines::new(bytes))?.pose)
}

fn ascii(header: &PcdHeader, mut lines: Lines<'_>) -> Result<PointFile, FormatError> {
    let row = header.row(true);
    let room = lines.rest().len() as u64;
    // Each value takes at least a character and a space or line end; the last line end may be missing.
    let needs = header.points * 2 * row.values as u64;
    if needs > room + 1 {
        return Err(FormatError::cut_off(lines.at(), format!("data of {} points", header.points), needs, room));
    }
    let mut file = PointFile::with_capacity(header.points, header.pose);
    let mut points = 0;
    while let Some(line) = lines.next_data(points + 1 == header.points)? {
        if points == header.points {
            return Err(FormatError::value(
                line.place(),
                "the number of points",
                format!("more than {points}"),
                "the number of POINTS",
            ));
        }
        let mut point = [0.0; 3];
        let mut values = 0;
        for word in line.words() {
            if let Some(axis) = row.value.iter().position(|&value| value == values) {
                point[axis] = line.parse(["x", "y", "z"][axis], Some(word), "a number")?;
            }
            values += 1;
        }
        if values != row.values {
            let found = format!("{values} values");
            return Err(FormatError::value(line.place(), "the line", found, format!("{} values", row.values)));
        }
        file.push(point);
        points += 1;
    }
    if points < header.points {
        return Err(FormatError::lines_cut_off(lines.number(), "data", header.points, points));
    }
    Ok(file)
}

fn binary(header: &PcdHeader, lines: &Lines<'_>) -> Result<PointFile, FormatError> {
    let row = header.row(true);
    let (data, room) = (lines.rest(), lines.rest().len() as u64);
    let needs = header.points * row.bytes as u64;
    if needs > room {
        return Err(FormatError::cut_off(lines.at(), format!("data of {} points", header.points), needs, room));
    }
    let (data, behind) = data.split_at(usize::try_from(needs).unwrap_or(data.len()));
    only_padding(behind, lines.at() + needs)?;
    let mut file = PointFile::with_capacity(header.points, header.pose);
    for bytes in data.chunks_exact(row.bytes) {
        file.push(std::array::from_fn(|axis| row.scalar[axis].read(bytes, row.byte[axis], Endian::Little)));
    }
    Ok(file)
}

/// Compressed data: packed length, unpacked length, then all values of the first field, all values of the second …
fn compressed(header: &PcdHeader, lines: &Lines<'_>) -> Result<PointFile, FormatError> {
    let (data, at) = (lines.rest(), lines.at());
    let Some(([a, b, c, d, e, f, g, h], data)) = data.split_first_chunk::<8>() else {
        return Err(FormatError::cut_off(at, "the length of compressed data", 8, data.len() as u64));
    };
    let packed = u64::from(u32::from_le_bytes([*a, *b, *c, *d]));
    let unpacked = u64::from(u32::from_le_bytes([*e, *f, *g, *h]));
    if packed > data.len() as u64 {
        return Err(FormatError::cut_off(at + 8, "compressed data", packed, data.len() as u64));
    }
    let (data, behind) = data.split_at(usize::try_from(packed).unwrap_or(data.len()));
    only_padding(behind, at + 8 + packed)?;
    // Compressed data may omit padding fields, which have the name "_".
    let rows = [header.row(true), header.row(false)];
    let Some(row) = rows.iter().find(|row| row.bytes as u64 * header.points == unpacked) else {
        return Err(FormatError::value(
            FilePlace::Byte(at + 4),
            "the unpacked length",
            unpacked,
            format!("{}, for {} points", rows[0].bytes as u64 * header.points, header.points),
        ));
    };
    if unpacked > UNPACKED_BYTES_MAX {
        return Err(FormatError::too_many(
            FilePlace::Byte(at + 4),
            "the unpacked length",
            unpacked,
            UNPACKED_BYTES_MAX,
        ));
    }
    let data = lzf::unpack(data, usize::try_from(unpacked).unwrap_or(0), at + 8)?;
    let mut file = PointFile::with_capacity(header.points, header.pose);
    let points = usize::try_from(header.points).unwrap_or(0);
    for index in 0..points {
        file.push(std::array::from_fn(|axis| {
            // First the preceding fields, then the preceding points.
            let offset = row.byte[axis] * points + row.scalar[axis].bytes() * index;
            row.scalar[axis].read(&data, offset, Endian::Little)
        }));
    }
    Ok(file)
}

fn only_padding(behind: &[u8], at: u64) -> Result<(), FormatError> {
    match behind.iter().position(|&byte| byte != 0) {
        None => Ok(()),
        Some(_) => Err(FormatError::trailing(at, behind.len() as u64, "the last point")),
    }
}
