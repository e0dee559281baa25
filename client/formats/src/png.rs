//! A picture of a map as PNG: a pixel for each cell, or a square of pixels, y upwards.
//!
//! Unknown cells are mid-grey, static cells white if free and black if occupied, and changing cells coloured by their
//! value, from pale blue at 0 through light orange to dark orange at 1. A picture of entropy shows all cells as
//! changing.
//!
//! Invariant: the colours are those of the module `colour`; the file has no metadata such as time or name.

use super::{CELLS_MAX, MapPicture, PictureError, colour::colour};

/// The picture as a PNG file; a cell has `scale` pixels along each side, at least 1.
///
/// # Errors
/// The picture is invalid, or has more pixels than a file takes.
pub fn write(picture: &MapPicture, scale: u32) -> Result<Vec<u8>, PictureError> {
    picture.check_flat()?;
    let scale = scale.max(1);
    let found = picture.cells.len() as u128 * u128::from(scale).pow(2);
    if found > u128::from(CELLS_MAX) {
        return Err(PictureError::TooLarge { found });
    }
    let mut pixels = Vec::with_capacity(picture.cells.len() * 3 * (scale * scale) as usize);
    for row in picture.rows_from_top() {
        let line: Vec<u8> =
            row.iter().flat_map(|&cell| std::iter::repeat_n(colour(cell), scale as usize)).flatten().collect();
        for _ in 0..scale {
            pixels.extend_from_slice(&line);
        }
    }
    let mut file = Vec::new();
    let [width, height] = [picture.size_cells[0], picture.size_cells[1]].map(|side| side.saturating_mul(scale));
    let mut encoder = ::png::Encoder::new(&mut file, width, height);
    encoder.set_color(::png::ColorType::Rgb);
    encoder.set_depth(::png::BitDepth::Eight);
    let failed = |error: ::png::EncodingError| PictureError::Encode(error.to_string());
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(&pixels).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(file)
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
    fn layers_are_refused() {
        let mut picture = samples::flat();
        picture.size_cells = [3, 1, 2];
        assert_eq!(write(&picture, 1), Err(PictureError::Layers(2)));
    }
}
