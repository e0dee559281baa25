//! Heat maps: values in rows and columns, the first row at the top.
//!
//! Invariant: a cell without a value is blank as text and grey as SVG, a colour that no value has.

use std::{f64::consts::TAU, fmt::Write as _};

use tidemap_picture::{
    palette::{UNKNOWN, occupancy},
    scale_bar, short,
};

use super::label_line;
use crate::svg::{
    Svg,
    chart::{CHART_WIDTH, FONT_SIZE, HEADING, text_width},
    hex,
};

/// Maximum number of columns of which each takes two characters.
const WIDE: usize = 36;
/// From the least value to the greatest.
pub(crate) const SHADES: [char; 5] = ['·', '░', '▒', '▓', '█'];
/// From the right, counter-clockwise.
const ARROWS: [char; 8] = ['→', '↗', '↑', '↖', '←', '↙', '↓', '↘'];

/// Maximum length of a scale bar, in characters and in pixels.
const TEXT_BAR_MAX: f64 = 30.0;
const SVG_BAR_MAX: f64 = 180.0;

/// The scale bar of a map as text, of which a metre takes `per_m` characters.
pub(crate) fn text_bar(per_m: f64) -> Option<String> {
    let (length, metres) = scale_bar(per_m, TEXT_BAR_MAX)?;
    Some(format!("scale: ├{}┤ {metres}", "─".repeat((length.round() as usize).saturating_sub(2))))
}

/// Values in rows and columns.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HeatMap {
    /// The heading.
    pub title: String,
    /// A label for each row; may be empty.
    pub rows: Vec<String>,
    /// A label for each column; may be empty.
    pub columns: Vec<String>,
    /// The values, row by row.
    pub values: Vec<Vec<Option<f64>>>,
    /// The values of the lightest and the strongest shade.
    pub range: [f64; 2],
    /// The unit of the values.
    pub unit: String,
    /// Directions in some cells, row by row, in radians, counter-clockwise from the right; may be empty.
    pub arrows: Vec<Vec<Option<f64>>>,
    /// Edge of a cell in metres, where the values are a map: the drawing then has a scale bar.
    pub cell_m: Option<f64>,
}

/// An arrow through the middle of a cell.
fn draw_arrow(svg: &mut Svg, [x, y]: [f64; 2], edge: f64, direction: f64) {
    let at = |turn: f64, length: f64| {
        let (sin, cos) = (direction + turn).sin_cos();
        // Pixels grow downwards.
        [cos * length * edge, -sin * length * edge]
    };
    let (tip, tail) = (at(0.0, 0.4), at(0.0, -0.4));
    let style = "stroke=\"#b00020\" stroke-width=\"1.5\"";
    svg.line([x + tail[0], y + tail[1], x + tip[0], y + tip[1]], style);
    for turn in [2.6, -2.6] {
        let barb = at(turn, 0.25);
        svg.line([x + tip[0], y + tip[1], x + tip[0] + barb[0], y + tip[1] + barb[1]], style);
    }
}

impl HeatMap {
    /// The place of a value between the ends of the range, 0 to 1.
    fn share(&self, value: f64) -> f64 {
        let [low, high] = self.range;
        if high > low { ((value - low) / (high - low)).clamp(0.0, 1.0) } else { 0.0 }
    }

    fn shade(&self, value: Option<f64>) -> char {
        let last = SHADES.len() - 1;
        value
            .filter(|value| !value.is_nan())
            .map_or(' ', |value| SHADES[(self.share(value) * last as f64).round() as usize])
    }

    fn arrow(&self, row: usize, column: usize) -> Option<f64> {
        self.arrows.get(row)?.get(column).copied().flatten()
    }

    /// The arrow nearest to a direction in radians, counter-clockwise from the right.
    #[must_use]
    pub fn arrow_character(direction_rad: f64) -> char {
        let eighths = (direction_rad / TAU * 8.0).round().rem_euclid(8.0);
        ARROWS[eighths as usize % 8]
    }

