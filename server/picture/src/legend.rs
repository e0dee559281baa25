//! The legend of a picture: the meaning of its colours, and its scale.
//!
//! Invariant: the legend stands below the picture, and neither hides nor changes a pixel of it.

use crate::{Canvas, Colour, LETTER_HEIGHT, scale_bar, text_width};

const PAPER: Colour = [255, 255, 255];
const INK: Colour = [17, 17, 17];
/// Pixels around the legend and between its parts.
const GAP: u32 = 10;
/// Height of a row, pixels.
const ROW: u32 = LETTER_HEIGHT + 8;
/// Width of the colours of a row, pixels.
const COLOURS: u32 = 96;
/// Maximum length of the scale bar, pixels.
const BAR_MAX: f64 = 240.0;

/// Colours and their meaning.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LegendRow {
    /// One colour, or the colours of a scale from its lowest value to its highest.
    pub colours: Vec<Colour>,
    /// The meaning of the colours.
    pub text: String,
}

/// The legend below a picture of a map.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Legend {
    /// The subject of the picture: the map, the time.
    pub caption: String,
    /// The colours.
    pub rows: Vec<LegendRow>,
    /// Length of a pixel's side in metres.
    pub metres_per_pixel: f64,
}

impl LegendRow {
    /// A row of the legend.
    pub fn new(colours: Vec<Colour>, text: &str) -> Self {
        Self { colours, text: text.to_owned() }
    }
}

impl Legend {
    /// Width and height of the picture with this legend below it, pixels.
    pub fn framed_size(&self, [width, height]: [u32; 2]) -> [u32; 2] {
        let texts = self.rows.iter().map(|row| COLOURS + GAP + text_width(&row.text));
        let bar = BAR_MAX as u32 + GAP + text_width("0.005 m");
        let widest = texts.chain([text_width(&self.caption), bar]).max().unwrap_or(0);
        let rows = u32::try_from(self.rows.len()).unwrap_or(u32::MAX).saturating_add(2);
        [width.max(widest + 2 * GAP), height.saturating_add(rows.saturating_mul(ROW)).saturating_add(2 * GAP)]
    }

    /// The picture, with the legend below it.
    #[must_use]
    pub fn below(&self, picture: &Canvas) -> Canvas {
        let [width, height] = self.framed_size(picture.size());
        let mut canvas = Canvas::new(width, height, PAPER);
        canvas.put([0, 0], picture);
        let mut y = picture.size()[1] + GAP;
        // A line between the picture and the legend, where both may be white.
        canvas.fill([0, picture.size()[1]], [width, 1], INK);
        canvas.text([GAP, y], &self.caption, INK);
        for row in &self.rows {
            y += ROW;
            let count = u32::try_from(row.colours.len()).unwrap_or(u32::MAX).max(1);
            canvas.fill([GAP, y], [COLOURS, LETTER_HEIGHT], INK);
            for (at, &colour) in (0..).zip(&row.colours) {
                let edge = |at: u32| 1 + (COLOURS - 2) * at / count;
                canvas.fill([GAP + edge(at), y + 1], [edge(at + 1) - edge(at), LETTER_HEIGHT - 2], colour);
            }
            canvas.text([GAP + COLOURS + GAP, y], &row.text, INK);
        }
        y += ROW;
        if let Some((length, text)) = scale_bar(1.0 / self.metres_per_pixel, BAR_MAX) {
            let length = (length.round() as u32).max(1);
            canvas.fill([GAP, y + LETTER_HEIGHT / 2], [length, 2], INK);
            canvas.fill([GAP, y + 2], [2, LETTER_HEIGHT - 4], INK);
            canvas.fill([(GAP + length).saturating_sub(2), y + 2], [2, LETTER_HEIGHT - 4], INK);
            canvas.text([GAP + length + GAP, y], &text, INK);
        }
        canvas
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GREEN: Colour = [0, 128, 0];

    fn legend() -> Legend {
        Legend {
            caption: "office".to_owned(),
            rows: vec![
                LegendRow::new(vec![GREEN], "free"),
                LegendRow::new((0..9).map(|at| [at; 3]).collect(), "0 to 1"),
            ],
            metres_per_pixel: 0.05,
        }
    }

    #[test]
    fn the_picture_stays_as_it_is_and_its_colours_are_explained() {
        let picture = Canvas::of_cells(2, [GREEN, INK, INK, GREEN], 8);
        let framed = legend().below(&picture);
        assert_eq!(framed.size(), legend().framed_size([16, 16]));
        for (x, y) in (0..16).flat_map(|x| (0..16).map(move |y| (x, y))) {
            assert_eq!(framed.at([x, y]), picture.at([x, y]));
        }
        let middle = |row: u32, x: u32| framed.at([GAP + x, 16 + GAP + row * ROW + LETTER_HEIGHT / 2]);
        assert_eq!(middle(1, COLOURS / 2), Some(GREEN));
        assert_eq!([1, COLOURS / 2, COLOURS - 2].map(|x| middle(2, x)), [[0; 3], [4; 3], [8; 3]].map(Some));
    }

    #[test]
    fn the_bar_has_the_length_that_it_shows() {
        // 240 pixels are 12 m, so the bar has 10 m: 200 pixels.
        let framed = legend().below(&Canvas::new(600, 1, GREEN));
        let y = 1 + GAP + 3 * ROW + LETTER_HEIGHT / 2;
        let inked = (0..GAP + 200).filter(|&x| framed.at([x, y]) == Some(INK)).count();
        assert_eq!((inked, framed.at([GAP + 200, y])), (200, Some(PAPER)));
    }

    #[test]
    fn a_picture_without_a_scale_has_no_bar() {
        for metres_per_pixel in [0.0, f64::NAN, f64::INFINITY, -1.0] {
            let framed = Legend { metres_per_pixel, ..legend() }.below(&Canvas::new(9, 9, GREEN));
            assert_eq!(framed.at([GAP, 9 + GAP + 3 * ROW + LETTER_HEIGHT / 2]), Some(PAPER), "{metres_per_pixel}");
        }
    }
}
