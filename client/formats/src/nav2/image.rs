//! The image of a grid: PGM or PNG, as grey values.
//!
//! A colour is read as the map servers of ROS read it: the mean of its channels, in mode trinary with the opacity as
//! one more channel.
//!
//! Invariant: an image has one value for each pixel, none above its `max`; the start of the file decides the format.

use std::io::Cursor;

use ::png::{BitDepth, ColorType, Decoder, DecodingError, Limits, Transformations};

use super::{
    FilePlace, FormatError, GridMode,
    pgm::{self, Image},
};
use crate::CELLS_MAX;

/// The start of a PNG file.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
/// Maximum number of bytes of a pixel: four channels of two bytes.
const PIXEL_BYTES_MAX: u64 = 8;

/// Reads an image for a grid of a mode.
pub(super) fn read(bytes: &[u8], mode: GridMode) -> Result<Image, FormatError> {
    if bytes.starts_with(PNG) { read_png(bytes, mode) } else { pgm::read(bytes) }
}

fn read_png(bytes: &[u8], mode: GridMode) -> Result<Image, FormatError> {
    let wrong = |error: DecodingError| {
        FormatError::value(FilePlace::Byte(0), "the PNG file", format!("damaged ({error})"), "a whole PNG file")
    };
    let limits = Limits { bytes: (CELLS_MAX * PIXEL_BYTES_MAX) as usize };
    let mut decoder = Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(wrong)?;
    let (width, height) = (reader.info().width, reader.info().height);
    let pixels = u64::from(width) * u64::from(height);
    if pixels > CELLS_MAX {
        return Err(FormatError::too_many(FilePlace::Byte(16), "the number of pixels", pixels, CELLS_MAX));
    }
    let size = reader.output_buffer_size().unwrap_or_default();
    let mut content = vec![0; size];
    reader.next_frame(&mut content).map_err(wrong)?;
    let (colour, depth) = reader.output_color_type();
    let channels = match colour {
        ColorType::Grayscale | ColorType::Indexed => 1,
        ColorType::GrayscaleAlpha => 2,
        ColorType::Rgb => 3,
        ColorType::Rgba => 4,
    };
    let (wide, max) = if depth == BitDepth::Sixteen { (2, u16::MAX) } else { (1, u16::from(u8::MAX)) };
    let has_opacity = matches!(channels, 2 | 4);
    let mut image = Image { width, height, max, values: Vec::new(), transparent: Vec::new() };
    for pixel in content.chunks_exact(channels * wide).take(usize::try_from(pixels).unwrap_or(0)) {
        let channel = |bytes: &[u8]| bytes.iter().fold(0_u64, |value, &byte| value << 8 | u64::from(byte));
        let values: Vec<u64> = pixel.chunks_exact(wide).map(channel).collect();
        let (colours, opacity) = match values.split_last() {
            Some((opacity, colours)) if has_opacity => (colours, Some(*opacity)),
            _ => (&values[..], None),
        };
        // Grey counts as three equal colours.
        let sum = colours.iter().sum::<u64>() * if colours.len() == 1 { 3 } else { 1 };
        let (sum, count) = match opacity {
            Some(opacity) if mode == GridMode::Trinary => (sum + opacity, 4),
            _ => (sum, 3),
        };
        image.values.push(u16::try_from((sum + count / 2) / count).unwrap_or(max));
        if let Some(opacity) = opacity {
            image.transparent.push(opacity < u64::from(max));
        }
    }
    Ok(image)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png(colour: ColorType, content: &[u8], [width, height]: [u32; 2]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = ::png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(colour);
        let mut writer = encoder.write_header().expect("a header");
        writer.write_image_data(content).expect("pixels");
        writer.finish().expect("an end");
        bytes
    }

    #[test]
    fn a_png_file_has_the_pixels_of_a_pgm_file() -> Result<(), FormatError> {
        let pixels = [0, 205, 254, 255, 128, 3];
        let pgm = [&b"P5\n3 2\n255\n"[..], &pixels].concat();
        let rgb: Vec<u8> = pixels.iter().flat_map(|&grey| [grey; 3]).collect();
        let expected = read(&pgm, GridMode::Trinary)?.values;
        for png in [png(ColorType::Grayscale, &pixels, [3, 2]), png(ColorType::Rgb, &rgb, [3, 2])] {
            let image = read(&png, GridMode::Trinary)?;
            assert_eq!((image.width, image.height, image.max), (3, 2, 255));
            assert_eq!((&image.values, image.transparent.len()), (&expected, 0));
        }
        Ok(())
    }

    #[test]
    fn opacity_is_a_channel_in_mode_trinary_and_unknown_in_mode_scale() -> Result<(), FormatError> {
        let bytes = png(ColorType::Rgba, &[0, 0, 0, 255, 100, 110, 120, 0], [2, 1]);
        assert_eq!(read(&bytes, GridMode::Trinary)?.values, [64, 83]);
        let scale = read(&bytes, GridMode::Scale)?;
        assert_eq!((scale.values, scale.transparent), (vec![0, 110], vec![false, true]));
        Ok(())
    }

    #[test]
    fn a_png_file_that_is_cut_off_is_refused() {
        let whole = png(ColorType::Grayscale, &[7; 6], [3, 2]);
        for length in 8..whole.len() - 13 {
            assert!(read(&whole[..length], GridMode::Trinary).is_err(), "{length} of {} bytes", whole.len());
        }
    }
}
