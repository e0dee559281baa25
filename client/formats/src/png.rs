//! A picture of a map as PNG: a pixel for each cell, or a square of pixels, y upwards.
//!
//! Unknown cells are mid-grey, static cells white if free and black if occupied, and changing cells coloured by their
//! value, from pale blue at 0 through light orange to dark orange at 1. A picture of entropy shows all cells as
//! changing.
//!
//! Invariant: the colours are those of the module `colour`; the file has no metadata such as time or name.

use tidemap_picture::{Canvas, CanvasError, Legend, LegendRow, fitting_scale};

use super::{
    CELLS_MAX, MapPicture, PictureError, PictureValue,
    colour::{FREE, OCCUPIED, UNKNOWN, changing, colour},
};

impl From<CanvasError> for PictureError {
    fn from(error: CanvasError) -> Self {
        Self::Encode(error.to_string())
    }
}

/// The picture as a PNG file; a cell has `scale` pixels along each side, at least 1.
///
/// # Errors
/// The picture is invalid, or has more pixels than a file takes.
pub fn write(picture: &MapPicture, scale: u32) -> Result<Vec<u8>, PictureError> {
    Ok(canvas(picture, scale)?.png()?)
}

/// The picture for people: with a legend and a scale bar below it. `scale`: as in [`write`]; none: so that it can be
/// read. `caption`: what it shows.
///
/// # Errors
/// As those of [`write`].
pub fn write_for_people(
    picture: &MapPicture,
    scale: Option<u32>,
    value: PictureValue,
    caption: &str,
) -> Result<Vec<u8>, PictureError> {
    let [width, height, _] = picture.size_cells;
    let scale = scale.unwrap_or_else(|| fitting_scale(width, height));
    let drawn = canvas(picture, scale)?;
    let range: Vec<_> = (0..=16_u8).map(|step| changing(f32::from(step) / 16.0)).collect();
    let mut rows = Vec::new();
    if value != PictureValue::Entropy {
        rows.push(LegendRow::new(vec![FREE], "always free"));
        rows.push(LegendRow::new(vec![OCCUPIED], "always occupied"));
    }
    let changes = if rows.is_empty() { "" } else { "changes: " };
    rows.push(match value {
        PictureValue::AtLeast(_) => {
            LegendRow::new(vec![changing(0.0), changing(1.0)], &format!("0, 1: {}", value.text()))
        }
        _ => LegendRow::new(range, &format!("{changes}{}, 0 to 1", value.text())),
    });
    rows.push(LegendRow::new(vec![UNKNOWN], "not observed"));
    let legend =
        Legend { caption: caption.to_owned(), rows, metres_per_pixel: picture.resolution_m / f64::from(scale) };
    Ok(legend.below(&drawn).png()?)
}

/// The cells in their colours.
fn canvas(picture: &MapPicture, scale: u32) -> Result<Canvas, PictureError> {
    picture.check_flat()?;
    let scale = scale.max(1);
    let found = picture.cells.len() as u128 * u128::from(scale).pow(2);
    if found > u128::from(CELLS_MAX) {
        return Err(PictureError::TooLarge { found });
    }
    let cells = picture.rows_from_top().flatten().map(|&cell| colour(cell));
    Ok(Canvas::of_cells(picture.size_cells[0] as usize, cells, scale))
}

#[cfg(test)]
mod tests {
    use super::{super::picture::samples, *};

    #[test]
    fn a_picture_is_read_back_pixel_by_pixel() -> Result<(), Box<dyn std::error::Error>> {
        let file = write(&samples::flat(), 1)?;
        let mut reader = ::png::Decoder::new(std::io::Cursor::new(&file)).read_info()?;
        let mut pixels = vec![0; reader.output_buffer_size().ok_or("too large")?];
        let frame = reader.next_frame(&mut pixels)?;
        assert_eq!((frame.width, frame.height), (3, 2));
        assert_eq!((frame.color_type, frame.bit_depth), (::png::ColorType::Rgb, ::png::BitDepth::Eight));
        // The upper row is the one with the larger y, which is the second of the picture.
        let upper = [[150, 205, 250], [253, 190, 90], [205, 70, 0]];
        let lower = [[255, 255, 255], [0, 0, 0], [128, 128, 128]];
        assert_eq!(pixels, [upper, lower].concat().concat());
        Ok(())
    }

    #[test]
    fn a_cell_may_have_several_pixels() -> Result<(), Box<dyn std::error::Error>> {
        let file = write(&samples::flat(), 2)?;
        let mut reader = ::png::Decoder::new(std::io::Cursor::new(&file)).read_info()?;
        let mut pixels = vec![0; reader.output_buffer_size().ok_or("too large")?];
        let frame = reader.next_frame(&mut pixels)?;
        assert_eq!((frame.width, frame.height), (6, 4));
        assert_eq!(pixels[..6], [150, 205, 250, 150, 205, 250], "the first cell twice");
        assert_eq!(pixels[..18], pixels[18..36], "the first row twice");
        assert!(matches!(write(&samples::flat(), 9_000), Err(PictureError::TooLarge { .. })));
        Ok(())
    }

    #[test]
    fn people_get_larger_cells_and_a_legend() -> Result<(), Box<dyn std::error::Error>> {
        let mut sizes = Vec::new();
        for value in [PictureValue::Probability, PictureValue::Entropy, PictureValue::AtLeast(0.5)] {
            let file = write_for_people(&samples::flat(), None, value, "office, Tue 10:00")?;
            let mut reader = ::png::Decoder::new(std::io::Cursor::new(&file)).read_info()?;
            let mut pixels = vec![0; reader.output_buffer_size().ok_or("too large")?];
            let frame = reader.next_frame(&mut pixels)?;
            assert!(frame.width > 3 * 16 && frame.height > 2 * 16 + 80, "{frame:?}");
            let pixel = |x: usize, y: usize| &pixels[(y * frame.width as usize + x) * 3..][..3];
            assert_eq!(
                (pixel(15, 15), pixel(16, 0), pixel(47, 31)),
                (&[150, 205, 250][..], &[253, 190, 90][..], &[128; 3][..])
            );
            sizes.push(frame.height);
        }
        assert!(sizes[0] > sizes[1], "entropy has no rows for cells that do not change: {sizes:?}");
        Ok(())
    }

    #[test]
    fn layers_are_refused() {
        let mut picture = samples::flat();
        picture.size_cells = [3, 1, 2];
        assert_eq!(write(&picture, 1), Err(PictureError::Layers(2)));
    }
}
