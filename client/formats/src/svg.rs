//! A writer of SVG files, which all drawings of maps, tours, topologies and experiments use.
//!
//! Invariant: the same calls give the same bytes; text is escaped, so that no name breaks the file.

use std::fmt::Write as _;

pub mod chart;

/// An SVG file to which elements are added, each on a line of its own. Coordinates are pixels, y downwards.
pub struct Svg(String);

impl Svg {
    /// An empty drawing on a white background.
    pub fn new(size: [f64; 2], font_size: f64) -> Self {
        let mut svg = Self::with_attributes(size, font_size, "fill=\"#111111\"");
        svg.0.push_str("<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n");
        svg
    }

    /// An empty drawing without background; `attributes` are the defaults of all its elements.
    pub fn with_attributes([width, height]: [f64; 2], font_size: f64, attributes: &str) -> Self {
        Self(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
             viewBox=\"0 0 {width:.1} {height:.1}\" font-family=\"sans-serif\" font-size=\"{font_size}\" {attributes}>\n"
        ))
    }

    /// A line from (`x1`, `y1`) to (`x2`, `y2`); `style` is a list of attributes, here and below.
    pub fn line(&mut self, [x1, y1, x2, y2]: [f64; 4], style: &str) {
        self.add(format_args!("<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" {style}/>"));
    }

    /// A line through several points.
    pub fn polyline(&mut self, points: impl IntoIterator<Item = [f64; 2]>, style: &str) {
        let points: Vec<String> = points.into_iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
        self.add(format_args!("<polyline points=\"{}\" fill=\"none\" {style}/>", points.join(" ")));
    }

    /// A filled shape.
    pub fn polygon(&mut self, points: impl IntoIterator<Item = [f64; 2]>, style: &str) {
        let points: Vec<String> = points.into_iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
        self.add(format_args!("<polygon points=\"{}\" {style}/>", points.join(" ")));
    }

    /// A rectangle by its upper left corner and size.
    pub fn rectangle(&mut self, [x, y, width, height]: [f64; 4], style: &str) {
        self.add(format_args!("<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" {style}/>"));
    }

    /// A circle.
    pub fn circle(&mut self, [x, y]: [f64; 2], radius: f64, style: &str) {
        self.add(format_args!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" {style}/>"));
    }

    /// A text whose baseline starts at a point, or is centred on it or ends there by `text-anchor`.
    pub fn text(&mut self, [x, y]: [f64; 2], text: &str, style: &str) {
        let escaped: String = text.chars().map(escaped).collect();
        self.add(format_args!("<text x=\"{x:.1}\" y=\"{y:.1}\" {style}>{escaped}</text>"));
    }

    /// The file.
    pub fn finish(mut self) -> String {
        self.0.push_str("</svg>\n");
        self.0
    }

    fn add(&mut self, element: std::fmt::Arguments<'_>) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "{element}");
    }
}

/// A colour as an attribute's value.
pub fn hex([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// A character as XML text; a control character, which XML does not allow, becomes the replacement character.
fn escaped(character: char) -> String {
    match character {
        '&' => "&amp;".to_owned(),
        '<' => "&lt;".to_owned(),
        '>' => "&gt;".to_owned(),
        '"' => "&quot;".to_owned(),
        _ if character.is_control() => '\u{fffd}'.to_string(),
        _ => character.to_string(),
    }
}
