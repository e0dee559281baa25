//! A picture of a map as PNG: a pixel for each cell, or a square of pixels, y upwards.
//!
//! Free cells are white, occupied ones black, unknown ones grey, and probabilities between have a scale of colours.
//!
//! Invariant: the colours are those of [`tidemap_picture::Painter`]; the file has no metadata such as time or name.

use tidemap_picture::{Canvas, CanvasError, Legend, LegendRow, fitting_scale, palette::occupancy};

use super::{CELLS_MAX, MapPicture, PictureError, PictureValue};

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
pub fn write_for_people(picture: &MapPicture, scale: Option<u32>, caption: &str) -> Result<Vec<u8>, PictureError> {
    let [width, height, _] = picture.size_cells;
    let scale = scale.unwrap_or_else(|| fitting_scale(width, height));
    let drawn = canvas(picture, scale)?;
    let mut rows = picture.painter().legend();
    if let (PictureValue::AtLeast(_), Some(first)) = (picture.value, rows.first_mut()) {
        *first = LegendRow::new([0.0, 1.0].map(occupancy).to_vec(), &format!("0, 1: {}", picture.value.text()));
    }
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
    let cells = picture.rows_from_top().flatten().map(|&cell| picture.colour(cell));
    Ok(Canvas::of_cells(picture.size_cells[0] as usize, cells, scale))
}

#[cfg(test)]
mod tests {
    use tidemap_picture::palette::UNKNOWN;

    use super::{super::picture::samples, *};

    const HALF: [u8; 3] = [239, 84, 60];

    #[test]
    fn a_picture_is_read_back_pixel_by_pixel() -> Result<(), Box<dyn std::error::Error>> {
        let file = write(&samples::flat(), 1)?;
        let mut reader = ::png::Decoder::new(std::io::Cursor::new(&file)).read_info()?;
        let mut pixels = vec![0; reader.output_buffer_size().ok_or("too large")?];
        let frame = reader.next_frame(&mut pixels)?;
        assert_eq!((frame.width, frame.height), (3, 2));
        assert_eq!((frame.color_type, frame.bit_depth), (::png::ColorType::Rgb, ::png::BitDepth::Eight));
        // The upper row is the one with the larger y, which is the second of the picture.
        let upper = [[255; 3], HALF, [0; 3]];
        let lower = [[255; 3], [0; 3], UNKNOWN];
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
        assert_eq!(pixels[..6], [255; 6], "the first cell twice");
        assert_eq!(pixels[6..12], [HALF, HALF].concat(), "the second cell twice");
        assert_eq!(pixels[..18], pixels[18..36], "the first row twice");
        assert!(matches!(write(&samples::flat(), 9_000), Err(PictureError::TooLarge { .. })));
        Ok(())
    }

    #[test]
    fn people_get_larger_cells_and_a_legend() -> Result<(), Box<dyn std::error::Error>> {
        let mut sizes = Vec::new();
        for value in [PictureValue::Probability, PictureValue::Entropy, PictureValue::AtLeast(0.5)] {
            let picture = MapPicture { value, ..samples::flat() };
            let file = write_for_people(&picture, None, "office, Tue 10:00")?;
            let mut reader = ::png::Decoder::new(std::io::Cursor::new(&file)).read_info()?;
            let mut pixels = vec![0; reader.output_buffer_size().ok_or("too large")?];
            let frame = reader.next_frame(&mut pixels)?;
            assert!(frame.width > 3 * 16 && frame.height > 2 * 16 + 80, "{frame:?}");
            let pixel = |x: usize, y: usize| &pixels[(y * frame.width as usize + x) * 3..][..3];
            assert_eq!((pixel(15, 15), pixel(47, 31)), (&[255; 3][..], &UNKNOWN[..]));
            assert_eq!(pixel(16, 0), picture.colour(picture.cells[4]), "{value:?}");
            sizes.push(frame.height);
        }
        assert!(sizes[0] < sizes[1], "entropy has a row for the walls beneath it: {sizes:?}");
        Ok(())
    }

    #[test]
    fn entropy_is_painted_over_the_walls() {
        let picture = MapPicture { value: PictureValue::Entropy, ..samples::flat() };
        let [free, wall, _, _, open, _] = picture.cells[..] else { unreachable!("six cells") };
        assert_eq!(picture.colour(free), [255; 3]);
        assert!(picture.colour(wall).iter().all(|&band| band < 64), "{:?}", picture.colour(wall));
        let [red, _, blue] = picture.colour(open);
        assert!(blue > red + 100, "an open cell is blue-green: {:?}", picture.colour(open));
    }

    #[test]
    fn layers_are_refused() {
        let mut picture = samples::flat();
        picture.size_cells = [3, 1, 2];
        assert_eq!(write(&picture, 1), Err(PictureError::Layers(2)));
    }
}