    /// The characters of a cell: two shades, or an arrow and a shade.
    fn characters(&self, row: usize, column: usize, value: Option<f64>) -> [char; 2] {
        let shade = self.shade(value);
        let arrow = self.arrow(row, column).map(Self::arrow_character);
        [arrow.unwrap_or(shade), shade]
    }

    fn width(&self) -> usize {
        self.values.iter().map(Vec::len).max().unwrap_or(0)
    }

    /// The drawing as text: a character is about twice as high as wide, so a cell has two characters, or two rows share
    /// a line.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = format!("{}\n", self.title);
        let margin = self.rows.iter().map(|label| label.chars().count()).max().unwrap_or(0);
        let is_wide = self.width() <= WIDE;
        let lines: Vec<(usize, String)> = if is_wide {
            let line = |(row, values): (usize, &Vec<Option<f64>>)| {
                let characters = |(column, &cell): (usize, &Option<f64>)| self.characters(row, column, cell);
                (row, values.iter().enumerate().flat_map(characters).collect())
            };
            self.values.iter().enumerate().map(line).collect()
        } else {
            let line = |pair: &[Vec<Option<f64>>]| {
                let mean = |column: usize| {
                    let cells: Vec<f64> = pair.iter().filter_map(|row| row.get(column).copied().flatten()).collect();
                    (!cells.is_empty()).then(|| cells.iter().sum::<f64>() / cells.len() as f64)
                };
                (0..self.width()).map(|column| self.shade(mean(column))).collect()
            };
            self.values.chunks(2).map(line).enumerate().map(|(at, line)| (2 * at, line)).collect()
        };
        for (row, line) in lines {
            let label = self.rows.get(row).map_or("", String::as_str);
            let _ = writeln!(text, "{}", format!("  {label:<margin$} │{line}").trim_end());
        }
        let step = if is_wide { 2 } else { 1 };
        let labels = self.columns.iter().enumerate().map(|(column, label)| (column * step, label.clone()));
        let labels = label_line(labels);
        if !labels.is_empty() {
            let _ = writeln!(text, "  {:<margin$}  {labels}", "");
        }
        let shades: Vec<String> = SHADES.iter().map(ToString::to_string).collect();
        let [low, high] = self.range.map(short);
        let _ = writeln!(text, "  {}: {low} {} {high}", self.unit, shades.join(" "));
        if let Some(bar) = self.cell_m.and_then(|cell_m| text_bar(step as f64 / cell_m)) {
            let _ = writeln!(text, "  {bar}");
        }
        text
    }

    /// The drawing as SVG.
    #[must_use]
    pub fn svg(&self) -> String {
        let margin = self.rows.iter().map(|label| text_width(label, FONT_SIZE)).fold(0.0, f64::max) + 20.0;
        let (columns, rows) = (self.width().max(1) as f64, self.values.len() as f64);
        let edge = ((CHART_WIDTH - margin - 20.0) / columns).min(24.0);
        let mut svg = Svg::new([CHART_WIDTH, 110.0 + rows * edge], FONT_SIZE);
        svg.text([20.0, 26.0], &self.title, HEADING);
        for (row, values) in (0_u32..).zip(&self.values) {
            let y = 44.0 + f64::from(row) * edge;
            let below = FONT_SIZE / edge;
            // Labels of rows that are lower than a line of text would lie on each other.
            if below < 1.0 || f64::from(row) % below.ceil() == 0.0 {
                let label = self.rows.get(row as usize).map_or("", String::as_str);
                svg.text([margin - 8.0, y + edge / 2.0 + 4.0], label, "text-anchor=\"end\"");
            }
            for (column, value) in (0_u32..).zip(values) {
                let value = value.filter(|value| !value.is_nan());
                let fill = value.map_or(UNKNOWN, |value| occupancy(self.share(value)));
                let fill = format!("fill=\"{}\"", hex(fill));
                svg.rectangle([margin + f64::from(column) * edge, y, edge, edge], &fill);
                if let Some(direction) = self.arrow(row as usize, column as usize) {
                    let middle = [margin + (f64::from(column) + 0.5) * edge, y + edge / 2.0];
                    draw_arrow(&mut svg, middle, edge, direction);
                }
            }
        }
        let below = 44.0 + rows * edge + 18.0;
        let mut free = f64::MIN;
        for (column, label) in (0_u32..).zip(&self.columns) {
            let x = margin + f64::from(column) * edge;
            if x > free {
                svg.text([x, below], label, "");
                free = x + text_width(label, FONT_SIZE) + 8.0;
            }
        }
        let [low, high] = self.range.map(short);
        svg.text([margin, below + 28.0], &format!("{}: {low}", self.unit), "");
        let mut x = margin + text_width(&format!("{}: {low}", self.unit), FONT_SIZE) + 8.0;
        for shade in 0..=10_u8 {
            let fill = format!("fill=\"{}\"", hex(occupancy(f64::from(shade) / 10.0)));
            svg.rectangle([x, below + 16.0, 14.0, 14.0], &fill);
            x += 14.0;
        }
        svg.text([x + 8.0, below + 28.0], &high, "");
        if let Some((length, metres)) = self.cell_m.and_then(|cell_m| scale_bar(edge / cell_m, SVG_BAR_MAX)) {
            let (left, y) = (x + 60.0, below + 26.0);
            let bar = [[left, y - 5.0], [left, y], [left + length, y], [left + length, y - 5.0]];
            svg.polyline(bar, "stroke=\"#111111\" stroke-width=\"1.5\"");
            svg.text([left + length + 8.0, y + 2.0], &metres, "");
        }
        svg.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn week() -> HeatMap {
        HeatMap {
            title: "week".to_owned(),
            rows: ["Mon", "Tue"].map(str::to_owned).to_vec(),
            columns: (0..24).map(|hour| hour.to_string()).collect(),
            values: vec![(0..24).map(|hour| Some(f64::from(hour) / 23.0)).collect(), vec![None; 24]],
            range: [0.0, 1.0],
            unit: "probability".to_owned(),
            arrows: Vec::new(),
            cell_m: None,
        }
    }

    #[test]
    fn maps_have_a_scale_bar() {
        assert!(!week().text().contains("scale"));
        let map = HeatMap { cell_m: Some(0.5), ..week() };
        // Two characters a cell of half a metre: five metres are twenty characters.
        assert!(map.text().ends_with(&format!("  scale: ├{}┤ 5 m\n", "─".repeat(18))), "{}", map.text());
        assert!(map.svg().contains(">5 m</text>") || map.svg().contains(">2 m</text>"));
    }

    #[test]
    fn cells_have_shades_and_unknown_ones_none() {
        let text = week().text();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!((lines[0], lines[2]), ("week", "  Tue │"));
        assert!(lines[1].starts_with("  Mon │······░░") && lines[1].ends_with('█'), "{text}");
        assert_eq!(lines[1].chars().count(), 7 + 48);
        assert!(lines[3].contains("0   2   4") || lines[3].contains("0  "), "{text}");
        assert_eq!(lines[4], "  probability: 0 · ░ ▒ ▓ █ 1");
    }

    #[test]
    fn arrows_show_directions() {
        let quarter = TAU / 4.0;
        let arrows = vec![vec![Some(0.0), Some(quarter), Some(-2.0 * quarter), Some(3.5 * quarter)], vec![None; 4]];
        let values = vec![vec![Some(1.0); 4]; 2];
        let map = HeatMap { values, arrows, range: [0.0, 1.0], ..HeatMap::default() };
        assert!(map.text().contains("│→█↑█←█↘█\n") && map.text().contains("│████████\n"), "{}", map.text());
        assert_eq!(map.svg().matches("#b00020").count(), 4 * 3);
    }

    #[test]
    fn many_columns_share_lines() {
        let map = HeatMap { values: vec![vec![Some(1.0); 60]; 5], range: [0.0, 1.0], ..HeatMap::default() };
        let text = map.text();
        assert_eq!(text.lines().filter(|line| line.contains('█')).count(), 3 + 1, "three pairs, and the legend");
        assert!(map.svg().matches("<rect").count() >= 300);
        assert!(!week().svg().contains("NaN"));
        assert!(HeatMap::default().svg().ends_with("</svg>\n"));
    }
}
