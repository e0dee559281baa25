//! A picture of a map as PNG: a pixel for each cell, y upwards.
//!
//! Unknown cells are mid-grey, static cells white if free and black if occupied, and changing cells coloured by their
//! value, from pale blue at 0 through light orange to dark orange at 1. A picture of entropy shows all cells as
//! changing.
//!
//! Invariant: the colours are those of the module `colour`; the file has no metadata such as time or name.

use super::{MapPicture, PictureError, colour::colour};

/// The picture as a PNG file.
pub fn write(picture: &MapPicture) -> Result<Vec<u8>, PictureError> {
    picture.check_flat()?;
    let pixels: Vec<u8> = picture.rows_from_top().flatten().flat_map(|&cell| colour(cell)).collect();
    let mut file = Vec::new();
    let [width, height, _] = picture.size_cells;
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
        let file = write(&samples::flat())?;
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
    fn layers_are_refused() {
        let mut picture = samples::flat();
        picture.size_cells = [3, 1, 2];
        assert_eq!(write(&picture), Err(PictureError::Layers(2)));
    }
}
