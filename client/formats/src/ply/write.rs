//! A map as points: a binary PLY file with a vertex at the centre of every known cell.
//!
//! Properties: x, y and z as float, or as double where a float would shift a centre by more than a tenth of a cell;
//! probability as float; red, green and blue as uchar. In a picture of entropy, the property probability has the
//! entropy in bits.
//!
//! Invariant: unknown cells are omitted; the vertices are in the order of the picture.

use crate::{MapPicture, PictureError};

/// Length of a vertex without its coordinates.
const COLOUR_BYTES: usize = 4 + 3;
/// The part of a cell by which a coordinate may be rounded.
const ROUNDED_MAX: f64 = 0.1;

/// The known cells as a PLY file, little-endian.
pub fn write(picture: &MapPicture) -> Result<Vec<u8>, PictureError> {
    picture.check()?;
    let vertices = picture.known().count();
    let is_double = needs_double(picture);
    let (number, number_bytes) = if is_double { ("double", 8) } else { ("float", 4) };
    let mut file = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty {number} x\nproperty {number} y\n\
         property {number} z\nproperty float probability\nproperty uchar red\nproperty uchar green\nproperty uchar \
         blue\nend_header\n"
    )
    .into_bytes();
    file.reserve_exact(vertices * (3 * number_bytes + COLOUR_BYTES));
    for (centre, cell) in picture.known() {
        for coordinate in centre {
            put(&mut file, coordinate, is_double);
        }
        file.extend(picture.value_of(cell).unwrap_or_default().to_le_bytes());
        file.extend(picture.colour(cell));
    }
    Ok(file)
}

#[allow(clippy::cast_possible_truncation, reason = "a float is precise enough where it is chosen")]
fn put(file: &mut Vec<u8>, coordinate: f64, is_double: bool) {
    if is_double { file.extend(coordinate.to_le_bytes()) } else { file.extend((coordinate as f32).to_le_bytes()) }
}

/// Whether a float could be wrong by more than a tenth of a cell.
fn needs_double(picture: &MapPicture) -> bool {
    let length = |axis: usize| f64::from(picture.size_cells[axis]) * picture.resolution_m;
    let farthest = |axis: usize| picture.origin_m[axis].abs().max((picture.origin_m[axis] + length(axis)).abs());
    let rounded = (0..3).map(farthest).fold(0.0, f64::max) * f64::from(f32::EPSILON) / 2.0;
    rounded > ROUNDED_MAX * picture.resolution_m
}
