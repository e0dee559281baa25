//! A canvas of pixels, and its PNG file.
//!
//! Invariant: three bytes a pixel, rows from the top; the number of bytes always fits width and height.

use crate::{Colour, letters};

/// A picture in pixels: x to the right, y downwards.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Canvas {
    width: u32,
    height: u32,
    pixels: Vec<u8>,
}

/// The reason why a canvas cannot be written as a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the picture cannot be encoded: {0}")]
pub struct CanvasError(String);

impl Canvas {
    /// A canvas of one colour.
    pub fn new(width: u32, height: u32, colour: Colour) -> Self {
        let count = width as usize * height as usize;
        Self { width, height, pixels: std::iter::repeat_n(colour, count).flatten().collect() }
    }

    /// Draws rows of cells, the upper one first. Each cell is a square of `scale` pixels; a last row that is not full
    /// is left out.
    pub fn of_cells(columns: usize, cells: impl IntoIterator<Item = Colour>, scale: u32) -> Self {
        let (columns, times) = (columns.max(1), scale.max(1) as usize);
        let mut pixels = Vec::new();
        let mut line = Vec::with_capacity(columns * times * 3);
        let mut height = 0;
        for (at, colour) in cells.into_iter().enumerate() {
            line.extend(std::iter::repeat_n(colour, times).flatten());
            if at % columns == columns - 1 {
                (0..times).for_each(|_| pixels.extend_from_slice(&line));
                height += scale.max(1);
                line.clear();
            }
        }
        let width = u32::try_from(columns * times).unwrap_or(u32::MAX);
        Self { width, height, pixels }
    }

    /// Width and height, pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// The bytes: red, green and blue of each pixel.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// The colour of a pixel; `None` outside.
    pub fn at(&self, [x, y]: [u32; 2]) -> Option<Colour> {
        let start = (y as usize * self.width as usize + x as usize) * 3;
        let pixel = self.pixels.get(start..start + 3).filter(|_| x < self.width)?;
        Some([pixel[0], pixel[1], pixel[2]])
    }

    /// Fills a rectangle given by its upper left corner and its size.
    pub fn fill(&mut self, [x, y]: [u32; 2], [width, height]: [u32; 2], colour: Colour) {
        let (right, bottom) = (x.saturating_add(width).min(self.width), y.saturating_add(height).min(self.height));
        for row in y..bottom {
            for column in x..right {
                let start = (row as usize * self.width as usize + column as usize) * 3;
                self.pixels[start..start + 3].copy_from_slice(&colour);
            }
        }
    }

    /// Writes a line of text, with its upper left corner at a pixel.
    pub fn text(&mut self, [x, y]: [u32; 2], text: &str, colour: Colour) {
        for (column, bits) in (0..).zip(letters::columns(text)) {
            for row in (0..8).filter(|row| bits >> row & 1 == 1) {
                let at = [x + column * letters::DOT, y + row * letters::DOT];
                self.fill(at, [letters::DOT; 2], colour);
            }
        }
    }

    /// Copies another canvas into this one.
    pub fn put(&mut self, [x, y]: [u32; 2], other: &Self) {
        let width = other.width.min(self.width.saturating_sub(x)) as usize * 3;
        for row in 0..other.height.min(self.height.saturating_sub(y)) {
            let from = row as usize * other.width as usize * 3;
            let to = ((y + row) as usize * self.width as usize + x as usize) * 3;
            if width > 0 {
                self.pixels[to..to + width].copy_from_slice(&other.pixels[from..from + width]);
            }
        }
    }

    /// The PNG file.
    ///
    /// # Errors
    /// The canvas has no pixels.
    pub fn png(&self) -> Result<Vec<u8>, CanvasError> {
        let failed = |error: png::EncodingError| CanvasError(error.to_string());
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.width, self.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header().map_err(failed)?;
        writer.write_image_data(&self.pixels).map_err(failed)?;
        writer.finish().map_err(failed)?;
        Ok(file)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RED: Colour = [255, 0, 0];
    const BLUE: Colour = [0, 0, 255];

    #[test]
    fn cells_become_squares() {
        let canvas = Canvas::of_cells(2, [RED, BLUE, BLUE, RED, RED], 3);
        assert_eq!(canvas.size(), [6, 6]);
        assert_eq!([[2, 2], [3, 2], [2, 3], [5, 5]].map(|at| canvas.at(at)), [RED, BLUE, BLUE, RED].map(Some));
        assert_eq!((canvas.at([6, 0]), canvas.at([0, 6])), (None, None));
    }

    #[test]
    fn what_lies_outside_is_not_drawn() {
        let mut canvas = Canvas::new(4, 3, RED);
        canvas.fill([3, 2], [u32::MAX, 9], BLUE);
        canvas.fill([9, 9], [1, 1], BLUE);
        canvas.text([100, 0], "outside", BLUE);
        canvas.put([2, 1], &Canvas::new(9, 1, BLUE));
        canvas.put([8, 8], &Canvas::new(1, 1, BLUE));
        let row = |y| (0..4).map(|x| canvas.at([x, y]) == Some(BLUE)).collect::<Vec<_>>();
        assert_eq!(row(0), [false; 4]);
        assert_eq!(row(1), [false, false, true, true]);
        assert_eq!(row(2), [false, false, false, true]);
    }

    #[test]
    fn a_file_is_read_back() -> Result<(), Box<dyn std::error::Error>> {
        let canvas = Canvas::of_cells(2, [RED, BLUE], 2);
        let file = canvas.png()?;
        let mut reader = png::Decoder::new(std::io::Cursor::new(&file)).read_info()?;
        let mut pixels = vec![0; reader.output_buffer_size().ok_or("too large")?];
        let frame = reader.next_frame(&mut pixels)?;
        assert_eq!(([frame.width, frame.height], pixels.as_slice()), (canvas.size(), canvas.pixels()));
        assert!(Canvas::new(0, 0, RED).png().is_err());
        Ok(())
    }
}
