//! Grey images: PGM files, as text (P2) and as bytes (P5), with 1 or 2 bytes for each pixel.
//!
//! Invariant: an image has one value for each pixel, none above its `max`; a file that is truncated, or followed by
//! anything except white space, is refused.

use crate::{
    CELLS_MAX,
    error::{FilePlace, FormatError, FormatProblem, shown, shown_start},
};

/// An image.
#[derive(Debug)]
pub(super) struct Image {
    /// Number of pixels in a row.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// The value of white.
    pub max: u16,
    /// The pixels, the top row first.
    pub values: Vec<u16>,
    /// Whether each pixel is transparent, at least in part; empty: none is.
    pub transparent: Vec<bool>,
}

/// Reads an image.
pub(super) fn read(bytes: &[u8]) -> Result<Image, FormatError> {
    let text = match bytes.get(..2) {
        Some(b"P2") => true,
        Some(b"P5") => false,
        _ => {
            return Err(FormatError::value(
                FilePlace::Byte(0),
                "the start of the image",
                shown_start(bytes),
                "\"P2\" or \"P5\", as in a PGM file, or a PNG file; convert other images to PGM",
            ));
        }
    };
    let mut words = Words { bytes, at: 2 };
    let at = |words: &Words<'_>| FilePlace::Byte(words.at as u64);
    let (width, width_at) = words.number("the image's width", 1, u32::MAX)?;
    let (height, _) = words.number("the image's height", 1, u32::MAX)?;
    let (max, _) = words.number("the image's highest value", 1, u32::from(u16::MAX))?;
    // The range above fits.
    let max = u16::try_from(max).unwrap_or(u16::MAX);
    let pixels = u64::from(width) * u64::from(height);
    if pixels > CELLS_MAX {
        return Err(FormatError::too_many(width_at, "the number of pixels", pixels, CELLS_MAX));
    }
    // The header ends with one white space.
    if words.bytes.get(words.at).is_none_or(|byte| !byte.is_ascii_whitespace()) {
        return Err(FormatError { place: at(&words), problem: FormatProblem::NoLineEnd });
    }
    words.at += 1;
    let each = if text || max > 255 { 2 } else { 1 };
    let room = (bytes.len() - words.at) as u64;
    if pixels * each > room {
        let what = format!("an image of {width} by {height} pixels");
        return Err(FormatError::cut_off(words.at as u64, what, pixels * each, room));
    }
    let pixels = usize::try_from(pixels).unwrap_or(0);
    let mut values = Vec::with_capacity(pixels);
    if text {
        for _ in 0..pixels {
            let (value, _) = words.number("a pixel", 0, u32::from(max))?;
            values.push(u16::try_from(value).unwrap_or(max));
        }
        if words.bytes.get(words.at).is_none_or(|byte| !byte.is_ascii_whitespace()) {
            return Err(FormatError { place: at(&words), problem: FormatProblem::NoLineEnd });
        }
    } else {
        let wide = usize::from(max > 255) + 1;
        for (index, pixel) in bytes[words.at..].chunks_exact(wide).take(pixels).enumerate() {
            let value = pixel.iter().fold(0, |value, &byte| value << 8 | u16::from(byte));
            if value > max {
                let place = FilePlace::Byte((words.at + index * wide) as u64);
                return Err(FormatError::value(place, "a pixel", value, format!("at most {max}")));
            }
            values.push(value);
        }
        words.at += pixels * wide;
    }
    let behind = bytes[words.at..].trim_ascii();
    if !behind.is_empty() {
        return Err(FormatError::trailing(words.at as u64, behind.len() as u64, "the last pixel"));
    }
    Ok(Image { width, height, max, values, transparent: Vec::new() })
}

/// The words of a header, or of an image that is text.
struct Words<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Words<'_> {
    /// The next number and its place.
    fn number(&mut self, what: &str, min: u32, max: u32) -> Result<(u32, FilePlace), FormatError> {
        self.skip_space();
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let place = FilePlace::Byte(self.at as u64);
        if rest.is_empty() {
            return Err(FormatError::cut_off(self.at as u64, what, 1, 0));
        }
        let word = rest.split(|byte| byte.is_ascii_whitespace() || *byte == b'#').next().unwrap_or_default();
        let number = std::str::from_utf8(word).ok().and_then(|word| word.parse::<u32>().ok());
        match number.filter(|number| (min..=max).contains(number)) {
            Some(number) => {
                self.at += word.len();
                Ok((number, place))
            }
            None => {
                let found = shown(&String::from_utf8_lossy(&word[..word.len().min(100)]));
                Err(FormatError::value(place, what, found, format!("a number from {min} to {max}")))
            }
        }
    }

    /// Skips white space and comments, which go from # to the end of the line.
    fn skip_space(&mut self) {
        let mut comment = false;
        while let Some(&byte) = self.bytes.get(self.at) {
            comment = (comment || byte == b'#') && byte != b'\n' && byte != b'\r';
            if !comment && !byte.is_ascii_whitespace() {
                return;
            }
            self.at += 1;
        }
    }
}
