//! Drawings of results, as text for terminals and as SVG: curves over time, and heat maps.
//!
//! Invariant: text is plain, without colours, at most 100 columns wide; the same values give the same bytes.

mod curves;
mod heat_map;

pub use curves::{Curve, CurvePlot};
pub use heat_map::HeatMap;

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

/// A number with three significant digits, for scales.
fn short(number: f64) -> String {
    let rounded: f64 = format!("{number:.2e}").parse().unwrap_or(number);
    let is_plain = rounded == 0.0 || (1e-3..1e6).contains(&rounded.abs());
    if is_plain { rounded.to_string() } else { format!("{rounded:e}") }
}

/// The bar of a drawing whose metre takes `per_m` characters or pixels: its length, at most `most`, and its text; 1, 2
/// or 5 times a power of ten metres. `None`: there is no such scale.
pub(crate) fn scale_bar(per_m: f64, most: f64) -> Option<(f64, String)> {
    let longest = most / per_m;
    if !(longest.is_finite() && longest > 0.0) {
        return None;
    }
    let power = 10_f64.powf(longest.log10().floor());
    let metres =
        [5.0, 2.0, 1.0].into_iter().map(|step| step * power).find(|metres| *metres <= longest * (1.0 + 1e-9))?;
    Some((metres * per_m, format!("{} m", short(metres))))
}
