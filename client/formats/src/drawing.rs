//! Drawings of results, as text for terminals and as SVG: curves over time, and heat maps.
//!
//! Invariant: text is plain, without colours, at most 100 columns wide; the same values give the same bytes.

mod curves;
mod heat_map;

pub use curves::{Curve, CurvePlot};
pub use heat_map::HeatMap;

pub(crate) use heat_map::{SHADES, text_bar};

/// Columns of a drawing as text, without its margin.
const COLUMNS: usize = 72;

/// Eighths of a character's height.
const BARS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// A line of labels, each beginning at its column where it fits behind the one before.
fn label_line(labels: impl Iterator<Item = (usize, String)>) -> String {
    let mut line = String::new();
    let mut length = 0;
    for (column, label) in labels {
        if length == 0 || column > length + 1 {
            line.extend(std::iter::repeat_n(' ', column.saturating_sub(length)));
            line.push_str(&label);
            length = column.max(length) + label.chars().count();
        }
    }
    line
}
