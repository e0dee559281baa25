//! A map as points: a binary PLY file with a vertex at the centre of every known cell.
//!
//! Properties: x, y, z and probability as float; red, green and blue as uchar. In a picture of entropy, the property
//! probability has the entropy in bits.
//!
//! Invariant: unknown cells are omitted; the vertices are in the order of the picture.

use crate::{MapPicture, PictureError};

/// Length of a vertex.
const VERTEX_BYTES: usize = 4 * 4 + 3;

/// The known cells as a PLY file, little-endian.
#[allow(clippy::cast_possible_truncation, reason = "the format's points are float")]
pub fn write(picture: &MapPicture) -> Result<Vec<u8>, PictureError> {
    picture.check()?;
    let vertices = picture.known().count();
    let mut file = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n\
         property float z\nproperty float probability\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
         end_header\n"
    )
    .into_bytes();
    file.reserve_exact(vertices * VERTEX_BYTES);
    for (centre, cell) in picture.known() {
        let value = picture.value_of(cell).unwrap_or_default();
        for number in centre.map(|coordinate| coordinate as f32).into_iter().chain([value]) {
            file.extend(number.to_le_bytes());
        }
        file.extend(picture.colour(cell));
    }
    Ok(file)
}
