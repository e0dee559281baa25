//! The known cells of a map as CSV: `x,y,z,probability,entropy_bits,changing,observed,cell_x,cell_y,cell_z`.
//!
//! x, y and z are the centre of the cell in metres; `changing` is whether the cell has a temporal model. Unknown cells
//! are omitted, so `observed` is `true` in every row; the column is for joins with other tables. The last three columns
//! are the cell's index along each axis, which is part of the name of its state, `cell/X/Y/Z`; in a projected map
//! cell_z is 0.
//!
//! Invariant: one row for each known cell, in the order of the picture.

use std::fmt::Write as _;

use tidemap_model::entropy_bits;

use super::{MapPicture, PictureCell, PictureError};

/// The first line.
pub const HEADER: &str = "x,y,z,probability,entropy_bits,changing,observed,cell_x,cell_y,cell_z";

/// The known cells as a CSV file.
pub fn write(picture: &MapPicture) -> Result<String, PictureError> {
    picture.check()?;
    let mut file = format!("{HEADER}\n");
    for ((centre, cell), (index, _)) in picture.known().zip(picture.known_indices()) {
        let Some(probability) = cell.probability() else { continue };
        let [x, y, z] = centre.map(micrometres);
        let [cell_x, cell_y, cell_z] = index;
        let entropy = entropy_bits(f64::from(probability));
        let changing = matches!(cell, PictureCell::Changing { .. });
        // Writing to a String does not fail.
        let _ = writeln!(file, "{x},{y},{z},{probability},{entropy:.6},{changing},true,{cell_x},{cell_y},{cell_z}");
    }
    Ok(file)
}

/// Removes rounding errors of sums such as 0.1 + 0.05.
fn micrometres(metres: f64) -> f64 {
    // Adding zero turns -0 into 0.
    (metres * 1e6).round() / 1e6 + 0.0
}

#[cfg(test)]
mod tests {
    use super::{super::picture::samples, *};

    #[test]
    fn known_cells_have_a_row() -> Result<(), PictureError> {
        let mut picture = samples::flat();
        picture.cells[5] = PictureCell::Changing { probability: 0.11 };
        let rows = [
            HEADER,
            "-1.475,2.025,0.025,0,0.000000,false,true,-30,40,0",
            "-1.425,2.025,0.025,1,0.000000,false,true,-29,40,0",
            "-1.475,2.075,0.025,0,0.000000,true,true,-30,41,0",
            "-1.425,2.075,0.025,0.5,1.000000,true,true,-29,41,0",
            "-1.375,2.075,0.025,0.11,0.499916,true,true,-28,41,0",
        ];
        assert_eq!(write(&picture)?, format!("{}\n", rows.join("\n")));
        Ok(())
    }
}
