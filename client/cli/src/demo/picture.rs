//! Pictures of a day as text: the probabilities as bars, with the truth and the hours below.
//!
//! Invariant: plain text without colour, at most 100 columns wide.

use std::fmt::Write as _;

const HOUR_COLUMNS: usize = 3;
/// Columns of a day; a column is 20 minutes.
pub(super) const DAY_COLUMNS: usize = 24 * HOUR_COLUMNS;
/// Width of the labels left of a picture.
const MARGIN: usize = 12;
/// Height of the bars, in rows.
const ROWS: usize = 2;

const BARS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// The bars of a prediction above the truth. Both are evenly spaced samples over one day, within [0, 1].
pub(super) fn day(predicted: &[f64], truth: &[f64]) -> String {
    let mut text = String::new();
    for (row, label) in [(1, "predicted"), (0, "")] {
        let bars: String = columns(predicted).iter().map(|&value| bar(value, row)).collect();
        push_line(&mut text, label, &bars);
    }
    let truth: String = columns(truth).iter().map(|&share| mark(share)).collect();
    push_line(&mut text, "truth", &truth);
    text
}

/// The line of the hours.
pub(super) fn hours() -> String {
    let mut line = String::new();
    for hour in (0..24).step_by(3) {
        let _ = write!(line, "{hour:<width$}", width = 3 * HOUR_COLUMNS);
    }
    let mut text = String::new();
    push_line(&mut text, "hour", &line);
    text
}

/// The mean of the samples of each column.
fn columns(samples: &[f64]) -> Vec<f64> {
    let edge = |column: usize| column * samples.len() / DAY_COLUMNS;
    (0..DAY_COLUMNS)
        .map(|column| {
            let samples = &samples[edge(column)..edge(column + 1)];
            samples.iter().sum::<f64>() / samples.len().max(1) as f64
        })
        .collect()
}

/// The part of a bar in a row, counted from below. The lowest row always shows at least a line, so that a probability
/// of 0 is visible.
fn bar(value: f64, row: usize) -> char {
    let eighths = (value.clamp(0.0, 1.0) * (8 * ROWS) as f64).round() as usize;
    let piece = eighths.saturating_sub(8 * row).min(8);
    BARS[if row == 0 { piece.max(1) } else { piece }]
}

/// The mark for the share of a column in which the state is 1.
fn mark(share: f64) -> char {
    match share {
        share if share >= 0.75 => '█',
        share if share >= 0.25 => '▒',
        share if share > 0.0 => '░',
        _ => '·',
    }
}

fn push_line(text: &mut String, label: &str, content: &str) {
    let line = format!("  {label:<MARGIN$}{content}");
    let _ = writeln!(text, "{}", line.trim_end());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_grow_with_the_probability() {
        assert_eq!((bar(0.0, 1), bar(0.0, 0)), (' ', '▁'));
        assert_eq!((bar(0.5, 1), bar(0.5, 0)), (' ', '█'));
        assert_eq!((bar(0.75, 1), bar(0.75, 0)), ('▄', '█'));
        assert_eq!((bar(2.0, 1), bar(f64::NAN, 0)), ('█', '▁'));
    }

    #[test]
    fn a_picture_is_a_day_wide() {
        let samples: Vec<f64> = (0..288).map(|sample| f64::from(u8::from((96..192).contains(&sample)))).collect();
        let text = day(&samples, &samples);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), ROWS + 1);
        assert!(text.lines().chain(hours().lines()).all(|line| line.chars().count() <= 2 + MARGIN + DAY_COLUMNS));
        // 8 to 16 o'clock.
        let truth: String = lines[2].chars().skip(2 + MARGIN).collect();
        assert_eq!(truth, format!("{}{}{}", "·".repeat(24), "█".repeat(24), "·".repeat(24)));
    }

    #[test]
    fn hours_stand_under_their_columns() {
        let line = hours();
        assert_eq!(line.find("12").map(|at| at - 2 - MARGIN), Some(12 * HOUR_COLUMNS));
        assert_eq!(line.find("21").map(|at| at - 2 - MARGIN), Some(21 * HOUR_COLUMNS));
    }
}
